// Gives the keyboard back after a choice: a box that keeps the focus swallows the keys.
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
})();
