"""``artiworld serve`` and ``artiworld backend``: from their options to a running server."""

from __future__ import annotations

import ipaddress
import os
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.commands import BackendCommand, ServeCommand
from app.cli.options import OidcOptions
from app.cli.output import Result
from app.cli.predict import check_backend, chosen_predictor
from app.server import backend_server
from app.server.config import TOKEN_VARIABLE, ServeConfig
from app.server.ending import EndSignals
from app.server.jobs import WorkerProcess
from app.server.login import SECRET_VARIABLE, Login, OidcSettings, new_token
from app.server.network import check_address, free_port, is_loopback, url
from model.core.errors import ConfigurationError, InputFileError
from model.core.packages import install_command
from model.core.progress import Progress
from model.io.geometry_files import STAGES, SUFFIXES
from model.io.masks import read_masks
from model.io.model_files import articulated_stage, find_assets, is_model
from model.prediction import TOKEN_VARIABLE as BACKEND_TOKEN
from model.prediction import is_backend
from model.prediction.registry import check_predictor
from model.scenes.articulable_finders import FinderOptions, load_finder
from model.scenes.registry import recognised
from model.segmentation.registry import check_segmenter

if TYPE_CHECKING:
    from app.server.server import Server


def serve_backend(options: BackendCommand, _: Progress) -> Result:
    """Check the options, load the predictor, then answer until interrupted.

    Raises:
        ConfigurationError: where an option can't work or the extra isn't installed.
    """
    token = _token(options)
    name = options.predictor
    if is_backend(name):
        raise ConfigurationError(f"--predictor {name}: a backend can't ask another one")
    check_predictor(name)
    try:
        from app.server.backend_server import (  # imports an extra
            Backend,
            BackendSettings,
            limited_server,
        )
    except ImportError as error:
        raise ConfigurationError(
            f"a backend needs {error.name}: {install_command('artiworld[backend]')}"
        ) from error
    check_address(options.host, options.port)
    settings = BackendSettings(name, token, options.max_request_mb * 1_000_000, options.waiting)
    threads = max(1, (os.cpu_count() or 2) // options.workers)
    workers = [
        WorkerProcess(
            f"backend {i}", initializer=backend_server.load, arguments=(name,), threads=threads
        )
        for i in range(options.workers)
    ]
    try:
        # Weights that don't load must fail here, not at the first client's request.
        for job in [worker.submit(backend_server.ready) for worker in workers]:
            job.result()
        found = socket.getaddrinfo(options.host, options.port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server(found[4][:2], family=found[0], backlog=128)
        address = url(options.host, listener.getsockname()[1])
        print(f"ArtiWorld backend is ready: {address} (predictor {name})", flush=True)
        limited_server(Backend(settings, workers).application()).run(sockets=[listener])
    finally:
        for worker in workers:
            worker.close()
    return Result(None, lambda: None)


def _token(options: BackendCommand) -> str | None:
    token = options.token or os.environ.get(BACKEND_TOKEN) or None
    if token is None and not is_loopback(options.host):
        raise ConfigurationError(
            f"--host {options.host} lets other machines in: give --token or set {BACKEND_TOKEN}"
        )
    if token is not None and not (token.isascii() and token.isprintable()):
        raise ConfigurationError("--token must have ASCII letters, digits and signs only")
    Login(token)  # refuses one that is too short
    return token


def serve(options: ServeCommand, end: EndSignals) -> int:
    """Check the options while nothing is running yet, then serve until interrupted."""
    config = make_config(options)
    from app.server.server import run_until_interrupted  # imports viser

    run_until_interrupted(start_server(config), end, open_browser=options.open)
    return 0


def start_server(config: ServeConfig) -> Server:
    """Start a server that shows the application in each browser tab; ``close()`` ends it."""
    from app.server.server import Server  # imports viser
    from app.viewer.client_app import ClientApp

    return Server(config, ClientApp)


def make_config(options: ServeCommand) -> ServeConfig:
    """Check the options and turn them into the server's settings.

    Raises:
        ConfigurationError, InputFileError: where an option can't work.
    """
    for path in options.paths:
        if not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
    if options.max_upload_mb <= 0:
        raise ConfigurationError(f"--max-upload-mb {options.max_upload_mb} must be above 0")
    for origin in options.allow_origin:
        if not origin.startswith(("http://", "https://")):
            raise ConfigurationError(
                f"--allow-origin {origin} is no address; give one like https://scans.example.org"
            )
    for proxy in options.trusted_proxy:
        try:
            ipaddress.ip_network(proxy)
        except ValueError as error:
            raise ConfigurationError(
                f"--trusted-proxy {proxy} is no address; give one like 10.0.0.2 or 172.16.0.0/12"
            ) from error
    token = options.token or os.environ.get(TOKEN_VARIABLE) or None
    if token is None and not is_loopback(options.host):
        token = new_token()
    Login(token)  # refuses one that is too short
    check_segmenter(options.segmentation.segmenter)
    if options.finder != "lexicon":
        load_finder(options.finder, FinderOptions(options.finder_url))
    check_predictor(options.prediction.predictor)
    predictor = chosen_predictor(options.prediction)
    if is_backend(predictor):
        check_backend(predictor)
    if options.port is not None:
        check_address(options.host, options.port)
    port = free_port(options.host) if options.port is None else options.port
    scene = scene_to_open(options)
    if options.masks is not None:
        if scene is not None or len(options.paths) != 1 or len(find_assets(options.paths)) != 1:
            raise ConfigurationError("--masks are of one object: give its file or folder as PATH")
        read_masks(options.masks)  # tells now what is wrong with them
    same = tuple("workspace database storage host max_upload_mb finder finder_url".split())
    settings: dict[str, Any] = {name: getattr(options, name) for name in same}
    if options.user is not None:
        settings["user"] = options.user
    return ServeConfig(
        paths=() if scene else options.paths,
        port=port,
        token=token,
        up_axis=options.reading.up_axis,
        unit_scale=options.reading.unit_scale,
        masks=options.masks,
        segmenter=options.segmentation.segmenter,
        predictor=predictor,
        allowed_origins=options.allow_origin,
        trusted_proxies=options.trusted_proxy,
        scene=scene,
        oidc=oidc_settings(options.oidc),
        assets=options.assets or (() if scene is None else (scene.parent,)),
        **settings,
    )


def oidc_settings(options: OidcOptions) -> OidcSettings | None:
    """Settings of the provider, where there is one."""
    if options.oidc_issuer is None:
        return None
    return OidcSettings(
        options.oidc_issuer,
        options.oidc_client,
        options.oidc_secret or os.environ.get(SECRET_VARIABLE) or None,
        options.oidc_name_claim,
        options.oidc_role_claim,
        options.oidc_anybody,
        options.oidc_label,
    )


def scene_to_open(options: ServeCommand) -> Path | None:
    """The scene among ``options.paths``; None for single objects.

    Raises:
        ConfigurationError, InputFileError: where ``--assets`` can't belong to the paths.
    """
    first = options.paths[0] if options.paths else None
    if not (options.assets or options.scene) and (
        first is None
        or first.is_dir()
        or is_model(first)
        or (first.suffix.lower() in SUFFIXES and first.suffix.lower() not in STAGES)
        or not recognised(first)
        or articulated_stage(first) is not None
    ):
        return None
    if first is None or len(options.paths) > 1 or first.is_dir():
        raise ConfigurationError("a scene is opened alone: give one scene file, and its --assets")
    for folder in options.assets:
        if not folder.is_dir():
            raise InputFileError(folder, "no such folder", "give --assets a folder of assets")
    return first
