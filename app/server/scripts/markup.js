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
    if (place === "tools") {
      made.setAttribute("role", "toolbar");
      made.classList.toggle("aw-folded", wasFolded());
    }
    if (place === "progress") made.setAttribute("role", "status");
    document.body.append(made);
    return (nodes[place] = made);
  };

  // Where nothing of ours comes, viser's own panel says what is wrong with the connection.
  setTimeout(() => document.documentElement.classList.add("aw-begun"), 30000);

  // They lie over the picture, whose place changes with the panels beside it.
  const NARROW = 420;  // pixels: below, the bar of steps is drawn smaller
  const SHARE = 0.5;  // least share of the window that the picture has: else the queue folds
  let before = "", stepped = false;
  const follow = () => {
    const canvas = window.__viserMutable?.canvas;
    const box = canvas && canvas.getBoundingClientRect();
    if (!box || !box.width) return;
    const now = `${box.left},${box.width}`;
    if (now === before) return;
    before = now;
    document.documentElement.style.setProperty("--aw-left", `${box.left}px`);
    document.documentElement.style.setProperty("--aw-width", `${box.width}px`);
    document.documentElement.classList.toggle("aw-narrow", box.width < NARROW);
    // The queue comes back with its own button; on a small screen the picture comes first.
    const fold = !stepped && box.width < SHARE * window.innerWidth &&
      document.querySelector("[aria-label]:has(> .tabler-icon-chevrons-left)");
    if (fold) {
      stepped = true;
      fold.click();
    }
  };
  setInterval(follow, 150);

  const control = (event) => event.target instanceof Element && event.target.closest("[data-press]");
  const same = (a, b) => a && b && a.dataset.press === b.dataset.press && a.value === b.value;
  let down = null;
  window.addEventListener("pointerdown", (event) => { down = control(event); });
  window.addEventListener("pointerup", (event) => {
    // The browser sends no click to a control that was drawn anew since the pointer went down.
    const now = control(event);
    if (down && !down.isConnected && same(down, now) && !now.disabled) {
      send(now.dataset.press, now.value ?? "");
    }
    down = null;
  });
  window.addEventListener("click", (event) => {
    const pressed = control(event);
    if (pressed && !pressed.disabled) send(pressed.dataset.press, pressed.value ?? "");
    // A clicked control gives the keys back to the picture: Enter and Space mean it there.
    if (pressed && event.detail) pressed.blur();
  });

  // The rail can be folded to its first icons; the browser remembers it.
  const KEY = "artiworld-rail";
  const foldable = (at) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "aw-button aw-fold";
    button.innerHTML = '<svg aria-hidden="true" viewBox="0 0 24 24" fill="none" ' +
      'stroke="currentColor"><path d="M6 15l6-6 6 6"/></svg>';
    const say = () => {
      const folded = at.classList.contains("aw-folded");
      button.title = folded ? "Show all tools" : "Fold the tools";
      button.setAttribute("aria-label", button.title);
      button.setAttribute("aria-expanded", String(!folded));
    };
    button.addEventListener("click", () => {
      at.classList.toggle("aw-folded");
      try {
        localStorage.setItem(KEY, at.classList.contains("aw-folded") ? "folded" : "");
      } catch { /* Without a memory it is as it was the next time. */ }
      say();
    });
    say();
    at.append(button);
  };
  const wasFolded = () => {
    try { return localStorage.getItem(KEY) === "folded"; } catch { return false; }
  };

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const theme = () => {
    send("theme", dark.matches ? "dark" : "light");
    window.__artiworldDisplay?.tell();
  };
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
      if (place === "tools" && html) foldable(at);
      if (key) at.querySelector(key)?.focus();
      follow();
    },
  };
})();
