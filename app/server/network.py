"""Addresses to listen at, and limits on who connects."""

from __future__ import annotations

import errno
import ipaddress
import logging
import os
import socket
import time

from model.core.errors import ConfigurationError

PORTS = range(8080, 8100)
"""Tried in order where no port is given."""


def is_loopback(host: str) -> bool:
    """True if only this machine can reach ``host``."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def url(host: str, port: int) -> str:
    """Return the URL of a server at ``host`` and ``port``."""
    name = host.strip("[]")
    if name == "127.0.0.1":
        name = "localhost"
    elif name in ("0.0.0.0", "::", ""):
        name = socket.gethostname()
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def check_address(host: str, port: int) -> None:
    """Check that a server can listen at ``host`` and ``port``; viser itself would wait for ever.

    Raises:
        ConfigurationError: where it can't.
    """
    if not 0 <= port <= 65535:
        raise ConfigurationError(f"--port {port} is out of range; choose one from 1024 to 65535")
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        for family, kind, protocol, _, address in addresses:
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                probe.listen(1)
    except socket.gaierror as error:
        raise ConfigurationError(f"--host {host} can't be resolved ({error.strerror})") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            text = f"port {port} is in use; choose another with --port"
        elif error.errno == errno.EACCES:
            text = f"port {port} needs special rights; choose one above 1023 with --port"
        else:
            text = f"can't listen at {host}:{port} ({os.strerror(error.errno or 0)})"
        raise ConfigurationError(text) from error


def free_port(host: str) -> int:
    """Return the first of :data:`PORTS` that is free at ``host``.

    Raises:
        ConfigurationError: where none is, or the host can't be used at all.
    """
    for port in PORTS:
        try:
            check_address(host, port)
        except ConfigurationError as error:
            if "in use" not in str(error):
                raise
        else:
            return port
    raise ConfigurationError(
        f"ports {PORTS[0]} to {PORTS[-1]} are all in use; choose another with --port"
    )


MAX_SOCKETS = 256
"""Most connections at a time, those without a complete request included; a process may have 1024
open files by default."""


class OncePerMinute(logging.Filter):
    """Lets each kind of message through once a minute: visitors must not fill the log."""

    def __init__(self, seconds: float = 60.0) -> None:
        super().__init__()
        self._seconds = seconds
        self._last: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to log a record."""
        now, kind = time.monotonic(), str(record.msg)[:80]
        if now - self._last.get(kind, -self._seconds) < self._seconds:
            return False
        if len(self._last) > 1000:
            self._last.clear()
        self._last[kind] = now
        return True
