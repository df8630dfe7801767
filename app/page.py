"""viser's page with our title and two small scripts.

One refuses large files before they are sent: the server refuses them too (:mod:`app.upload_guard`),
but viser's page goes on sending parts to a server that throws them away. The other gives the
keyboard back after a choice: a box that keeps the focus swallows the keys.
"""

from __future__ import annotations

import gzip
import json

from websockets.http11 import Response

_SCRIPT = """<script>
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
  window.addEventListener("change", (event) => {
    const input = event.target;
    if (!(input instanceof HTMLInputElement) || input.type !== "file") return;
    const large = [...(input.files || [])].find((file) => file.size > limit);
    if (!large) return;
    event.stopImmediatePropagation();
    input.value = "";
    tell("Upload refused: " + large.name + " has " + readable(large.size) + "; the limit is " +
      readable(limit) + ". Put large files on the server and open them by path.");
  }, true);
})();
(() => {
  const release = () => setTimeout(() => {
    const held = document.activeElement;
    if (held instanceof HTMLElement && !(held instanceof HTMLTextAreaElement)) held.blur();
  }, 60);
  const done = '[role="option"], button, input[type="checkbox"], [role="slider"], canvas';
  window.addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest(done)) release();
  }, true);
  window.addEventListener("keydown", (event) => {
    const ends = event.key === "Enter" || event.key === "Escape";
    if (ends && event.target instanceof HTMLInputElement) release();
  }, true);
})();
</script>"""


class Page:
    """Turns viser's answer for its page into ours, once for each encoding.

    Args:
        title: of the browser's tab.
        max_upload_bytes: larger files are refused by the page itself.
    """

    def __init__(self, title: str, max_upload_bytes: int) -> None:
        self._title = title
        self._script = _SCRIPT.replace("__LIMIT__", json.dumps(max_upload_bytes))
        self._bodies: dict[str, bytes] = {}

    def prepare(self, response: Response) -> Response:
        """``response`` with the title and the script; unchanged where it is no page."""
        headers = response.headers
        if response.status_code != 200 or "text/html" not in headers.get("Content-Type", ""):
            return response
        encoding = headers.get("Content-Encoding", "identity")
        if encoding not in self._bodies:
            body = bytes(response.body)
            packed = encoding == "gzip"
            text = (gzip.decompress(body) if packed else body).decode()
            text = text.replace("<title>Viser</title>", f"<title>{self._title}</title>", 1)
            text = text.replace("<head>", "<head>" + self._script, 1)
            self._bodies[encoding] = gzip.compress(text.encode()) if packed else text.encode()
        response.body = self._bodies[encoding]
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))
        return response
