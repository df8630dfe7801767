"""Settings of the commands, as documented dataclasses."""

from __future__ import annotations

import getpass
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from model.prediction import DEFAULT as DEFAULT_PREDICTOR

if TYPE_CHECKING:
    from model.core.asset import UpAxis  # which reads numpy, and a help page needs none

TOKEN_VARIABLE = "ARTIWORLD_TOKEN"
"""Environment variable that may hold the token, so that it stands in no list of processes."""


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
        workspace: where sessions, working copies and accepted assets are kept.
        database: SQLAlchemy URL; None is SQLite inside the workspace.
        host: where to listen; any other than this machine needs a token.
        port: 0 for any free one.
        token: what visitors must know.
        user: name written beside decisions until the browser gives another.
        up_axis: of the files; None is each format's default.
        unit_scale: metres per unit of the files.
        max_upload_mb: largest file that a browser may send.
        segmenter: who answers clicks.
        predictor: who predicts joints.
        allowed_origins: addresses under which a proxy shows the server, besides its own.
        scene: a scene to open instead of single objects.
        assets: folders of its assets.
        finder, finder_url: who says what in it can be articulated, and where that is asked.
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
    scene: Path | None = None
    assets: tuple[Path, ...] = ()
    finder: str = "lexicon"
    finder_url: str | None = None
