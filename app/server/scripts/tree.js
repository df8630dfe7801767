// A part of the kinematic tree is dragged onto its parent. Buttons, a list and clicks in the picture
// do the same for keys and fingers.
(() => {
  const rowOf = (event) => event.target instanceof Element && event.target.closest(".aw-node");
  let held = null, over = null;
  const mark = (row) => {
    if (row === over) return;
    over?.classList.remove("aw-over");
    over = row;
    over?.classList.add("aw-over");
  };
  window.addEventListener("dragstart", (event) => {
    const row = rowOf(event);
    if (!row) return;
    held = row.dataset.link;
    event.dataTransfer.effectAllowed = "move";
    event.dataTransfer.setData("text/plain", held);
  });
  window.addEventListener("dragover", (event) => {
    const row = held && rowOf(event);
    mark(row && row.dataset.link !== held ? row : null);
    if (over) event.preventDefault();
  });
  window.addEventListener("drop", (event) => {
    if (!held || !over) return;
    event.preventDefault();
    window.__artiworldMarkup.send("joint move", `${held}>${over.dataset.link}`);
  });
  window.addEventListener("dragend", () => { held = null; mark(null); });
})();
