"""``artiworld backend``: from options to a running backend."""

from __future__ import annotations

import argparse
import os
import socket
import sys

from app.server.login import Login
from app.server.network import check_address, is_loopback, url
from model.core.errors import ConfigurationError
from model.core.installing import install_command
from model.prediction.remote import TOKEN_VARIABLE, is_backend

DEFAULT_PORT = 8090


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of ``artiworld backend``."""
    add = parser.add_argument
    add("--predictor", default=None, metavar="NAME", help="who predicts (default: as predict's)")
    add(
        "--host", default="127.0.0.1", help="where to listen; others than this machine need a token"
    )
    add("--port", type=int, default=DEFAULT_PORT,
        help=f"port to listen at; 0 for any (default: {DEFAULT_PORT})")  # fmt: skip
    add("--token", help=f"what clients must know; or set {TOKEN_VARIABLE}")
    add("--workers", type=int, default=1, metavar="N",
        help="objects answered at the same time (default: 1)")  # fmt: skip
    add("--waiting", type=int, default=16, metavar="N",
        help="requests under way before more are refused (default: 16)")  # fmt: skip
    add("--max-request-mb", type=int, default=200, metavar="MB",
        help="largest object that a client may send (default: 200)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Check the options, load the predictor, then answer until interrupted.

    Raises:
        ConfigurationError: where an option can't work or the extra isn't installed.
    """
    token = _token(args)
    name = _checked(args)
    try:
        import uvicorn

        from app.server.backend_server import Backend, BackendSettings
    except ImportError as error:
        raise ConfigurationError(
            f"a backend needs {error.name}: {install_command('artiworld[backend]')}"
        ) from error
    from app.server import backend_tasks
    from app.server.jobs import WorkerProcess

    check_address(args.host, args.port)
    settings = BackendSettings(name, token, args.max_request_mb * 1_000_000, args.waiting)
    threads = max(1, (os.cpu_count() or 2) // args.workers)
    workers = [
        WorkerProcess(
            f"backend {i}", initializer=backend_tasks.load, arguments=(name,), threads=threads
        )
        for i in range(args.workers)
    ]
    try:
        # Weights that don't load are told now, not to the first client.
        for job in [worker.submit(backend_tasks.ready) for worker in workers]:
            job.result()
        listener = _listen(args.host, args.port)
        address = url(args.host, listener.getsockname()[1])
        print(f"ArtiWorld backend is ready: {address} (predictor {name})", flush=True)
        config = uvicorn.Config(
            Backend(settings, workers).application(),
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=3,
        )
        uvicorn.Server(config).run(sockets=[listener])
    finally:
        for worker in workers:
            worker.close()
    return 0


def _token(args: argparse.Namespace) -> str | None:
    token = args.token or os.environ.get(TOKEN_VARIABLE) or None
    if token is None and not is_loopback(args.host):
        raise ConfigurationError(
            f"--host {args.host} lets other machines in: give --token or set {TOKEN_VARIABLE}"
        )
    if token is not None and not (token.isascii() and token.isprintable()):
        raise ConfigurationError("--token must have ASCII letters, digits and signs only")
    Login(token)  # refuses one that is too short
    return token


def _checked(args: argparse.Namespace) -> str:
    from model.prediction.registry import DEFAULT, check_predictor

    for option, value in (
        ("--workers", args.workers),
        ("--waiting", args.waiting),
        ("--max-request-mb", args.max_request_mb),
    ):
        if value < 1:
            raise ConfigurationError(f"{option} {value} must be 1 or more")
    name = DEFAULT if args.predictor is None else args.predictor
    if is_backend(name):
        raise ConfigurationError(f"--predictor {name}: a backend can't ask another one")
    check_predictor(name)
    return name


def _listen(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(address)
    listener.listen(128)
    return listener


# --- the other commands' side


def add_client_options(parser: argparse.ArgumentParser, token_option: str) -> None:
    """``--backend`` and its token for commands that predict; call it after ``--predictor``.

    Args:
        token_option: its name there; ``serve`` has a token of its own.
    """
    parser.add_argument(
        "--backend", metavar="URL", help="ask an artiworld backend instead of predicting here"
    )
    parser.set_defaults(usual_predictor=parser.get_default("predictor"))
    parser.add_argument(
        token_option, dest="backend_token", metavar="TOKEN",
        help=f"the backend's token; or set {TOKEN_VARIABLE}",
    )  # fmt: skip


def chosen_predictor(args: argparse.Namespace) -> str:
    """The predictor's name: the backend's address where there is one.

    The token goes into the environment, from which the worker processes take it.

    Raises:
        ConfigurationError: where a backend and another predictor are asked for, or the address
            can't be one.
    """
    given: str = args.predictor
    url: str | None = args.backend
    if url is None and is_backend(given):
        url = given
    if url is None:
        if args.backend_token:
            raise ConfigurationError("a backend's token is given, but no --backend")
        return given
    if given not in (args.usual_predictor, url):
        raise ConfigurationError(
            f"--backend and --predictor {given} exclude each other: the backend has its own"
        )
    from model.prediction.remote.http_predictor import HttpPredictor

    if args.backend_token:
        os.environ[TOKEN_VARIABLE] = args.backend_token
    return HttpPredictor(url).url


def greet(url: str) -> None:
    """Say on stderr where a backend isn't there yet; predictions fail until it is.

    Raises:
        BackendRefused: where it is there and doesn't take the token.
    """
    from model.prediction.remote.http_predictor import BackendError, BackendRefused, HttpPredictor

    try:
        HttpPredictor(url, connect_seconds=3.0, silence_seconds=3.0).check()
    except BackendRefused:
        raise
    except BackendError as error:
        print(f"artiworld: {error}; the app asks again at every prediction", file=sys.stderr)
