"""The server: guard, workbench, one application a tab."""

from __future__ import annotations

import logging
import signal
import threading
import webbrowser
from pathlib import Path
from urllib.parse import quote

import viser

from app.cli.config import ServeConfig
from app.server.app_state import Workbench
from app.server.guard import guarded_server
from app.server.network import url
from app.server.scene_workspace import SceneDesk
from app.viewer.client_app import ClientApp
from model.core.errors import InputFileError
from model.core.resources import static_assets
from sessions.store import Store

log = logging.getLogger(__name__)


class Server:
    """A running ArtiWorld server; ``close()`` ends it."""

    def __init__(self, config: ServeConfig) -> None:
        self.config = config
        paths = paths_to_open(config)
        self.bench = Workbench(config, Store(Path(config.workspace), config.database), paths)
        if config.scene is not None:
            self.bench.desk = SceneDesk(self.bench, config.scene, config.assets)
        self.viser: viser.ViserServer = guarded_server(
            config.host,
            config.port,
            config.token,
            config.max_upload_mb * 1_000_000,
            label="ArtiWorld",
            allowed_origins=config.allowed_origins,
        )
        self.apps: dict[int, ClientApp] = {}
        self.viser.on_client_connect(self._connected)
        self.viser.on_client_disconnect(self._disconnected)

    def _connected(self, client: viser.ClientHandle) -> None:
        self.apps[client.client_id] = ClientApp(client, self.bench)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        app = self.apps.pop(client.client_id, None)
        if app is not None:
            app.close()

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return url(self.config.host, self.viser.get_port())

    @property
    def login_url(self) -> str:
        """Where a browser finds it and is logged in."""
        token = self.config.token
        return self.url if token is None else f"{self.url}/login?token={quote(token)}"

    def close(self) -> None:
        """End the tabs, the workers and the listener."""
        for app in list(self.apps.values()):
            app.close()
        self.viser.stop()
        self.bench.close()


def paths_to_open(config: ServeConfig) -> list[Path]:
    """The objects of this run: what was named, else the bundled examples.

    Raises:
        InputFileError: where none of them can be opened whatever is in it.
    """
    from model.io.readers import find_assets, refusal

    if config.scene is not None:
        return []
    named = [Path(p) for p in config.paths]
    for path in named:
        if not path.exists():
            raise InputFileError(path, "doesn't exist", "give a file or a folder that does")
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


def serve(config: ServeConfig, *, open_browser: bool = False) -> None:
    """Run until interrupted."""
    server = Server(config)
    if config.token is not None:
        print(f"Log in at {server.login_url}", flush=True)
    print(f"ArtiWorld is ready: {server.url}", flush=True)
    if open_browser:
        threading.Thread(target=webbrowser.open, args=(server.login_url,), daemon=True).start()
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    stop.wait()
    server.close()
