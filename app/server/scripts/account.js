// Goes to the login page once the browser session was revoked; where nobody logs in it stops.
(() => {
  const SECONDS = 10;
  const look = async () => {
    let answer;
    try {
      answer = await fetch("/api/v1/me", { cache: "no-store" });
    } catch {
      return setTimeout(look, SECONDS * 1000); // the server is away: it may come back
    }
    if (answer.status === 401) return location.replace("/login");
    if (answer.ok && (await answer.json()).role === null) return undefined;
    return setTimeout(look, SECONDS * 1000);
  };
  setTimeout(look, SECONDS * 1000);
})();
