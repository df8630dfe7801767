// How bright the picture is, and how points of scans are drawn: viser's own materials, changed
// where they are. The browser remembers it.
(() => {
  const KEY = "artiworld-display", WATCH_MS = 300;
  const look = { brightness: 1, size: 1, color: "own" };
  try { Object.assign(look, JSON.parse(localStorage.getItem(KEY) || "{}")); } catch { /* none */ }

  const viser = () => window.__viserMutable;
  const HEAD = "uniform float awSize, awGamma, awLow, awHigh, awFacing;\nattribute vec3 awNormal;\n";
  // By height as in viridis, or by the direction that a surface faces: front and back green, left
  // and right red, above and below blue. A third of the own color stays, with the parts' tints.
  const BODY = `
    vColor = pow(vColor, vec3(1.0 / awGamma));
    if (awHigh > awLow) {
      float h = 2.0 * clamp((position.z - awLow) / (awHigh - awLow), 0.0, 1.0);
      vec3 low = vec3(0.27, 0.0, 0.33), middle = vec3(0.13, 0.57, 0.55), high = vec3(0.99, 0.91, 0.14);
      vColor = mix(h < 1.0 ? mix(low, middle, h) : mix(middle, high, h - 1.0), vColor, 0.34);
    }
    if (awFacing > 0.5) vColor = mix(abs(awNormal), vColor, 0.34);
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

  // --- normals: of the points less than a cell of a grid away, by principal components

  const CHUNK = 5000, FULL = 8;  // points between two looks at the page; the most in a cell
  const gridOf = (points, count, box) => {
    const low = box.min, size = box.max.clone().sub(low);
    let cell = 2.5 * Math.sqrt(2 * (size.x * size.y + size.y * size.z + size.z * size.x) / count) || 1;
    for (;; cell *= 0.7) {
      const ny = Math.floor(size.y / cell) + 3, nz = Math.floor(size.z / cell) + 3;
      const cells = new Map(), along = (value, least) => Math.floor((value - least) / cell) + 1;
      for (let i = 0; i < count; i++) {
        const [x, y, z] = ["x", "y", "z"].map((axis, k) => along(points[3 * i + k], low[axis]));
        const key = (x * ny + y) * nz + z, there = cells.get(key);
        if (there) there.push(i); else cells.set(key, [i]);
      }
      if (count / cells.size <= FULL || cell <= 1e-4 * size.length() || !size.length()) return { cell, cells, ny, nz };
    }
  };
  // Unit eigenvector of the smallest eigenvalue of [[a, b, c], [b, d, e], [c, e, f]].
  const flattest = (a, b, c, d, e, f) => {
    const mean = (a + d + f) / 3, off = b * b + c * c + e * e;
    const spread = Math.sqrt(((a - mean) ** 2 + (d - mean) ** 2 + (f - mean) ** 2 + 2 * off) / 6);
    if (!(spread > 0)) return [0, 0, 0];
    const [u, v, w] = [a - mean, d - mean, f - mean];
    const half = (u * (v * w - e * e) - b * (b * w - e * c) + c * (b * e - v * c)) / (2 * spread ** 3);
    const third = (Math.acos(Math.max(-1, Math.min(1, half))) + 2 * Math.PI) / 3;
    const least = mean + 2 * spread * Math.cos(third);
    const rows = [[a - least, b, c], [b, d - least, e], [c, e, f - least]];
    let best = [0, 0, 0], length = 0;
    for (const [p, q] of [[0, 1], [1, 2], [2, 0]].map(([i, j]) => [rows[i], rows[j]])) {
      const n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
      const long = Math.hypot(...n);
      if (long > length) [best, length] = [n, long];
    }
    return best.map((x) => x / (length || 1));
  };
  const facing = async (geometry) => {
    geometry.awFacing = true;  // begun
    if (!geometry.boundingBox) geometry.computeBoundingBox();
    const position = geometry.attributes.position, { array: p, count } = position;
    const { cell, cells, ny, nz } = gridOf(p, count, geometry.boundingBox);
    const steps = [-1, 0, 1], plane = steps.flatMap((y) => steps.map((z) => y * nz + z));
    const around = steps.flatMap((x) => plane.map((step) => x * ny * nz + step));
    const normals = new Float32Array(3 * count), sums = new Float64Array(9);
    let rest = CHUNK;
    for (const [key, mine] of cells) {
      if ((rest -= mine.length) < 0) {
        rest = CHUNK;
        await new Promise((go) => setTimeout(go));
      }
      const near = around.flatMap((step) => cells.get(key + step) || []);
      for (const i of mine) {
        const x0 = p[3 * i], y0 = p[3 * i + 1], z0 = p[3 * i + 2];
        let n = 0;
        sums.fill(0);
        for (const j of near) {
          const x = p[3 * j] - x0, y = p[3 * j + 1] - y0, z = p[3 * j + 2] - z0;
          if (x * x + y * y + z * z > cell * cell) continue;
          sums[0] += x; sums[1] += y; sums[2] += z; sums[3] += x * x; sums[4] += x * y;
          sums[5] += x * z; sums[6] += y * y; sums[7] += y * z; sums[8] += z * z;
          n++;
        }
        const [x, y, z] = [sums[0] / n, sums[1] / n, sums[2] / n];
        normals.set(flattest(sums[3] / n - x * x, sums[4] / n - x * y, sums[5] / n - x * z,
          sums[6] / n - y * y, sums[7] / n - y * z, sums[8] / n - z * z), 3 * i);
      }
    }
    geometry.setAttribute("awNormal", new position.constructor(normals, 3));
  };

  const apply = () => {
    const v = viser(), gl = v?.scene?.__r3f?.root?.getState().gl;
    if (!gl) return;
    let changed = gl.toneMappingExposure !== look.brightness;
    gl.toneMappingExposure = look.brightness;
    const found = clouds();
    box.classList.toggle("aw-cloud", found.length > 0);
    const [low, high] = look.color === "height" && found.length ? heights() : [0, 0];
    const values = { awSize: look.size, awGamma: look.brightness, awLow: low, awHigh: high, awFacing: 0 };
    const own = look.color !== "height" && look.color !== "normals";
    const plain = look.brightness === 1 && look.size === 1 && own;
    for (const { material, geometry } of found) {
      if (!material.uniforms || (plain && !material.uniforms.awSize)) continue;
      if (!material.uniforms.awSize) {
        for (const name of Object.keys(values)) material.uniforms[name] = { value: 0 };
        material.vertexShader = HEAD + material.vertexShader.replace("(scale /", "(awSize * scale /")
          .replace("vec3 sq_col", BODY);
        material.needsUpdate = true;
      }
      if (look.color === "normals" && !geometry.awFacing) facing(geometry);
      values.awFacing = look.color === "normals" && geometry.attributes.awNormal ? 1 : 0;
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
  const colors = make("select", { class: "aw-input" }, ...["Own", "Parts", "Height", "Normals"]
    .map((text) => make("option", { value: text.toLowerCase() }, text)));
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
