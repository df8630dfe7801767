"""A server with accounts, and clients that log in like a browser or with a token."""

from __future__ import annotations

import http.client
import itertools
import json
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from app.cli.serve import start_server
from app.client import Client
from app.server.config import ServeConfig
from app.server.server import Server
from sessions.store import Store
from tests.builders import wait_until, zip_of_objects
from tests.sessions.people import PASSWORD, add_people

CAMERA = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "fov": 1.0, "near": 0.1}
CAMERA |= {"far": 10.0, "image_height": 10, "image_width": 20, "look_at": (0.0, 0.0, 0.0)}
CAMERA |= {"up_direction": (0.0, 0.0, 1.0)}


@contextmanager
def team_server(
    folder: Path, *paths: Path, accounts: bool = True, **settings: Any
) -> Iterator[Server]:
    """A server of ``paths``, with the accounts of :func:`add_people`."""
    if accounts:
        store = Store(folder)
        add_people(store)
        store.close()
    server = start_server(ServeConfig(paths=paths, workspace=folder, port=0, **settings))
    try:
        yield server
    finally:
        server.close()


class Browser:
    """Requests with cookies, without redirects, so that each answer is seen."""

    def __init__(self, server: Server) -> None:
        self.port = server.viser.get_port()
        self.cookie: str | None = None

    def ask(
        self, method: str, path: str, body: Any = None, own: bool = True, **headers: str
    ) -> tuple[int, Any]:
        """Return status and JSON (or bytes) of the answer."""
        fields = {name.replace("_", "-"): value for name, value in headers.items()}
        if own:
            fields["X-ArtiWorld"] = "1"
        if self.cookie:
            fields["Cookie"] = self.cookie
        data = None if body is None else json.dumps(body).encode()
        if data is not None:
            fields["Content-Type"] = "application/json"
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method, path, data, fields)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if answer.headers["Set-Cookie"]:
            self.cookie = answer.headers["Set-Cookie"].partition(";")[0]
        kind = answer.headers.get("Content-Type", "")
        return answer.status, json.loads(content) if kind == "application/json" else content

    def api(self, method: str, path: str, body: Any = None, **settings: Any) -> tuple[int, Any]:
        """Ask a route of the API."""
        return self.ask(method, f"/api/v1{path}", body, **settings)

    def log_in(self, name: str, password: str = PASSWORD) -> int:
        """Log in; returns the status."""
        return self.api("POST", "/login", {"name": name, "password": password})[0]


def token_client(server: Server, name: str, *scopes: str) -> Client:
    """A client with a token of that account and those scopes."""
    people = server.app_state.store.people
    secret = people.credentials.make_token(people.accounts.find(name), "test", scopes)
    return Client(f"http://127.0.0.1:{server.viser.get_port()}", secret)


class WebTab:
    """The messages of a browser tab without a browser.

    Args:
        memory: what the browser claims to remember of the tab, its user's name first.
    """

    def __init__(self, browser: Browser, memory: str = "") -> None:
        self.memory, self.closed = memory, threading.Event()
        self.widgets: dict[str, tuple[str, Any]] = {}
        self._socket = connect(
            f"ws://127.0.0.1:{browser.port}/",
            additional_headers={"Cookie": browser.cookie} if browser.cookie else {},
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            max_size=None,
            proxy=None,
        )
        threading.Thread(target=self._read, daemon=True).start()
        # viser knows a client from its first camera message on.
        self.send("ViewerCameraMessage", **CAMERA)

    def send(self, kind: str, **fields: Any) -> None:
        """Send one message."""
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def press(self, label: str, value: Any = True) -> None:
        """Send what a browser sends at a click, shown or not."""
        uuid = wait_until(lambda: self._find(label), f"a widget {label}", 60)
        self.send("GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def texts(self) -> list[str]:
        """Return the present labels and contents of all widgets."""
        return [text for text, _ in list(self.widgets.values())]

    def close(self) -> None:
        """Close the tab."""
        self._socket.close()

    def _find(self, label: str) -> str | None:
        return next((u for u, (text, _) in list(self.widgets.items()) if text == label), None)

    def _read(self) -> None:
        try:
            for data in self._socket:
                assert isinstance(data, bytes)
                packed = int.from_bytes(data[8:16], "little")
                inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed])
                for message in msgspec.msgpack.decode(inner)["messages"]:
                    self._heard(message)
        except ConnectionClosed:
            pass
        finally:
            self.closed.set()

    def _heard(self, message: dict[str, Any]) -> None:
        if message["type"] == "LocalStorageGetItemRequestMessage":
            told = {"value": self.memory, "error": None, "request_uuid": message["request_uuid"]}
            self.send("LocalStorageGetItemResponseMessage", **told)
        elif "props" in message and "uuid" in message:
            props = message["props"]
            note = f"{props['title']}: {props['body']}" if "title" in props else ""
            text = (
                note or props.get("label") or props.get("_markdown") or props.get("content") or ""
            )
            self.widgets[message["uuid"]] = (text, props)
        elif message["type"] == "GuiUpdateMessage" and message["uuid"] in self.widgets:
            text, props = self.widgets[message["uuid"]]
            new = message["updates"]
            text = new.get("label") or new.get("_markdown") or new.get("content") or text
            self.widgets[message["uuid"]] = (text, props | new)


def upload_at_once(folder: Path, clients: Sequence[Client], round_: int) -> None:
    """Upload a zip of 60 objects five times and an OBJ five times, all at the same time.

    Args:
        folder: for the files. clients: who take turns.

    Raises:
        ApiError: where a server refuses one.
    """
    folder.mkdir()
    (folder / "objects.zip").write_bytes(zip_of_objects(60, round_))
    (folder / "one.obj").write_text(f"v 0 0 {round_}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    files = [folder / name for name in ("objects.zip", "one.obj")] * 5
    with ThreadPoolExecutor(len(files)) as pool:
        turns = itertools.cycle(clients)
        uploads = [pool.submit(client.upload, f) for client, f in zip(turns, files, strict=False)]
        ids = [upload.result()["id"] for upload in uploads]
    assert len(set(ids[::2])) == len(set(ids[1::2])) == 1
