"""viser's page with our title and the scripts of ``app/server/scripts``."""

from __future__ import annotations

import gzip
import json
from importlib.resources import files

from websockets.http11 import Response

_SCRIPTS = (
    "upload.js", "focus.js", "panels.js", "markup.js", "queue.js", "view.js", "tree.js",
    "pointer.js", "light.js", "account.js",
)  # fmt: skip
_STYLES = ("style.css", "controls.css", "project.css")


def _script(max_upload_bytes: int) -> str:
    scripts = files("app.server") / "scripts"
    texts = [(scripts / name).read_text() for name in _SCRIPTS]
    style = "".join(f"<style>\n{(scripts / name).read_text()}</style>\n" for name in _STYLES)
    whole = style + "\n".join(f"<script>\n{text}</script>" for text in texts)
    return whole.replace("__LIMIT__", json.dumps(max_upload_bytes))


class Page:
    """Adds our title and scripts to viser's page, once for each encoding.

    Args:
        title: title of the browser's tab.
        max_upload_bytes: larger files are refused by the page itself.
    """

    def __init__(self, title: str, max_upload_bytes: int) -> None:
        self._title = title
        self._script = _script(max_upload_bytes)
        self._bodies: dict[str, bytes] = {}

    def prepare(self, response: Response) -> Response:
        """Return ``response`` with the title and the scripts; unchanged where it isn't the page."""
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
