"""``artiworld serve``: from options to a running server."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.backend_command import add_client_options, chosen_predictor, greet
from app.cli.options import add_point_sam, add_reading
from app.server.config import TOKEN_VARIABLE, ServeConfig
from app.server.login import Login, new_token
from app.server.network import check_address, free_port, is_loopback
from model.core.errors import ConfigurationError, InputFileError
from model.prediction.registry import DEFAULT
from model.prediction.remote import is_backend

if TYPE_CHECKING:
    from app.server.server import Server


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("paths", nargs="*", type=Path, metavar="PATH",
        help="meshes, scans, URDFs, MJCFs or folders to open, or one scene "
             "(default: the bundled examples)")  # fmt: skip
    add("--assets", type=Path, action="append", default=[], metavar="DIR",
        help="open PATH as a scene with the assets in this folder; may be repeated "
             "(a scene description without it: those beside it)")  # fmt: skip
    add("--scene", action="store_true",
        help="open PATH as a scene even where it is a mesh or a scan, such as a scanned room "
             "out of which objects are picked")  # fmt: skip
    add("--finder", default="lexicon", metavar="NAME",
        help="who says what in a scene can be articulated, as scene convert takes it "
             "(default: lexicon)")  # fmt: skip
    add("--finder-url", metavar="URL",
        help="openai finder: address of the server, such as http://localhost:11434/v1")  # fmt: skip
    add("--workspace", type=Path, default=Path("workspace"), metavar="DIR",
        help="where sessions and accepted assets are kept (default: ./workspace)")  # fmt: skip
    add("--database", metavar="URL",
        help="URL of a SQLite or PostgreSQL database (default: one in the workspace)")  # fmt: skip
    add(
        "--host", default="127.0.0.1", help="where to listen; others than this machine need a token"
    )
    add(
        "--port", type=int, help="port to listen at; 0 for any (default: 8080 or the next free one)"
    )
    add("--token", help="what visitors must know; or set ARTIWORLD_TOKEN")
    add("--allow-origin", action="append", default=[], metavar="URL",
        help="address under which a proxy shows the server; may be repeated")  # fmt: skip
    add("--user", help="name written beside decisions (default: your login name)")
    add_reading(parser)
    add("--max-upload-mb", type=int, default=500, metavar="MB",
        help="largest file that a browser may send (default: 500)")  # fmt: skip
    add("--segmenter", default="default", metavar="NAME", help="who answers clicks")
    add_point_sam(parser)
    add("--predictor", default=DEFAULT, metavar="NAME", help="who predicts joints")
    add_client_options(parser, "--backend-token")
    add("--open", action=argparse.BooleanOptionalAction, default=False, help="open a browser")


def run(args: argparse.Namespace) -> int:
    """Check the options while nothing is running yet, then serve until interrupted."""
    config = make_config(args)
    from app.server.server import run_until_interrupted

    run_until_interrupted(start_server(config), open_browser=args.open)
    return 0


def start_server(config: ServeConfig) -> Server:
    """Start a server that shows the application in each browser tab; ``close()`` ends it."""
    from app.server.server import Server  # imports viser
    from app.viewer.client_app import ClientApp

    return Server(config, ClientApp)


def make_config(args: argparse.Namespace) -> ServeConfig:
    """The settings of the server.

    Raises:
        ConfigurationError, InputFileError: where an option can't work.
    """
    for path in args.paths:
        if not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
    if args.max_upload_mb <= 0:
        raise ConfigurationError(f"--max-upload-mb {args.max_upload_mb} must be above 0")
    for origin in args.allow_origin:
        if not origin.startswith(("http://", "https://")):
            raise ConfigurationError(
                f"--allow-origin {origin} is no address; give one like https://scans.example.org"
            )
    token = args.token or os.environ.get(TOKEN_VARIABLE) or None
    if token is None and not is_loopback(args.host):
        token = new_token()
    Login(token)  # refuses one that is too short
    _check_names(args)
    predictor = chosen_predictor(args)
    if is_backend(predictor):
        greet(predictor)
    port = args.port
    if port is None:
        port = free_port(args.host)
    else:
        check_address(args.host, port)
    scene = _scene_of(args)
    settings = {} if args.user is None else {"user": args.user}
    return ServeConfig(
        paths=() if scene else tuple(args.paths),
        workspace=args.workspace,
        database=args.database,
        host=args.host,
        port=port,
        token=token,
        up_axis=args.up_axis,
        unit_scale=args.unit_scale,
        max_upload_mb=args.max_upload_mb,
        segmenter=args.segmenter,
        predictor=predictor,
        allowed_origins=tuple(args.allow_origin),
        scene=scene,
        assets=tuple(args.assets) or (() if scene is None else (scene.parent,)),
        finder=args.finder,
        finder_url=args.finder_url,
        **settings,
    )


def _scene_of(args: argparse.Namespace) -> Path | None:
    """The scene to open; None for single objects.

    Raises:
        ConfigurationError, InputFileError: where ``--assets`` can't belong to what is named.
    """
    from model.io.geometry_files import SUFFIXES
    from model.io.model_files import is_model
    from model.scenes.registry import recognised

    first: Path | None = args.paths[0] if args.paths else None
    if not (args.assets or args.scene) and (
        first is None or first.is_dir() or first.suffix.lower() in SUFFIXES or is_model(first)
        or not recognised(first)
    ):  # fmt: skip
        return None
    if first is None or len(args.paths) > 1 or first.is_dir():
        raise ConfigurationError("a scene is opened alone: give one scene file, and its --assets")
    for folder in args.assets:
        if not folder.is_dir():
            raise InputFileError(folder, "no such folder", "give --assets a folder of assets")
    return first


def _check_names(args: argparse.Namespace) -> None:
    from model.prediction.registry import check_predictor
    from model.segmentation.registry import check_segmenter

    check_segmenter(args.segmenter)
    if args.finder != "lexicon":
        from model.scenes.finder_registry import FinderOptions, load_finder

        load_finder(args.finder, FinderOptions(args.finder_url))
    check_predictor(args.predictor)
