// Gives the keyboard back after a choice: a box that keeps the focus swallows the keys. And lets
// people type into a list: what stands there is replaced, Enter takes the first that fits. Who
// works by keys goes into the panels with F6, and on with Tab; a control there keeps its keys.
(() => {
  const release = () => {
    const held = document.activeElement;
    if (!(held instanceof HTMLElement) || held instanceof HTMLTextAreaElement) return;
    // A busy page comes here late: what has been opened meanwhile keeps the keyboard.
    setTimeout(() => document.activeElement === held && held.blur(), 60);
  };
  const done = '[role="option"], button, input[type="checkbox"], [role="slider"], canvas';
  window.addEventListener("click", (event) => {
    const byPointer = event.detail > 0;
    if (byPointer && event.target instanceof Element && event.target.closest(done)) release();
  }, true);
  window.addEventListener("change", (event) => {
    if (event.target instanceof HTMLSelectElement) release();
  }, true);
  window.addEventListener("keydown", (event) => {
    const { key, target } = event;
    const ends = key === "Enter" || key === "Escape";
    if (ends && target instanceof HTMLInputElement) release();
    if (key === "F6") {
      event.preventDefault();
      visit(event.shiftKey ? -1 : 1);
    } else if (target instanceof Element && target.matches("button, select, a[href]")) {
      if (key === "Escape") release();
      else if (key === "Tab" || key === " " || key === "Enter") event.stopPropagation();
    }
  }, true);

  const CONTROLS = "button, select, input, textarea, a[href], [role='slider'], [role='tab']";
  const firstIn = (region) => [...region.querySelectorAll(CONTROLS)]
    .find((node) => node.checkVisibility() && !node.disabled && node.tabIndex >= 0);
  const visit = (by) => {
    const ours = ["#artiworld-tour", "#artiworld-steps", "#artiworld-tools", ".aw-queue"]
      .map((name) => document.querySelector(name));
    const panels = [...document.querySelectorAll(".mantine-ScrollArea-root")]
      .filter((node) => !node.querySelector(".aw-queue") && !node.parentElement.closest(
        ".mantine-ScrollArea-root"));
    const regions = [...ours, ...panels].filter((node) => node && firstIn(node));
    const at = regions.findIndex((node) => node.contains(document.activeElement));
    const next = (at < 0 && by < 0 ? 0 : at) + by;
    firstIn(regions[(next + regions.length) % regions.length])?.focus({ focusVisible: true });
  };

  const list = (event) =>
    event.target instanceof HTMLInputElement && event.target.matches('[role="combobox"]');
  let entered = null, typed = null;
  window.addEventListener("focusin", (event) => {
    typed = null;
    entered = list(event) ? event.target : null;
    if (entered) entered.select();
  }, true);
  window.addEventListener("click", (event) => {
    // The pointer that brought the focus has put the cursor somewhere.
    if (list(event) && event.target === entered && typed === null) event.target.select();
    entered = null;
  }, true);
  window.addEventListener("input", (event) => { if (list(event)) typed = event.target; }, true);
  window.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || !list(event) || typed !== event.target) return;
    const options = document.getElementById(event.target.getAttribute("aria-controls"));
    if (!options || options.querySelector("[data-combobox-selected]")) return;
    const down = { key: "ArrowDown", code: "ArrowDown", bubbles: true };
    event.target.dispatchEvent(new KeyboardEvent("keydown", down));
  }, true);
})();
