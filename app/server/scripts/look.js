// The hand of 3D tools, which viser lacks: the wheel zooms to the pointer, a double click frames
// what it hits, numbers change by dragging, and top, front and right are shown beside the picture.
(() => {
  const viser = () => window.__viserMutable;
  const three = () => viser()?.scene?.__r3f?.root?.getState();  // viser's own renderer
  const still = () => window.matchMedia("(prefers-reduced-motion: reduce)").matches;

  let controlled = null;
  setInterval(() => {
    const control = viser()?.cameraControl;
    if (!control || control === controlled) return;
    controlled = control;
    control.dollyToCursor = true;
  }, 300);

  // --- double click

  const CLOSER = 0.5;  // to a place of something that isn't a part of its own
  const SPARE = 1.15;  // around a part
  const partOf = (node) => {
    while (node && !/^\/(tint|part)\/\d+$/.test(node.name)) node = node.parent;
    return node;
  };
  const visible = (node) => !node || (node.visible && visible(node.parent));
  const frame = (event) => {
    const v = viser(), { raycaster, pointer } = three(), { camera, canvas, cameraControl } = v;
    const box = canvas.getBoundingClientRect();
    const eye = cameraControl.getPosition(camera.position.clone());
    const far = eye.distanceTo(cameraControl.getTarget(camera.position.clone()));
    const at = pointer.clone().set(2 * (event.clientX - box.left) / box.width - 1,
      1 - 2 * (event.clientY - box.top) / box.height);
    raycaster.params.Points.threshold = 0.006 * far;
    raycaster.setFromCamera(at, camera);
    const scan = v.nodeRefFromName["/scan"], nodes = [scan];
    if (!scan) return window.__artiworldMarkup.send("frame", "");  // of a scene what was chosen
    for (const [name, node] of Object.entries(v.nodeRefFromName)) {
      if (node && /^\/(tint|part)\/\d+$/.test(name)) {
        node.name ||= name;
        nodes.push(node);
      }
    }
    const hit = raycaster.intersectObjects(nodes, true)
      .find(({ object }) => visible(object) && (object.isMesh || object.isPoints));
    if (!hit) return;
    const center = hit.point.clone();
    let distance = CLOSER * far;
    if (partOf(hit.object)) {
      const { geometry, matrixWorld } = hit.object;
      if (!geometry.boundingSphere) geometry.computeBoundingSphere();
      const { radius, center: middle } = geometry.boundingSphere;
      center.copy(middle).applyMatrix4(matrixWorld);
      const narrow = Math.min(1, camera.aspect) * Math.tan(camera.fov * Math.PI / 360);
      distance = SPARE * radius * matrixWorld.getMaxScaleOnAxis() / Math.sin(Math.atan(narrow));
    }
    const from = eye.sub(cameraControl.getTarget(camera.position.clone())).setLength(distance).add(center);
    cameraControl.setLookAt(...from.toArray(), ...center.toArray(), !still());
    v.requestRender();
  };
  window.addEventListener("dblclick", (event) => {
    if (event.target !== viser()?.canvas || event.altKey || event.shiftKey || !three()) return;
    // Where each click is a prompt, Ctrl or ⌘ says that these are none.
    const { hover, tool } = window.__artiworld.get();
    const prompting = document.querySelector('[data-press="step"][value="Annotate"][aria-pressed="true"]');
    if ((prompting || hover || tool !== "click") && !(event.ctrlKey || event.metaKey)) return;
    frame(event);
  }, true);

  // --- numbers

  // A pixel changes the last but one of a number's leading digits, with Shift a tenth of that.
  const SLOP = 4, PIXELS = 50;
  const setter = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  let drag = null;
  const dragged = (event) => {
    const { value, per, digits } = drag, by = (event.clientX - drag.x) * per * (event.shiftKey ? 0.1 : 1);
    return (value + by).toFixed(digits + (event.shiftKey ? 1 : 0));
  };
  window.addEventListener("pointerdown", (event) => {
    const field = event.target;
    if (!(field instanceof HTMLInputElement) || !field.matches(".mantine-NumberInput-input") ||
      field.disabled || event.button || event.pointerType === "touch" ||
      field === document.activeElement) return;
    const value = Number.parseFloat(field.value);
    if (!Number.isFinite(value)) return;
    const size = 10 ** Math.floor(Math.log10(Math.abs(value) || 1));
    drag = { field, value, x: event.clientX, moved: false, per: size / PIXELS,
      digits: Math.max(0, 2 - Math.round(Math.log10(size))) };
  }, true);
  window.addEventListener("pointermove", (event) => {
    if (!drag || (!drag.moved && Math.abs(event.clientX - drag.x) < SLOP)) return;
    if (!drag.moved) {
      drag.moved = true;
      drag.x = event.clientX;
      drag.field.blur();
      document.documentElement.classList.add("aw-dragging");
    }
    event.preventDefault();
    setter.call(drag.field, dragged(event));
  }, true);
  // One change at the end: each that viser hears of is a step of the history.
  window.addEventListener("pointerup", (event) => {
    if (drag?.moved) {
      setter.call(drag.field, dragged(event));
      drag.field.dispatchEvent(new Event("input", { bubbles: true }));
      const { field } = drag;
      setTimeout(() => field.blur(), 60);  // as after any other choice, the keys go to the picture
    }
    drag = null;
    document.documentElement.classList.remove("aw-dragging");
  }, true);
  window.addEventListener("pointercancel", () => { drag = null; }, true);

  // --- four views

  const SIDES = [["Top", "+z"], ["Front", "-y"], ["Right", "+x"]];
  const FLAT = 6, NEARER = 0.65, LOOK_MS = 200;  // degrees: hardly any perspective
  const box = document.createElement("div");
  box.id = "artiworld-sides";
  box.hidden = true;
  const sides = SIDES.map(([name, side]) => {
    const button = document.createElement("button"), canvas = document.createElement("canvas");
    Object.assign(button, { type: "button", title: `${name}: look from here`, value: side });
    button.setAttribute("aria-label", `${name} view`);
    button.dataset.press = "look";
    button.append(canvas, name);
    box.append(button);
    return { canvas, side };
  });
  const start = () => document.body.append(box);
  document.body ? start() : window.addEventListener("DOMContentLoaded", start);

  let drawn = -1;
  const draw = () => {
    const state = three(), v = viser();
    if (box.hidden || !state || document.hidden || state.gl.info.render.frame === drawn) return;
    const { gl, scene, camera, size } = state, ratio = gl.getPixelRatio();
    const target = v.cameraControl.getTarget(camera.position.clone());
    const far = v.cameraControl.getPosition(camera.position.clone()).distanceTo(target);
    const wide = Math.tan(camera.fov * Math.PI / 360) / Math.tan(FLAT * Math.PI / 360);
    const clear = v.backgroundMaterial?.uniforms.enabled;
    const backdrop = clear?.value;
    if (clear) clear.value = false;
    for (const { canvas, side } of sides) {
      const [w, h] = [canvas.clientWidth, canvas.clientHeight];
      if (!w || !h) continue;
      Object.assign(canvas, { width: w * ratio, height: h * ratio });
      const eye = camera.clone(), up = camera.up.clone();
      const out = window.__artiworldView.side(side);
      const top = window.__artiworldView.side(side[1] === "z" ? "+y" : "+z");
      Object.assign(eye, { fov: FLAT, aspect: w / h, near: 0.01 * far * wide, far: 20 * far * wide });
      eye.up.copy(up.copy(top));
      eye.position.copy(target).addScaledVector(out, NEARER * far * wide);
      eye.lookAt(target);
      eye.updateProjectionMatrix();
      eye.updateMatrixWorld();
      gl.setViewport(0, 0, w, h);
      gl.setScissor(0, 0, w, h);
      gl.setScissorTest(true);
      gl.render(scene, eye);
      const paper = canvas.getContext("2d"), tall = gl.domElement.height - h * ratio;
      paper.drawImage(gl.domElement, 0, tall, w * ratio, h * ratio, 0, 0, w * ratio, h * ratio);
    }
    if (clear) clear.value = backdrop;
    gl.setScissorTest(false);
    gl.setViewport(0, 0, size.width, size.height);
    gl.render(scene, camera);  // the picture is what is left on viser's canvas
    drawn = gl.info.render.frame;
  };
  setInterval(draw, LOOK_MS);

  window.__artiworldLook = {
    four() {
      box.hidden = !box.hidden;
      drawn = -1;
      draw();
      return !box.hidden;
    },
  };
})();
