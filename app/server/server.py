"""The server: guard, application state, one user interface a browser tab."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

import viser

from app.server.api.application import make_application
from app.server.api.project import WebhookSender
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.ending import EndSignals
from app.server.entrance import Entrance
from app.server.gallery import Gallery, whole_number
from app.server.guard import Route, RouteAnswer, RouteRequest, guarded_server
from app.server.login import Login, OidcLogin
from app.server.network import url
from app.server.uploads import keep_upload
from model.core.errors import InputFileError, StoreError
from model.core.files import static_assets
from model.io.formats.loaded import DEFAULT_MAX_BYTES, open_file
from model.io.model_files import find_assets, refusal
from model.io.zips import is_zip
from sessions.credentials import Person
from sessions.store import Store

log = logging.getLogger(__name__)


class Tab(Protocol):
    """The user interface of one browser tab."""

    def close(self) -> None:
        """Stop drawing: the browser is gone."""
        ...


def queue_routes(gallery: Gallery) -> dict[str, Route]:
    """HTTP routes of the queue: pieces of the list, and thumbnails."""

    def rows(request: RouteRequest) -> RouteAnswer:
        return RouteAnswer(json.dumps(gallery.rows(request.query), separators=(",", ":")).encode())

    def thumbnail(request: RouteRequest) -> RouteAnswer:
        image = gallery.thumbnail(whole_number(request.query.get("id"), 0))
        return RouteAnswer(image or b"", "image/webp", 204 if image is None else 200)

    return {"/queue.json": rows, "/thumbnail": thumbnail}


class Server:
    """A running ArtiWorld server; ``close()`` ends it.

    Args:
        open_tab: makes the user interface of a browser that connects, for whom it belongs to.
    """

    def __init__(
        self, config: ServeConfig, open_tab: Callable[[viser.ClientHandle, AppState, Person], Tab]
    ) -> None:
        self.config = config
        self._open_tab = open_tab
        paths = paths_to_open(config)
        self.app_state = AppState(config, opened_store(config), paths)
        if config.scene is not None:
            self.app_state.open_scene(config.scene, config.assets)
        people = self.app_state.store.people
        self.entrance = Entrance(
            people,
            Login(config.token),
            config.user,
            None if config.oidc is None else OidcLogin(config.oidc, people),
        )
        self._webhooks = WebhookSender(people.webhooks)
        self.viser: viser.ViserServer = guarded_server(
            config.host,
            config.port,
            config.token,
            config.max_upload_mb * 1_000_000,
            queue_routes(self.app_state.gallery),
            label="ArtiWorld",
            allowed_origins=config.allowed_origins,
            trusted_proxies=config.trusted_proxies,
            entrance=self.entrance,
            api=lambda origins: make_application(self.app_state, self.entrance, origins),
            room=self.app_state.room,
        )
        self.apps: dict[int, Tab] = {}
        self.viser.on_client_connect(self._connected)
        self.viser.on_client_disconnect(self._disconnected)

    def _connected(self, client: viser.ClientHandle) -> None:
        person = self.entrance.tabs.get(client.client_id)
        if person is not None:  # else the browser is gone already
            self.apps[client.client_id] = self._open_tab(client, self.app_state, person)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        app = self.apps.pop(client.client_id, None)
        if app is not None:
            app.close()

    @property
    def url(self) -> str:
        """The server's URL."""
        return url(self.config.host, self.viser.get_port())

    @property
    def login_url(self) -> str:
        """The URL that logs a browser in."""
        token = None if self.entrance.with_accounts else self.config.token
        return self.url if token is None else f"{self.url}/login?token={quote(token)}"

    def close(self) -> None:
        """End the tabs, the workers and the listener."""
        for app in list(self.apps.values()):
            app.close()
        with contextlib.redirect_stdout(io.StringIO()):  # it says so, where --json writes, too
            self.viser.stop()
        self._webhooks.close()
        self.app_state.close()


def opened_store(config: ServeConfig) -> Store:
    """Open the workspace, and ask its storage for something.

    Raises:
        StoreError: where one of them can't be used.
    """
    store = Store(Path(config.workspace), config.database, storage=config.storage)
    try:
        store.assets.check()
    except StoreError:
        store.close()
        raise
    return store


def paths_to_open(config: ServeConfig) -> list[Path]:
    """Return the objects of this run: the named ones, else the bundled examples.

    Raises:
        InputFileError: where none of them can be opened.
    """
    if config.scene is not None:
        return []
    named = [Path(p) for p in config.paths]
    for path in named:
        if not path.exists():
            raise InputFileError(path, "doesn't exist", "give a file or a folder that does")
    uploads = Path(config.workspace) / "uploads"
    named = [
        keep_upload(uploads, p.name, open_file(p), DEFAULT_MAX_BYTES) if is_zip(p) else p
        for p in named
    ]
    found = find_assets(named or [static_assets() / "examples"])
    if not found:
        where = named[0] if named else static_assets() / "examples"
        raise InputFileError(where, "holds nothing that can be opened", "give meshes or scans")
    problems = [problem for path in found if (problem := refusal(path)) is not None]
    if len(problems) == len(found):
        raise problems[0]
    for problem in problems:
        log.warning("%s", problem)
    return found


def run_until_interrupted(server: Server, end: EndSignals, *, open_browser: bool = False) -> None:
    """Print the addresses and serve until a signal ends it."""
    end.begin_serving()  # before anybody is told that it is ready
    if server.login_url != server.url:
        print(f"Log in at {server.login_url}", flush=True)
    print(f"ArtiWorld is ready: {server.url}", flush=True)
    if open_browser:
        threading.Thread(target=webbrowser.open, args=(server.login_url,), daemon=True).start()
    end.wait()
    server.close()
