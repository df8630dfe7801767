"""The HTTP side of ``artiworld backend``: one machine predicts for many annotators.

``GET /health`` needs no token and says whether one is needed. ``POST /v1/predict`` takes the
format of :mod:`model.prediction.remote_backend`. Refusals have a status (400 malformed, 401 wrong
token, 408 timeout, 413 too large, 415 wrong type, 429 too many wrong tokens, 503 busy) and a JSON
body ``{"error": text}``; later errors are lines of the stream. Connections have limits that
uvicorn itself lacks.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import numpy.typing as npt
import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Receive, Scope, Send

from app.server.jobs import Job, JobFailed, WorkerProcess
from app.server.login import Login
from app.server.network import MAX_SOCKETS, OncePerMinute, OnceProtocol, limited, refusal
from model.core.errors import ArtiworldError
from model.core.progress import Progress, no_progress
from model.prediction.registry import Predictor, load_predictor
from model.prediction.remote_backend import (
    CONTENT_TYPE,
    HEALTH_PATH,
    PREDICT_PATH,
    RequestError,
    decode_request,
    encode_answer,
    read_header,
)

_loaded: list[Predictor] = []


def load(name: str) -> None:
    """Load the predictor: the initializer of a worker."""
    _loaded[:] = [load_predictor(name)]


def ready() -> str:
    """Return the name of the loaded predictor."""
    return _loaded[0].name


def predict(body: npt.NDArray[np.uint8], progress: Progress = no_progress) -> dict[str, Any]:
    """Predict for the bytes of a request.

    Raises:
        ArtiworldError: where they are malformed.
    """
    progress(0.0, "Reading the parts")
    segmented, locked, seed = decode_request(body.tobytes())
    answer = _loaded[0].predict(segmented, locked=locked, seed=seed, progress=progress)
    return encode_answer(answer)


class LimitedProtocol(OnceProtocol):
    """Drops connections beyond a number."""

    max_sockets = MAX_SOCKETS

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        if len(self.connections) > self.max_sockets:
            self.logger.warning("more than %d connections: new ones are dropped", self.max_sockets)
            transport.abort()


def limited_server(application: ASGIApp) -> uvicorn.Server:
    """Return a server of the application, with the limits and a log that nobody can fill."""
    for name in ("asyncio", "uvicorn.error"):
        logging.getLogger(name).addFilter(OncePerMinute())
    config = uvicorn.Config(
        application,
        log_level="warning",
        access_log=False,
        server_header=False,
        headers=[("Connection", "close")],
        timeout_graceful_shutdown=3,
        http=LimitedProtocol,
        ws="none",
    )
    return uvicorn.Server(config)


HEARTBEAT_SECONDS = 1.0
"""Period of lines to a waiting client; also how soon a client that left is noticed."""
BODY_SECONDS = 10.0
"""Longest time of a request but for large ones."""


@dataclass(frozen=True)
class BackendSettings:
    """Settings of a backend.

    Attributes:
        predictor: name of the predictor.
        token: token of the clients; None admits everybody.
        max_bytes: largest request.
        waiting: most requests under way, those being answered included.
    """

    predictor: str
    token: str | None = None
    max_bytes: int = 200_000_000
    waiting: int = 16


class _Stream(StreamingResponse):
    """A stream that calls ``over`` at its end, also where the client left before the first line."""

    def __init__(self, lines: AsyncIterator[bytes], over: Callable[[], None]) -> None:
        super().__init__(lines, media_type="application/x-ndjson")
        self._over = over

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._over()


class Backend:
    """The requests under way and the workers that answer them.

    Args:
        settings: settings of the server.
        workers: processes for one request at a time each; the caller closes them.
    """

    def __init__(self, settings: BackendSettings, workers: list[WorkerProcess]) -> None:
        self.settings = settings
        self._workers = workers
        self._login = Login(settings.token)
        self._jobs: dict[int, list[Job[Any]]] = {i: [] for i in range(len(workers))}
        self._under_way = 0

    def application(self) -> FastAPI:
        """The ASGI application."""
        app = FastAPI(title="ArtiWorld backend", docs_url=None, redoc_url=None, openapi_url=None)
        app.add_api_route(HEALTH_PATH, self.health, methods=["GET"], response_model=None)
        app.add_api_route(PREDICT_PATH, self.predict, methods=["POST"], response_model=None)
        app.add_exception_handler(HTTPException, refusal)
        return app

    async def health(self, request: Request) -> Response:
        """Describe the service; with the right token also its load."""
        answer: dict[str, Any] = {
            "service": "artiworld backend",
            "status": "ok",
            "token_needed": self._login.needed,
        }
        if self._login.needed and "authorization" not in request.headers:
            return JSONResponse(answer)
        self._authorize(request)
        answer |= {
            "predictor": self.settings.predictor,
            "version": version("artiworld"),
            "max_bytes": self.settings.max_bytes,
            "workers": len(self._workers),
            "under_way": self._under_way,
        }
        return JSONResponse(answer)

    async def predict(self, request: Request) -> Response:
        """Predict one object."""
        self._authorize(request)
        if self._under_way >= self.settings.waiting:
            raise HTTPException(503, f"{self._under_way} requests are under way; try again soon")
        self._under_way += 1
        try:
            body = await self._body(request)
            read_header(body)
        except BaseException as error:
            self._under_way -= 1
            if isinstance(error, RequestError):
                raise HTTPException(400, str(error)) from error
            raise
        return _Stream(self._answer(request, body), self._left)

    def _left(self) -> None:
        self._under_way -= 1

    def _authorize(self, request: Request) -> None:
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        address = request.client.host if request.client is not None else ""
        known = self._login.try_token(token if kind.lower() == "bearer" else "", address)
        if known is None:
            raise HTTPException(429, "too many wrong tokens; wait a minute")
        if not known:
            raise HTTPException(401, "the token is missing or wrong")

    async def _body(self, request: Request) -> bytes:
        if request.headers.get("content-type") != CONTENT_TYPE:
            raise HTTPException(415, f"send the parts as {CONTENT_TYPE}")
        most = self.settings.max_bytes
        receive = await limited(request.receive, request.headers, most, BODY_SECONDS)
        return await Request(request.scope, receive).body()

    async def _answer(self, request: Request, body: bytes) -> AsyncIterator[bytes]:
        """Yield lines of JSON until the job ends; a client that leaves cancels it."""
        index = min(self._jobs, key=lambda i: len(self._jobs[i]))
        before = self._jobs[index]
        changed = asyncio.Event()
        loop = asyncio.get_running_loop()

        def wake(*_: object) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(changed.set)

        job: Job[Any] = self._workers[index].submit(
            predict, np.frombuffer(body, np.uint8), on_progress=wake
        )
        before.append(job)
        job.add_done_callback(wake)
        try:
            yield _line(progress=[0.0, _queue_text(before, job)])
            while not job.done:
                with suppress(TimeoutError):
                    async with asyncio.timeout(HEARTBEAT_SECONDS):
                        await changed.wait()
                if await request.is_disconnected():
                    return
                changed.clear()
                if not job.done:
                    yield _line(progress=[job.fraction, job.message or _queue_text(before, job)])
            yield _last_line(job)
        finally:
            job.cancel()
            before.remove(job)


def _queue_text(jobs: list[Job[Any]], job: Job[Any]) -> str:
    ahead = jobs.index(job)
    return f"Waiting for {ahead} other{'s'[: ahead != 1]}" if ahead else "Predicting"


def _last_line(job: Job[Any]) -> bytes:
    if job.state == "done":
        return _line(done=job.result(0))
    if job.state == "cancelled":
        return _line(error="the backend was stopped", kind="cancelled")
    kind = "user" if isinstance(job.error, ArtiworldError) else "failed"
    if isinstance(job.error, JobFailed) and job.error.details:
        # The traceback is for the operator, not for the clients.
        print(job.error.details, flush=True)
    return _line(error=str(job.error), kind=kind)


def _line(**values: Any) -> bytes:
    return json.dumps(values, ensure_ascii=False, allow_nan=False).encode() + b"\n"
