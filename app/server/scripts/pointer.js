// What viser's page does not send: where the pointer rests (for the preview of a click) and what
// is drawn with a lasso or a brush; and what it cannot draw: a scan without its hidden parts.
// Messages go out on viser's own websocket; the server answers through window.__artiworld.
(() => {
  const HOVER_MS = 60, HOVER_PX = 3, STEP_PX = 3, MOST = 2000, HOLD_MS = 300;
  const SAID_MS = 1800, TURN_MS = 150, LATE_MS = 200, WATCH_MS = 60;
  const KEYS = { l: "lasso", i: "brush" };
  const state = { tool: "click", hover: false, drawing: false, radius: 0.02, anchor: false, frame: null,
    finds: false, hint: "", said: "", away: "" };
  let pointer = null, sent = null, timer = 0, silent = 0, stroke = null, pressed = null, down = null;

  const viser = () => window.__viserMutable;
  const send = (message) => { const v = viser(); if (v && v.sendMessage) v.sendMessage(message); };
  const box = () => { const v = viser(); return v && v.canvas && v.canvas.getBoundingClientRect(); };
  const onCanvas = (event) => event.target instanceof HTMLCanvasElement;
  const place = (event) => {
    const b = box();
    return b && [(event.clientX - b.left) / b.width, (event.clientY - b.top) / b.height];
  };
  const typing = (event) => event.target instanceof Element &&
    event.target.closest("input, textarea, select, [contenteditable]");

  // --- what is drawn over the picture

  const ns = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(ns, "svg");
  svg.style.cssText = "position:fixed;inset:0;width:100%;height:100%;pointer-events:none;z-index:50";
  const shape = (name, style) => {
    const node = document.createElementNS(ns, name);
    for (const [key, value] of Object.entries(style)) node.setAttribute(key, value);
    node.style.display = "none";
    svg.appendChild(node);
    return node;
  };
  const line = shape("polyline", { stroke: "#e67e22", "stroke-width": 2, fill: "none",
    "stroke-linejoin": "round", "stroke-linecap": "round" });
  const ring = shape("circle", { stroke: "#222", "stroke-width": 1.5, fill: "#e67e2233" });
  const cut = shape("line", { stroke: "#c0392b", "stroke-width": 2, "stroke-dasharray": "7 5" });
  const rectangle = shape("polygon", { stroke: "#c0392b", "stroke-width": 2, fill: "#c0392b22",
    "stroke-linejoin": "round" });
  const badge = document.createElement("div");
  badge.id = "artiworld-hint";
  badge.style.cssText = "position:fixed;bottom:1.1rem;transform:translateX(-50%);z-index:51;" +
    "background:#1f2933e6;color:#fff;padding:.4rem .9rem;border-radius:999px;display:none;" +
    "font:13.5px/1.4 system-ui,sans-serif;pointer-events:none;white-space:nowrap";
  const start = () => document.body.append(svg, badge);
  document.body ? start() : window.addEventListener("DOMContentLoaded", start);

  // The rectangle from its first corner to where the pointer meets the surface, in page pixels.
  const spanned = () => {
    const v = viser(), b = box(), { corner, out, across } = state.frame;
    const camera = v.camera, root = v.nodeRefFromName[""];
    const vector = (p) => camera.position.clone().set(p[0], p[1], p[2]);
    camera.updateMatrixWorld();
    if (root) root.updateWorldMatrix(true, false);
    const into = (p) => root ? p.applyMatrix4(root.matrixWorld.clone().invert()) : p;
    const first = vector(corner), normal = vector(out), u = vector(across);
    const side = normal.clone().cross(u);
    const [x, y] = pointer.at;
    const eye = into(camera.position.clone());
    const ray = into(vector([2 * x - 1, 1 - 2 * y, 0.5]).unproject(camera)).sub(eye);
    const t = first.clone().sub(eye).dot(normal) / ray.dot(normal);
    if (!(t > 0)) return null;
    const reach = eye.addScaledVector(ray, t).sub(first);
    const [du, dw] = [reach.dot(u), reach.dot(side)];
    return [[0, 0], [du, 0], [du, dw], [0, dw]].map(([i, j]) => {
      const p = first.clone().addScaledVector(u, i).addScaledVector(side, j);
      if (root) p.applyMatrix4(root.matrixWorld);
      p.project(camera);
      return [b.left + (p.x + 1) / 2 * b.width, b.top + (1 - p.y) / 2 * b.height].join(",");
    }).join(" ");
  };

  const active = () => state.drawing && state.tool !== "click";
  // Panels open beside the picture after the page has loaded, and the window changes its size.
  const moved = new ResizeObserver(() => draw());
  let canvas = null, late = 0;
  const draw = () => {
    const b = box();
    if (!b) {
      clearTimeout(late);
      late = setTimeout(draw, LATE_MS);
      return;
    }
    if (canvas !== viser().canvas) {
      moved.disconnect();
      moved.observe(canvas = viser().canvas);
    }
    const shown = (node, yes) => { node.style.display = yes ? "" : "none"; };
    const radius = state.radius * b.height;
    shown(line, stroke);
    if (stroke) {
      const at = stroke.path.map(([x, y]) => [b.left + x * b.width, b.top + y * b.height]);
      line.setAttribute("points", at.map((p) => p.join(",")).join(" "));
      const brush = state.tool === "brush";
      line.setAttribute("stroke-width", brush ? 2 * radius : 2);
      line.setAttribute("stroke-opacity", brush ? 0.35 : 1);
      line.setAttribute("stroke", stroke.positive ? "#e67e22" : "#222");
      line.setAttribute("fill", brush ? "none" : stroke.positive ? "#e67e2222" : "#22222222");
    }
    const near = pointer && pointer.inside;
    shown(ring, near && active() && state.tool === "brush");
    const corners = near && state.frame && spanned();
    shown(rectangle, corners);
    if (corners) rectangle.setAttribute("points", corners);
    shown(cut, near && state.anchor && down && !state.frame);
    if (near) {
      ring.setAttribute("cx", pointer.x);
      ring.setAttribute("cy", pointer.y);
      ring.setAttribute("r", radius);
      cut.setAttribute("x2", pointer.x);
      cut.setAttribute("y2", pointer.y);
    }
    if (down) {
      cut.setAttribute("x1", down[0]);
      cut.setAttribute("y1", down[1]);
    }
    const text = state.away || state.said || state.hint;
    badge.textContent = text;
    badge.style.display = text ? "" : "none";
    badge.style.left = b.left + b.width / 2 + "px";
    const v = viser();
    if (v && v.canvas) v.canvas.style.cursor = active() || state.anchor ? "crosshair" : "";
  };

  // --- the pointer at rest

  const quiet = () => {
    clearTimeout(timer);
    timer = 0;
    if (sent) send({ type: "ArtiworldHoverMessage", x: 0, y: 0, inside: false });
    sent = null;
  };
  const tell = () => {
    timer = 0;
    if (!pointer || !pointer.inside || !state.hover || active() || state.anchor) return;
    if (sent && Math.hypot(sent.x - pointer.x, sent.y - pointer.y) < HOVER_PX) return;
    sent = { x: pointer.x, y: pointer.y };
    const [x, y] = pointer.at;
    send({ type: "ArtiworldHoverMessage", x, y, inside: true });
  };

  // --- strokes

  const setTool = (tool) => {
    if (state.tool === tool) return;
    state.tool = tool;
    stroke = null;
    quiet();
    send({ type: "ArtiworldToolMessage", tool });
    draw();
  };
  const stop = (event) => { event.stopImmediatePropagation(); event.preventDefault(); };
  const extend = (event) => {
    const b = box(), at = place(event), last = stroke.path[stroke.path.length - 1];
    const far = Math.hypot((at[0] - last[0]) * b.width, (at[1] - last[1]) * b.height);
    if (far >= STEP_PX && stroke.path.length < MOST) stroke.path.push(at);
  };

  window.addEventListener("pointerdown", (event) => {
    quiet();
    if (!onCanvas(event) || event.button !== 0) return;
    if (!active()) {
      down = [event.clientX, event.clientY];
      return;
    }
    stop(event);
    stroke = { id: event.pointerId, positive: !event.shiftKey, path: [place(event)] };
    if (pressed) pressed.used = true;
    draw();
  }, true);
  window.addEventListener("pointermove", (event) => {
    pointer = { x: event.clientX, y: event.clientY, at: place(event), inside: onCanvas(event) };
    if (stroke && event.pointerId === stroke.id) {
      stop(event);
      extend(event);
      draw();
      return;
    }
    if (active() || state.anchor) draw();
    if (!pointer.inside || event.buttons) return quiet();
    if (state.hover && !timer) timer = setTimeout(tell, HOVER_MS);
  }, true);
  window.addEventListener("pointerup", (event) => {
    if (!stroke || event.pointerId !== stroke.id) return;
    stop(event);
    extend(event);
    const { path, positive } = stroke;
    stroke = null;
    draw();
    if (state.tool === "brush" || path.length > 3) {
      send({ type: "ArtiworldStrokeMessage", tool: state.tool, path, radius: state.radius, positive });
    }
    if (pressed === null && letGo) setTool("click");
    letGo = false;
  }, true);
  window.addEventListener("pointercancel", () => { stroke = null; draw(); }, true);
  document.addEventListener("pointerleave", quiet);
  window.addEventListener("blur", quiet);

  // Alt and the wheel go through the masks of the last click by size; the wheel alone zooms.
  let turned = 0;
  window.addEventListener("wheel", (event) => {
    if (!event.altKey || !onCanvas(event)) return;
    stop(event);
    if (!event.deltaY || Date.now() - turned < TURN_MS) return;
    turned = Date.now();
    window.__artiworldMarkup.send("mask", event.deltaY < 0 ? "1" : "-1");
  }, { capture: true, passive: false });

  // A tool's key, tapped, keeps the tool; held while drawing, it ends with the key.
  let letGo = false;
  window.addEventListener("keydown", (event) => {
    if (typing(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.toLowerCase();
    // A decision is one press: a key that is held doesn't decide about what comes next.
    if (event.repeat && (key === "y" || key === "x")) return stop(event);
    const sheet = { "?": "help", F8: "messages" }[event.key];
    if (sheet) return send({ type: "ArtiworldToolMessage", tool: sheet });
    const digit = event.shiftKey && !event.repeat && /^Digit(\d)$/.exec(event.code);
    if (digit) return send({ type: "ArtiworldAnswerMessage", number: Number(digit[1]) });
    if (event.key === "Escape") {
      stroke = null;
      state.tool = "click";
      send({ type: "ArtiworldToolMessage", tool: "click" });
      return draw();
    }
    const arrow = { ArrowLeft: "previous", ArrowRight: "next" }[event.key];
    if (state.finds && arrow) {
      stop(event);
      return send({ type: "ArtiworldToolMessage", tool: arrow });
    }
    if (event.key === "[" || event.key === "]") {
      const by = event.key === "[" ? 1 / 1.25 : 1.25;
      state.radius = Math.min(0.2, Math.max(0.003, state.radius * by));
      return draw();
    }
    if (!(key in KEYS) || event.shiftKey || event.repeat || !state.drawing) return;
    pressed = { key, at: Date.now(), used: false, before: state.tool };
    setTool(KEYS[key]);
  }, true);
  window.addEventListener("keyup", (event) => {
    if (!pressed || event.key.toLowerCase() !== pressed.key) return;
    const { at, used, before, key } = pressed;
    pressed = null;
    const held = used || Date.now() - at > HOLD_MS;
    if (held && stroke) letGo = true;
    else if (held || before === KEYS[key]) setTool("click");
  }, true);

  // --- hidden parts

  // Of the scan that viser has loaded only the index of its triangles, or points, is rewritten.
  let hidden = null, watching = 0;
  const scanned = () => {
    const v = viser(), root = v && v.nodeRefFromName && v.nodeRefFromName["/scan"], found = [];
    if (root) root.traverse((node) => { if (node.isMesh || node.isPoints) found.push(node); });
    return found;
  };
  const corners = ({ isPoints, geometry }) => {
    if (isPoints && !geometry.index) {
      geometry.setIndex([...Array(geometry.attributes.position.count).keys()]);
    }
    return geometry.userData.corners || (geometry.userData.corners = geometry.index.array.slice());
  };
  const size = ({ isPoints, geometry: g }) =>
    isPoints ? g.attributes.position?.count || 0 : (g.userData.corners || g.index.array).length / 3;
  const leaveOut = () => {
    const found = scanned();
    // It is still loading, or the one before it has not gone yet.
    if (hidden && found.reduce((n, node) => n + size(node), 0) !== hidden.count) return;
    if (found.every((node) => (node.geometry.userData.hidden || null) === hidden)) return;
    let element = 0;
    for (const node of found) {
      const all = corners(node), { geometry } = node, index = geometry.index.array;
      const each = node.isPoints ? 1 : 3;
      let end = 0;
      for (let at = 0; at < all.length; at += each, element++) {
        if (hidden && hidden.bits[element >> 3] >> (element & 7) & 1) continue;
        for (let k = 0; k < each; k++) index[end++] = all[at + k];
      }
      geometry.index.needsUpdate = true;
      geometry.setDrawRange(0, end);
      geometry.userData.hidden = hidden;
    }
    viser().requestRender();
  };

  window.__artiworld = {
    hide(count, text) {
      clearInterval(watching);
      hidden = count ? { count, bits: Uint8Array.from(atob(text), (c) => c.charCodeAt(0)) } : null;
      leaveOut();
      if (hidden) watching = setInterval(leaveOut, WATCH_MS);
    },
    set(options) {
      const before = state.hover;
      Object.assign(state, options);
      if (options.said) {
        clearTimeout(silent);
        silent = setTimeout(() => { state.said = ""; draw(); }, SAID_MS);
      }
      const { shown } = options;
      if (shown !== undefined) {  // two frames on, what came before it is on the screen
        requestAnimationFrame(() => requestAnimationFrame(() => {
          document.documentElement.classList.add("aw-begun");
          send({ type: "ArtiworldShownMessage", number: shown });
        }));
      }
      if (!state.hover) quiet();
      else if (!before && pointer && !timer) timer = setTimeout(tell, HOVER_MS);
      draw();
    },
    get: () => ({ ...state }),
  };
})();
