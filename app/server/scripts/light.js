// Where a processor draws, reflections take most of each frame: who has chosen nothing yet begins
// with plain light. What is written is what the application remembers here (navigation.Memory).
(() => {
  const key = "viser-user:artiworld";
  try {
    if (localStorage.getItem(key) !== null) return;
    const gl = document.createElement("canvas").getContext("webgl");
    if (gl === null) return;
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    const drawer = gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    if (/swiftshader|llvmpipe|softpipe|basic render|software/i.test(drawer)) {
      localStorage.setItem(key, "\n\n\nplain\n");
    }
  } catch {
    // Without a memory, or without WebGL, it stays as it is.
  }
})();
