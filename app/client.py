"""A client of the REST API that needs nothing but Python's own library.

Example::

    from app.client import Client

    client = Client("http://localhost:8080", token="awt_…")
    oven = client.upload("oven.glb")
    client.command(oven["id"], kind="set_category", category="Oven")
    client.predict(oven["id"])
"""

from __future__ import annotations

import hashlib
import hmac
import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

from model.core.errors import ArtiworldError

API = "/api/v1"
SECONDS = 120.0
"""Longest wait for an answer: opening a large scan takes a minute."""
MOST_AGE = 300.0
"""Seconds after which a webhook's message is refused, so that nobody plays it again."""


class ApiError(ArtiworldError):
    """The server refused a request.

    Attributes:
        status: of the HTTP response; 0 where there was none.
    """

    def __init__(self, status: int, message: str) -> None:
        self.status = status
        super().__init__(message)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Refuses redirects: a token must not go to another server."""

    def redirect_request(self, *_: Any) -> None:
        """See the base class."""


class Client:
    """Calls one server.

    Args:
        url: address of the server, such as ``https://scans.example.org``.
        token: of an account; None where the server asks for none.
    """

    def __init__(self, url: str, token: str | None = None) -> None:
        if urlsplit(url).scheme not in ("http", "https"):
            raise ArtiworldError(f"{url} is no address; give one like http://localhost:8080")
        self._url, self._token = url.rstrip("/") + API, token
        self._opener = urllib.request.build_opener(_NoRedirect)

    def call(self, method: str, path: str, body: Any = None, **query: Any) -> Any:
        """Call any route and return its JSON; see ``/api/v1/docs`` of the server.

        Raises:
            ApiError: where the server refuses, with its reason.
        """
        return json.loads(self._raw(method, path, body, query))

    def upload(self, path: str | Path, name: str | None = None) -> dict[str, Any]:
        """Add a file, or a zip of several; returns the object."""
        file = Path(path)
        return self.call("POST", "/objects", file.read_bytes(), name=name or file.name)

    def objects(self, **filters: Any) -> Iterator[dict[str, Any]]:
        """Yield objects in the order of the queue.

        Args:
            filters: ``state``, ``category``, ``search``, ``assigned_to``.
        """
        first = 0
        while True:
            page = self.call("GET", "/objects", first=first, **filters)["objects"]
            yield from page
            if not page:
                return
            first += len(page)

    def object(self, object_id: int) -> dict[str, Any]:
        """Return what is decided about an object."""
        return self.call("GET", f"/objects/{object_id}")

    def command(self, object_id: int, *, labels: bool = False, **command: Any) -> dict[str, Any]:
        """Give one command, ``kind`` and its fields; returns the object after it.

        Args:
            labels: whether to wait until the labels that follow from it are there.
        """
        body = {"command": command, "labels": labels}
        return self.call("POST", f"/objects/{object_id}/commands", body)

    def undo(self, object_id: int) -> dict[str, Any]:
        """Take back the last decision."""
        return self.call("POST", f"/objects/{object_id}/undo", {})

    def predict(self, object_id: int, seconds: float = 600.0) -> dict[str, Any]:
        """Predict the joints, and wait for them."""
        path = f"/objects/{object_id}/prediction"
        self.call("POST", path, {})
        end = time.monotonic() + seconds
        while (found := self.call("GET", path))["running"]:
            if time.monotonic() > end:
                raise ApiError(0, f"no prediction of object {object_id} after {seconds:g} s")
            time.sleep(0.2)
        return found

    def submit(self, object_id: int, comment: str = "") -> dict[str, Any]:
        """Hand an object in for review."""
        return self.call("POST", f"/objects/{object_id}/submit", {"comment": comment})

    def accept(self, object_id: int, comment: str = "", **how: Any) -> dict[str, Any]:
        """Accept an object; ``override`` and ``warnings_seen`` as in the review step."""
        return self.call("POST", f"/objects/{object_id}/accept", {"comment": comment, **how})

    def reject(
        self,
        object_id: int,
        reason: str,
        comment: str = "",
        *,
        joint: str = "",
        place: Sequence[float] | None = None,
    ) -> dict[str, Any]:
        """Send an object back, with a comment about a joint or a place (3,) in metres."""
        body = {"reason": reason, "comment": comment, "joint": joint, "place": place}
        return self.call("POST", f"/objects/{object_id}/reject", body)

    def comment(
        self,
        object_id: int,
        text: str,
        *,
        joint: str = "",
        place: Sequence[float] | None = None,
    ) -> dict[str, Any]:
        """Pin a comment to a joint or a place (3,) in metres."""
        body = {"text": text, "joint": joint, "place": place}
        return self.call("POST", f"/objects/{object_id}/comments", body)

    def resolve(self, object_id: int, number: int, done: bool = True) -> dict[str, Any]:
        """Mark a comment as done."""
        return self.call("PUT", f"/objects/{object_id}/comments/{number}", {"done": done})

    def add_region(
        self, object_id: int, part: int, elements: Sequence[int], positive: bool = True
    ) -> dict[str, Any]:
        """Say that elements (faces or points, from 0) belong to a part, or that they don't."""
        body = {"part": part, "elements": list(elements), "positive": positive}
        return self.call("POST", f"/objects/{object_id}/regions", body)

    def next(self) -> int | None:
        """Lease the next object to work on; None where nothing waits."""
        return self.call("POST", "/next", {})["id"]

    def download(self, object_id: int, path: str | Path, format: str = "asset") -> Path:
        """Write an accepted object as a zip to ``path``."""
        content = self._raw("GET", f"/assets/{object_id}", None, {"format": format})
        Path(path).write_bytes(content)
        return Path(path)

    def _raw(self, method: str, path: str, body: Any, query: dict[str, Any]) -> bytes:
        asked = {k: v for k, v in query.items() if v is not None}
        url = self._url + quote(path) + (f"?{urlencode(asked)}" if asked else "")
        headers = {"X-ArtiWorld": "1", "Content-Type": "application/json"}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        data = body
        if body is not None and not isinstance(body, bytes):
            data = json.dumps(body).encode()
        elif body is not None:
            headers["Content-Type"] = "application/octet-stream"
        request = urllib.request.Request(url, data, headers, method=method)
        try:
            with self._opener.open(request, timeout=SECONDS) as answer:
                job = answer.headers["Location"]
                content = answer.read()
        except urllib.error.HTTPError as error:
            raise ApiError(error.code, _reason(error)) from error
        except OSError as error:
            raise ApiError(0, f"{self._url} doesn't answer ({error})") from error
        # It takes long: the answer is where to ask for it.
        return content if job is None else self._raw("GET", job.removeprefix(API), None, {})


def is_genuine(secret: str, header: str, payload: bytes, now: float | None = None) -> bool:
    """Return whether a webhook's message is recent and comes from the server.

    Args:
        secret: of the webhook.
        header: value of ``X-ArtiWorld-Signature``.
        payload: the body as it arrived.
        now: Unix time in seconds; None: the clock's.
    """
    fields: dict[str, str] = {}
    for part in header.split(","):
        name, _, value = part.partition("=")
        fields[name] = value
    at = fields.get("t", "")
    if not at.isdigit() or abs((time.time() if now is None else now) - int(at)) > MOST_AGE:
        return False
    code = hmac.new(secret.encode(), f"{at}.".encode() + payload, hashlib.sha256).hexdigest()
    return hmac.compare_digest(code, fields.get("v1", ""))


def _reason(error: urllib.error.HTTPError) -> str:
    try:
        return str(json.loads(error.read())["error"])
    except (ValueError, KeyError, TypeError, OSError):
        return f"the server answered {error.code}"
