"""Limits of ``artiworld backend``'s connections, which uvicorn itself lacks."""

from __future__ import annotations

import asyncio
import logging

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from app.server.network import MAX_SOCKETS, OncePerMinute

HEADER_SECONDS = 10.0
"""Longest time from the connection, or the last answer's end, to the end of a request's header."""


class LimitedProtocol(H11Protocol):
    """HTTP/1.1 that drops connections beyond a number, and those whose header doesn't come."""

    max_sockets = MAX_SOCKETS
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        if len(self.connections) > self.max_sockets:
            self.logger.warning("more than %d connections: new ones are dropped", self.max_sockets)
            transport.abort()
        self._await_header()

    def data_received(self, data: bytes) -> None:
        """Take bytes; a header must be complete in time."""
        super().data_received(data)
        self._await_header()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._stop_timer()
        super().connection_lost(exc)

    def _await_header(self) -> None:
        if self.conn.their_state is not h11.IDLE:
            self._stop_timer()
        elif self._timer is None:
            self._timer = self.loop.call_later(HEADER_SECONDS, self.transport.abort)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def limited_server(application: ASGIApp) -> uvicorn.Server:
    """Return a server of the application, with the limits and a log that nobody can fill."""
    for name in ("asyncio", "uvicorn.error"):
        logging.getLogger(name).addFilter(OncePerMinute())
    config = uvicorn.Config(
        application, log_level="warning", access_log=False, server_header=False,
        timeout_graceful_shutdown=3, http=LimitedProtocol, ws="none",
    )  # fmt: skip
    return uvicorn.Server(config)
