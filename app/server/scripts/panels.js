// What viser's panels lack: room for the scroll bar, a list that scrolls by itself, the whole text
// of a clipped button, notes beside the picture, and a word while the server is away.
(() => {
  // A visible bar lies over the right edge of what scrolls. A path in a note goes on in the next
  // line: it would be cut off where it says which file.
  const style = document.createElement("style");
  style.textContent = `.mantine-ScrollArea-root:has(> .mantine-ScrollArea-scrollbar` +
    `[data-orientation="vertical"][data-state="visible"]) > .mantine-ScrollArea-viewport` +
    ` > .mantine-ScrollArea-content { padding-right: 6px; box-sizing: border-box; }` +
    `.mantine-Notification-description, .mantine-Typography-root { overflow-wrap: anywhere; }` +
    // Notes stand below the queue, not over the object. That a processor draws is no news: the
    // light is simple then.
    `.mantine-Notifications-root[data-position="top-left"]` +
    ` { inset: auto auto 8px 8px !important; width: 214px !important; }` +
    `#webgl-software-rendering { display: none; }` +
    // A tree of many joints: what edits them stays in sight.
    `ul:not(ul ul):has(> li > * > .mantine-List-itemLabel > strong:first-child)` +
    ` { max-height: max(22vh, 8em); overflow-y: auto; }`;
  document.head.append(style);

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
