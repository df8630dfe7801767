// Gives the keyboard back after a choice: a box that keeps the focus swallows the keys. And lets
// people type into a list: what stands there is replaced, Enter takes the first that fits.
(() => {
  const release = () => {
    const held = document.activeElement;
    if (!(held instanceof HTMLElement) || held instanceof HTMLTextAreaElement) return;
    // A busy page comes here late: what has been opened meanwhile keeps the keyboard.
    setTimeout(() => document.activeElement === held && held.blur(), 60);
  };
  const done = '[role="option"], button, input[type="checkbox"], [role="slider"], canvas';
  window.addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest(done)) release();
  }, true);
  window.addEventListener("keydown", (event) => {
    const ends = event.key === "Enter" || event.key === "Escape";
    if (ends && event.target instanceof HTMLInputElement) release();
  }, true);

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
