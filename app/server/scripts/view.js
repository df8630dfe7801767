// The corner with the axes: it turns with the camera, and a click looks along an axis. And the keys
// of the number pad for views, as in Blender; the server answers with View.look.
(() => {
  const AXES = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]];
  const PADS = { Numpad0: "0", Numpad1: "1", Numpad3: "3", Numpad5: "5", Numpad7: "7", Numpad9: "9",
    NumpadDivide: "/" };
  const FOLLOW_MS = 80;
  const corner = document.createElement("div");
  corner.id = "artiworld-view";
  corner.setAttribute("role", "group");
  corner.setAttribute("aria-label", "Views");
  const ends = AXES.flatMap(([name, axis]) => [1, -1].map((sign) => {
    const button = document.createElement("button");
    const title = `View from ${sign > 0 ? "+" : "−"}${name.toUpperCase()}`;
    button.type = "button";
    button.className = `aw-end aw-${name}${sign > 0 ? "" : " aw-far"}`;
    button.dataset.press = "look";
    button.value = `${sign > 0 ? "+" : "-"}${name}`;
    button.title = title;
    button.setAttribute("aria-label", title);
    button.textContent = sign > 0 ? name.toUpperCase() : "";
    const stick = document.createElement("i");
    if (sign > 0) {
      stick.className = `aw-stick aw-${name}`;
      corner.append(stick);
    }
    corner.append(button);
    return { axis: axis.map((a) => a * sign), button, stick: sign > 0 && stick };
  }));
  const above = (name, label, title, toggle) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", className: `aw-above ${name}`, title });
    button.setAttribute("aria-label", label);
    const press = () => button.setAttribute("aria-pressed", String(toggle()));
    button.addEventListener("click", press);
    corner.append(button);
    return press;
  };
  const toggleFour = above("aw-four", "Four views", "Four views (number pad 0)",
    () => window.__artiworldLook.four());
  const { box, toggle } = window.__artiworldDisplay;
  above("aw-look", "Display", "Brightness, and size and colors of points", toggle);
  corner.append(box);
  const start = () => document.body.append(corner);
  document.body ? start() : window.addEventListener("DOMContentLoaded", start);

  const viser = () => window.__viserMutable;
  const inWorld = ([x, y, z]) => {
    const { camera, nodeRefFromName } = viser(), root = nodeRefFromName[""];
    const v = camera.position.clone().set(x, y, z);
    return root ? v.transformDirection(root.matrixWorld) : v;
  };
  let before = "";
  const follow = () => {
    const v = viser(), camera = v && v.camera;
    if (!camera || !v.canvas || !v.nodeRefFromName) return;
    const reach = corner.clientWidth / 2;
    const now = [...camera.quaternion, reach, !!v.nodeRefFromName[""]].join();
    if (now === before || !reach) return;
    before = now;
    camera.updateMatrixWorld();
    for (const { axis, button, stick } of ends) {
      const d = inWorld(axis).transformDirection(camera.matrixWorldInverse);
      const [x, y] = [d.x * 0.72 * reach, -d.y * 0.72 * reach];
      button.style.transform = `translate(${x}px, ${y}px)`;
      button.style.zIndex = Math.round(10 + 5 * d.z);
      button.style.opacity = 0.8 + 0.2 * d.z;
      if (stick) {
        stick.style.width = `${Math.hypot(x, y)}px`;
        stick.style.transform = `rotate(${Math.atan2(y, x)}rad)`;
      }
    }
  };
  setInterval(follow, FOLLOW_MS);

  window.addEventListener("keydown", (event) => {
    const typing = event.target instanceof Element &&
      event.target.closest("input, textarea, select, [contenteditable]");
    if (typing || event.altKey || event.metaKey) return;
    // Where "/" takes Shift and a digit, that is a name for the part: the number pad has it too.
    const slash = event.key === "/" && !event.shiftKey && !event.ctrlKey;
    const pad = PADS[event.code] || (slash && "/");
    if (!pad) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (pad === "0") return event.repeat || toggleFour();
    if (!event.repeat) window.__artiworldMarkup.send("pad", (event.ctrlKey ? "c" : "") + pad);
  }, true);

  window.__artiworldView = {
    // The direction of a side such as "-y", in viser's world.
    side: (name) => inWorld(AXES.find(([n]) => n === name[1])[1].map((a) => (name[0] === "-" ? -a : a))),
    // Look from there, a direction in the object's frame, at what is looked at now.
    look(direction) {
      const v = viser(), control = v && v.cameraControl;
      if (!control) return;
      const target = control.getTarget(v.camera.position.clone());
      const eye = control.getPosition(v.camera.position.clone());
      const far = eye.distanceTo(target);
      eye.copy(target).addScaledVector(inWorld(direction), far);
      const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
      control.setLookAt(eye.x, eye.y, eye.z, target.x, target.y, target.z, !still);
      v.requestRender();
    },
  };
})();
