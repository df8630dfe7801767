// What viser's panels lack: room for the scroll bar, a list that scrolls by itself, and the whole
// text of a clipped button.
(() => {
  // A visible bar lies over the right edge of what scrolls. A path in a note goes on in the next
  // line: it would be cut off where it says which file.
  const style = document.createElement("style");
  style.textContent = `.mantine-ScrollArea-root:has(> .mantine-ScrollArea-scrollbar` +
    `[data-orientation="vertical"][data-state="visible"]) > .mantine-ScrollArea-viewport` +
    ` > .mantine-ScrollArea-content { padding-right: 6px; box-sizing: border-box; }` +
    `.mantine-Notification-description { overflow-wrap: anywhere; }` +
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
})();
