"""``artiworld backend``: from its options to a running backend."""

from __future__ import annotations

import os
import socket

from app.cli.commands import BackendCommand
from app.server import backend_tasks
from app.server.jobs import WorkerProcess
from app.server.login import Login
from app.server.network import check_address, is_loopback, url
from model.core.errors import ConfigurationError
from model.core.packages import install_command
from model.prediction import TOKEN_VARIABLE, is_backend
from model.prediction.registry import check_predictor


def serve_backend(options: BackendCommand) -> int:
    """Check the options, load the predictor, then answer until interrupted.

    Raises:
        ConfigurationError: where an option can't work or the extra isn't installed.
    """
    token = _token(options)
    _check(options)
    name = options.predictor
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
            f"backend {i}", initializer=backend_tasks.load, arguments=(name,), threads=threads
        )
        for i in range(options.workers)
    ]
    try:
        # Weights that don't load must fail here, not at the first client's request.
        for job in [worker.submit(backend_tasks.ready) for worker in workers]:
            job.result()
        family, _, _, _, address = socket.getaddrinfo(
            options.host, options.port, type=socket.SOCK_STREAM
        )[0]
        listener = socket.create_server(address[:2], family=family, backlog=128)
        address = url(options.host, listener.getsockname()[1])
        print(f"ArtiWorld backend is ready: {address} (predictor {name})", flush=True)
        limited_server(Backend(settings, workers).application()).run(sockets=[listener])
    finally:
        for worker in workers:
            worker.close()
    return 0


def _token(options: BackendCommand) -> str | None:
    token = options.token or os.environ.get(TOKEN_VARIABLE) or None
    if token is None and not is_loopback(options.host):
        raise ConfigurationError(
            f"--host {options.host} lets other machines in: give --token or set {TOKEN_VARIABLE}"
        )
    if token is not None and not (token.isascii() and token.isprintable()):
        raise ConfigurationError("--token must have ASCII letters, digits and signs only")
    Login(token)  # refuses one that is too short
    return token


def _check(options: BackendCommand) -> None:
    for option, value in (
        ("--workers", options.workers),
        ("--waiting", options.waiting),
        ("--max-request-mb", options.max_request_mb),
    ):
        if value < 1:
            raise ConfigurationError(f"{option} {value} must be 1 or more")
    if is_backend(options.predictor):
        raise ConfigurationError(
            f"--predictor {options.predictor}: a backend can't ask another one"
        )
    check_predictor(options.predictor)
