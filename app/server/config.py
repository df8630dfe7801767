"""Settings of the server."""

from __future__ import annotations

import getpass
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from model.prediction import DEFAULT as DEFAULT_PREDICTOR

if TYPE_CHECKING:
    from app.server.login import OidcSettings
    from model.core.asset import UpAxis  # imports numpy, which a help page doesn't need

TOKEN_VARIABLE = "ARTIWORLD_TOKEN"
"""Environment variable that may hold the token, so that no list of processes shows it."""


def _default_user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "annotator"


@dataclass(frozen=True)
class ServeConfig:
    """Settings of ``artiworld serve``.

    Attributes:
        paths: files or folders to open; none: the bundled examples.
        workspace: folder of sessions, working copies and accepted assets.
        database: SQLAlchemy URL; None is SQLite inside the workspace.
        host: address to listen at; any but this machine's own needs a token.
        port: port to listen at; 0 for any free one.
        token: token of the visitors.
        user: author of decisions until the browser gives a name.
        up_axis: up axis of the files; None is each format's default.
        unit_scale: metres per unit of the files.
        max_upload_mb: largest upload from a browser.
        segmenter, predictor: names of the segmenter and the predictor.
        allowed_origins: other addresses of the server behind a proxy.
        trusted_proxies: addresses or networks of proxies whose X-Forwarded-For is trusted.
        scene: a scene to open instead of single objects.
        assets: folders of its assets.
        masks: masks of another system, from which the one path starts.
        storage: address of the storage of assets; None is the workspace.
        oidc: how people log in with an organisation's provider; None: they don't.
        finder, finder_url: name of the finder of articulable objects, and its server.
    """

    paths: tuple[Path, ...] = ()
    workspace: Path = Path("workspace")
    database: str | None = None
    host: str = "127.0.0.1"
    port: int = 8080
    token: str | None = None
    user: str = field(default_factory=_default_user)
    up_axis: UpAxis | None = None
    unit_scale: float = 1.0
    max_upload_mb: int = 500
    segmenter: str = "default"
    predictor: str = DEFAULT_PREDICTOR
    allowed_origins: tuple[str, ...] = ()
    trusted_proxies: tuple[str, ...] = ()
    scene: Path | None = None
    assets: tuple[Path, ...] = ()
    masks: Path | None = None
    finder: str = "lexicon"
    finder_url: str | None = None
    storage: str | None = None
    oidc: OidcSettings | None = None
