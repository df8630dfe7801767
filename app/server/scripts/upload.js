// Files that are too large are refused before they are sent: the server refuses them too, but
// viser's page goes on sending parts to a server that throws them away. Several files chosen at
// once (an OBJ with its materials and textures) become one zip, since viser sends one file.
(() => {
  const limit = __LIMIT__;
  const readable = (n) => n >= 1e9 ? (n / 1e9).toPrecision(3) + " GB"
    : (n / 1e6).toPrecision(3) + " MB";
  const tell = (text) => {
    const note = document.createElement("div");
    note.setAttribute("role", "alert");
    note.textContent = text;
    note.style.cssText = "position:fixed;left:50%;top:1rem;transform:translateX(-50%);" +
      "z-index:100000;background:#b3261e;color:#fff;padding:.7rem 1.1rem;border-radius:8px;" +
      "font:15px/1.4 system-ui,sans-serif;max-width:32rem;cursor:pointer;" +
      "box-shadow:0 2px 12px #0006";
    note.onclick = () => note.remove();
    document.body.appendChild(note);
    setTimeout(() => note.remove(), 15000);
  };

  const table = Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
    return n;
  });
  const crc32 = (bytes) => {
    let c = 0xffffffff;
    for (let i = 0; i < bytes.length; i++) c = table[(c ^ bytes[i]) & 255] ^ (c >>> 8);
    return (c ^ 0xffffffff) >>> 0;
  };
  const record = (fields) => {
    const out = new DataView(new ArrayBuffer(fields.reduce((n, [size]) => n + size, 0)));
    let at = 0;
    for (const [size, value] of fields) {
      size === 2 ? out.setUint16(at, value, true) : out.setUint32(at, value, true);
      at += size;
    }
    return new Uint8Array(out.buffer);
  };
  // A zip whose entries are stored as they are: the server unpacks it at once.
  const zip = async (files) => {
    const blobs = [], directory = [];
    let offset = 0, size = 0;
    for (const file of files) {
      const bytes = new Uint8Array(await file.arrayBuffer());
      const name = new TextEncoder().encode(file.webkitRelativePath || file.name);
      const common = [[2, 20], [2, 0x0800], [2, 0], [2, 0], [2, 33], [4, crc32(bytes)],
        [4, bytes.length], [4, bytes.length], [2, name.length], [2, 0]];
      const head = record([[4, 0x04034b50], ...common]);
      const entry = record([[4, 0x02014b50], [2, 20], ...common, [2, 0], [2, 0], [2, 0], [4, 0],
        [4, offset]]);
      blobs.push(head, name, bytes);
      directory.push(entry, name);
      offset += head.length + name.length + bytes.length;
      size += entry.length + name.length;
    }
    const end = record([[4, 0x06054b50], [2, 0], [2, 0], [2, files.length], [2, files.length],
      [4, size], [4, offset], [2, 0]]);
    return new Blob([...blobs, ...directory, end], { type: "application/zip" });
  };

  const packed = new WeakSet();
  window.addEventListener("click", (event) => {
    const input = event.target;
    if (input instanceof HTMLInputElement && input.type === "file") input.multiple = true;
  }, true);
  window.addEventListener("change", (event) => {
    const input = event.target;
    if (!(input instanceof HTMLInputElement) || input.type !== "file") return;
    const files = [...(input.files || [])];
    const total = files.reduce((n, file) => n + file.size, 0);
    if (total > limit) {
      event.stopImmediatePropagation();
      input.value = "";
      const what = files.length === 1 ? files[0].name + " has " : "the files together have ";
      tell("Upload refused: " + what + readable(total) + "; the limit is " + readable(limit) +
        ". Put large files on the server and open them by path.");
      return;
    }
    if (files.length < 2 || packed.has(input.files)) return;
    event.stopImmediatePropagation();
    // Named after the file that a person would open: not a texture, not a material.
    const main = files.find((f) => /\.(urdf|obj|gltf|glb|ply|stl)$/i.test(f.name)) || files[0];
    const name = main.name.replace(/\.[^.]*$/, "") + ".zip";
    zip(files).then((blob) => {
      const one = new DataTransfer();
      one.items.add(new File([blob], name, { type: "application/zip" }));
      input.files = one.files;
      packed.add(input.files);
      input.dispatchEvent(new Event("change", { bubbles: true }));
    }, () => tell("Upload failed: a file could not be read."));
  }, true);
})();
