// How bright the picture is, and how points of scans are drawn: viser's own materials, changed
// where they are. The browser remembers it.
(() => {
  const KEY = "artiworld-display", WATCH_MS = 300;
  const look = { brightness: 1, size: 1, color: "own" };
  try { Object.assign(look, JSON.parse(localStorage.getItem(KEY) || "{}")); } catch { /* none */ }

  const viser = () => window.__viserMutable;
  const HEAD = "uniform float awSize, awGamma, awLow, awHigh;\n";
  // By height as in viridis; a third of the own color stays, and the parts' tints with it.
  const BODY = `
    vColor = pow(vColor, vec3(1.0 / awGamma));
    if (awHigh > awLow) {
      float h = 2.0 * clamp((position.z - awLow) / (awHigh - awLow), 0.0, 1.0);
      vec3 low = vec3(0.27, 0.0, 0.33), middle = vec3(0.13, 0.57, 0.55), high = vec3(0.99, 0.91, 0.14);
      vColor = mix(h < 1.0 ? mix(low, middle, h) : mix(middle, high, h - 1.0), vColor, 0.34);
    }
    vec3 sq_col`;
  const clouds = () => {
    const found = [], nodes = viser()?.nodeRefFromName || {};
    for (const [name, node] of Object.entries(nodes)) {
      if (node && /^\/(scan|part\/\d+)$/.test(name)) node.traverse((n) => n.isPoints && found.push(n));
    }
    return found;
  };
  const heights = () => {
    const all = clouds().map(({ geometry: g }) => {
      if (!g.boundingBox) g.computeBoundingBox();
      return g.boundingBox;
    });
    return [Math.min(...all.map((b) => b.min.z)), Math.max(...all.map((b) => b.max.z))];
  };
  const apply = () => {
    const v = viser(), gl = v?.scene?.__r3f?.root?.getState().gl;
    if (!gl) return;
    let changed = gl.toneMappingExposure !== look.brightness;
    gl.toneMappingExposure = look.brightness;
    const found = clouds();
    box.classList.toggle("aw-cloud", found.length > 0);
    const [low, high] = look.color === "height" && found.length ? heights() : [0, 0];
    const values = { awSize: look.size, awGamma: look.brightness, awLow: low, awHigh: high };
    const plain = look.brightness === 1 && look.size === 1 && look.color !== "height";
    for (const { material } of found) {
      if (!material.uniforms || (plain && !material.uniforms.awSize)) continue;
      if (!material.uniforms.awSize) {
        for (const name of Object.keys(values)) material.uniforms[name] = { value: 0 };
        material.vertexShader = HEAD + material.vertexShader.replace("(scale /", "(awSize * scale /")
          .replace("vec3 sq_col", BODY);
        material.needsUpdate = true;
      }
      for (const [name, value] of Object.entries(values)) {
        changed ||= material.uniforms[name].value !== value;
        material.uniforms[name].value = value;
      }
    }
    if (changed) v.requestRender();
  };
  setInterval(apply, WATCH_MS);

  // --- the controls, above the corner with the axes

  const tell = () => window.__artiworldMarkup.send("colors", look.color);  // the server blends them
  const make = (name, attributes, ...children) => {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };
  const kept = (field, key, read) => {
    field.value = look[key];
    field.addEventListener("input", () => {
      look[key] = read(field.value);
      if (key === "color") tell();
      try { localStorage.setItem(KEY, JSON.stringify(look)); } catch { /* not remembered */ }
      apply();
    });
    return field;
  };
  const range = (label, key, least, most, points) => make("label", { class: points ? "aw-points" : "" },
    label, kept(make("input", { type: "range", min: least, max: most, step: 0.1 }), key, Number));
  const colors = make("select", { class: "aw-input" }, ...[["own", "Own"], ["parts", "Parts"], ["height", "Height"]]
    .map(([value, text]) => make("option", { value }, text)));
  const box = make("div", { id: "artiworld-display", role: "group", "aria-label": "Display", hidden: "" },
    range("Brightness", "brightness", 1, 3, false), range("Point size", "size", 0.5, 3, true),
    make("label", { class: "aw-points" }, "Point colors", kept(colors, "color", String)));
  window.__artiworldDisplay = {
    box,
    tell,
    toggle() {
      box.hidden = !box.hidden;
      return !box.hidden;
    },
  };
})();
