"""Work on many objects on a Ray cluster, where neither an object nor a worker may end the run."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from model.core.errors import ConfigurationError
from model.core.packages import require

T = TypeVar("T")

TRIES = 3
"""Deaths of its worker after which an object is given up."""

CONNECT_SECONDS = 5.0


def ray_map(
    function: Callable[[str], T], ids: Sequence[str], address: str
) -> Iterator[tuple[str, T | None]]:
    """``function`` of each id as they are done; None for one that kills its workers.

    Args:
        function: can be pickled; must not raise. ArtiWorld is installed on every machine.
        ids: each one once.
        address: of a cluster, as ``ray://host:10001``, ``host:6379`` or ``auto``; ``local`` starts
            one on this machine, which ends with the run.

    Raises:
        ConfigurationError: where Ray isn't installed or the cluster isn't there.
    """
    if not ids:
        return
    ray, errors = _connect(address)
    try:
        task = ray.remote(max_retries=0)(function.__class__.__call__)
        held = ray.put(function)
        running = {task.remote(held, i): (i, 1) for i in ids}
        while running:
            done, _ = ray.wait(list(running), num_returns=1)
            for reference in done:
                id, tries = running.pop(reference)
                try:
                    yield id, ray.get(reference)
                # A worker died, or its machine: Ray moves the object elsewhere.
                except errors as error:
                    if tries < TRIES and not isinstance(error, ray.exceptions.RayTaskError):
                        running[task.remote(held, id)] = (id, tries + 1)
                    else:
                        yield id, None
    finally:
        ray.shutdown()


def _connect(address: str) -> tuple[Any, type[Exception]]:
    ray = require("ray", "artiworld[cluster]", "--ray")
    require("ray.exceptions", "artiworld[cluster]", "--ray")
    _check_there(address)
    try:
        ray.init(
            address=address, log_to_driver=False, configure_logging=False,
            **({"include_dashboard": False} if address == "local" else {}),  # type: ignore[arg-type]
        )  # fmt: skip
    except (ConnectionError, ValueError, RuntimeError, OSError, TimeoutError) as error:
        first = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise ConfigurationError(f"no Ray cluster at {address!r}: {first}") from error
    return ray, ray.exceptions.RayError


def _check_there(address: str) -> None:
    """Ray itself retries for minutes without an answer."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_SECONDS).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigurationError(
            f"no Ray cluster at {address!r} ({error}); start one with: ray start --head"
        ) from error
