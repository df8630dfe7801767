// What viser's panels lack: the whole text of a clipped button, and a word while the server is away.
(() => {
  let titles = {};
  window.addEventListener("pointerover", (event) => {
    const button = event.target instanceof Element && event.target.closest("button[id]");
    if (button && button.id in titles) button.title = titles[button.id];
  }, true);
  window.__artiworldPanels = { titles(texts) { titles = texts; } };

  // viser's worker says when its connection opens and closes.
  const AWAY = "The server is away. What you did is saved; this page goes on once it is back";
  window.Worker = class extends window.Worker {
    constructor(...options) {
      super(...options);
      this.addEventListener("message", ({ data }) => {
        if (data?.type === "connected") window.__artiworld?.set({ away: "" });
        if (data?.type === "closed") window.__artiworld?.set({ away: AWAY });
      });
    }
  };
})();
