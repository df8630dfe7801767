// Our own controls over the picture: the bar of the steps, the progress below it, the rail of
// tools, the tour. Their HTML comes from the server, which escapes what people typed.
(() => {
  const PLACES = { steps: "nav", progress: "div", tools: "div", tour: "div" };
  const LABELS = { steps: "Steps", tools: "Tools" };
  const nodes = {};
  const send = (action, value) => {
    const v = window.__viserMutable;
    if (v && v.sendMessage) v.sendMessage({ type: "ArtiworldPressMessage", action, value });
  };
  const node = (place) => {
    if (nodes[place]) return nodes[place];
    const made = document.createElement(PLACES[place]);
    made.id = `artiworld-${place}`;
    if (LABELS[place]) made.setAttribute("aria-label", LABELS[place]);
    if (place === "tools") made.setAttribute("role", "toolbar");
    if (place === "progress") made.setAttribute("role", "status");
    document.body.append(made);
    return (nodes[place] = made);
  };

  // They lie over the picture, whose place changes with the panels beside it.
  let before = "";
  const follow = () => {
    const canvas = window.__viserMutable?.canvas;
    const box = canvas && canvas.getBoundingClientRect();
    if (!box || !box.width) return;
    const now = `${box.left},${box.width}`;
    if (now === before) return;
    before = now;
    document.documentElement.style.setProperty("--aw-left", `${box.left}px`);
    document.documentElement.style.setProperty("--aw-width", `${box.width}px`);
  };
  setInterval(follow, 150);

  window.addEventListener("click", (event) => {
    const pressed = event.target instanceof Element && event.target.closest("[data-press]");
    if (pressed && !pressed.disabled) send(pressed.dataset.press, pressed.value ?? "");
  });

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const theme = () => send("theme", dark.matches ? "dark" : "light");
  dark.addEventListener("change", theme);

  window.__artiworldMarkup = {
    send,
    theme,
    show(place, html) {
      const at = node(place);
      // What has the keyboard keeps it: the same control is there anew.
      const held = at.contains(document.activeElement) && document.activeElement;
      const key = held && `[data-press="${held.dataset.press}"][value="${CSS.escape(held.value)}"]`;
      at.innerHTML = html;
      at.classList.toggle("shown", html !== "");
      if (key) at.querySelector(key)?.focus();
      follow();
    },
  };
})();
