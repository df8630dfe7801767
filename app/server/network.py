"""Addresses to listen at, limits on who connects, and one port for viser's pages and the REST API.

The library behind viser's port reads requests without a body only, so a connection whose first
request is for the API is handed over to uvicorn's protocol, in the way in which uvicorn itself
hands over a connection that becomes a websocket.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Hashable
from typing import Any, ClassVar, cast
from weakref import WeakKeyDictionary

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.types import Message, Receive
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState
from websockets.asyncio.server import ServerConnection

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
open files by default. One address may have half of them."""


class Places:
    """The connections of one port. Where all places are taken, or those of an address, the next
    one takes that of its oldest stranger; people who are logged in stay.

    Args:
        proxies: addresses or networks that may have all places, as many people come through them.
    """

    def __init__(self, proxies: tuple[str, ...] = ()) -> None:
        self._proxies = [ipaddress.ip_network(proxy, strict=False) for proxy in proxies]
        self._known: dict[asyncio.Transport, Callable[[], bool]] = {}

    def take(self, transport: asyncio.Transport, known: Callable[[], bool]) -> bool:
        """Return whether a connection has a place; ``known`` tells whether it is a person's, and
        may be given anew.
        """
        if transport not in self._known:
            places = {t: k for t, k in self._known.items() if not t.is_closing()}
            self._known, peer = places, _peer(transport)
            same = [t for t in places if _peer(t) == peer]
            if len(same) < MAX_SOCKETS // 2 or (
                any(ipaddress.ip_address(peer) in proxy for proxy in self._proxies)
            ):
                same = list(places) if len(places) >= MAX_SOCKETS else []
            stranger = next((t for t in same if not places[t]()), None)
            if same and stranger is None:
                return False
            if stranger is not None:
                stranger.abort()
        self._known[transport] = known
        return True


def _peer(transport: asyncio.Transport) -> str:
    return str((transport.get_extra_info("peername") or ("0.0.0.0",))[0]).partition("%")[0]


NO_ROOM = "too much is being sent or fetched just now; try again in a minute"


class Room:
    """Bytes of bodies that may be under way at a time, half of them of one person."""

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, threading.Lock()
        self._held: WeakKeyDictionary[object, tuple[Hashable, int]] = WeakKeyDictionary()

    def take(self, body: object, size: int, who: Hashable) -> bool:
        """Return whether there is room for ``body``, which holds it as long as it lives."""
        with self._lock:
            held = [(who, size), *self._held.values()]
            mine = sum(size for name, size in held if name == who)
            free = mine <= self._most // 2 and sum(size for _, size in held) <= self._most
            if free:
                self._held[body] = who, size
            return free


class OncePerMinute(logging.Filter):
    """Lets each kind of message through once a minute: visitors must not fill the log."""

    def __init__(self, seconds: float = 60.0) -> None:
        super().__init__()
        self._seconds = seconds
        self._last: dict[str, float] = {}  # no TTLCache: any thread may log

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to log a record."""
        now, kind = time.monotonic(), str(record.msg)[:80]
        if now - self._last.get(kind, -self._seconds) < self._seconds:
            return False
        if len(self._last) > 1000:
            self._last.clear()
        self._last[kind] = now
        return True


async def refusal(_: Request, error: Any) -> JSONResponse:
    """Return the answer of an ``HTTPException``: its status, and its text as ``error``."""
    text = str(error.detail).lower() if error.status_code in (404, 405) else error.detail
    return JSONResponse({"error": text}, error.status_code)


LEAST_RATE = 4096.0
"""Bytes a second that lengthen the time of a request."""
DISCARD_SECONDS = 1.0
"""How long the body of a refused request is read, and thrown away."""


async def discard(receive: Receive, headers: Headers) -> None:
    """Take what is on its way: a client that is cut off while it sends never sees the answer."""
    if "Expect" in headers:  # it waits for the answer before it sends
        return
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(DISCARD_SECONDS):
            while (await receive()).get("more_body"):
                pass


async def limited(
    receive: Receive, headers: Headers, most: int, seconds: float, rate: float = LEAST_RATE
) -> Receive:
    """Return ``receive`` of a request whose body has limits; beyond them it raises.

    Args:
        most: bytes.
        seconds: longest time of all; each second, ``rate`` bytes lengthen it by one.

    Raises:
        HTTPException: 413, where the body is declared to be larger.
    """
    too_large = HTTPException(413, f"the request is larger than {most / 1e6:g} MB")
    declared = headers.get("Content-Length", "0")
    if not declared.isdigit() or int(declared) > most:
        await discard(receive, headers)
        raise too_large
    taken, more, begun = 0, True, time.monotonic()

    async def in_time() -> Message:
        nonlocal taken, more
        if not more:  # only the end of the connection may come
            return await receive()
        try:
            async with asyncio.timeout(begun + seconds + taken / rate - time.monotonic()):
                message = await receive()
        except TimeoutError as error:
            raise HTTPException(408, "the request timed out") from error
        taken += len(message.get("body", b""))
        more = message.get("more_body", False)
        if taken > most:
            await discard(receive, headers)
            raise too_large
        return message

    return in_time


API = "/api/v1"
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
FIRST_SECONDS = 10.0
"""Longest time for the first line of a connection, and for the headers of an API request."""
_LINE = 4096
"""Bytes; a longer first line isn't for the API, and the other side refuses it."""


class OnceProtocol(H11Protocol):
    """HTTP/1.1 for one request, whose headers must come in time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection."""
        super().connection_made(transport)
        self.loop.call_later(FIRST_SECONDS, self._end_unless_begun)

    def _end_unless_begun(self) -> None:
        if self.cycle is None:
            self.transport.abort()


class ApiConnections:
    """Speaks HTTP on connections to the API.

    Args:
        application: an ASGI application.
        proxies: addresses or networks whose X-Forwarded-For is trusted.
    """

    def __init__(self, application: Any, proxies: tuple[str, ...] = ()) -> None:
        self._config = Config(
            application,
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=bool(proxies),
            forwarded_allow_ips=list(proxies),
            h11_max_incomplete_event_size=65536,
        )
        self._config.load()
        self._state = ServerState()

    def take(self, transport: asyncio.Transport, first: bytes, places: Places) -> None:
        """Serve a connection from its first bytes on."""
        loop = asyncio.get_running_loop()
        protocol = OnceProtocol(self._config, self._state, {}, loop)
        transport.set_protocol(protocol)
        protocol.connection_made(transport)
        protocol.data_received(first)
        places.take(transport, lambda: bool((protocol.scope or {}).get("state", {}).get("person")))


class SharedConnection(ServerConnection):
    """Waits for the first line, which decides who serves the connection.

    Attributes:
        api: takes the connections to the API; None: there is none. Set in a subclass.
        places: of the port. Set in a subclass.
        known: whether a person who is logged in has it.
    """

    api: ClassVar[ApiConnections | None] = None
    places: ClassVar[Places]
    known = False
    _waiting: asyncio.Transport | None = None
    _first = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See the base class."""
        self._waiting = cast("asyncio.Transport", transport)
        if not self.places.take(self._waiting, lambda: self.known):
            self._waiting.abort()
        self.loop.call_later(FIRST_SECONDS, self._end_unless_begun)

    def data_received(self, data: bytes) -> None:
        """See the base class."""
        if self._waiting is None:
            super().data_received(data)
            return
        self._first += data
        line, found, _ = self._first[:_LINE].partition(b"\n")
        if not found and len(self._first) < _LINE and self.api is not None:
            return
        transport, self._waiting = self._waiting, None
        if self.api is not None and _is_for_api(line):
            self.api.take(transport, self._first, self.places)
        else:
            super().connection_made(transport)
            super().data_received(self._first)
        self._first = b""

    def eof_received(self) -> None:
        """See the base class."""
        if self._waiting is None:
            super().eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """See the base class."""
        if self._waiting is None:
            super().connection_lost(exc)

    def _end_unless_begun(self) -> None:
        if self._waiting is not None:
            self._waiting.abort()


def _is_for_api(line: bytes) -> bool:
    path = b"".join(line.split(b" ")[1:2]).partition(b"?")[0].decode("latin-1")
    return f"{path}/".startswith(f"{API}/")
