"""The HTTP side of ``artiworld backend``: one machine predicts for many annotators.

``GET /health`` needs no token and says whether one is needed. ``POST /v1/predict`` takes what
:mod:`model.prediction.remote.wire` describes. Refusals have a status of their own (400 no request,
401 wrong
token, 413 too large, 415 another type, 429 too many wrong tokens, 503 too many wait) and a JSON
body ``{"error": text}``; what goes wrong later is told in the stream.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from app.server import backend_tasks
from app.server.jobs import Job, JobFailed, WorkerProcess
from app.server.login import Login
from model.core.errors import ArtiworldError
from model.prediction.remote.wire import (
    CONTENT_TYPE,
    HEALTH_PATH,
    PREDICT_PATH,
    RequestError,
    read_header,
)

HEARTBEAT_SECONDS = 1.0
"""A waiting client hears something this often, and one that left is noticed."""
BODY_SECONDS = 60.0
"""How long a client may send nothing in the middle of its request."""


@dataclass(frozen=True)
class BackendSettings:
    """Settings of a backend.

    Attributes:
        predictor: its name, for people.
        token: what clients must know; None lets everybody in.
        max_bytes: largest request.
        waiting: requests that may be under way, those being answered included.
    """

    predictor: str
    token: str | None = None
    max_bytes: int = 200_000_000
    waiting: int = 16


class _Refused(Exception):
    """A request that gets no stream."""

    def __init__(self, status: int, message: str) -> None:
        self.status = status
        super().__init__(message)


class _Stream(StreamingResponse):
    """A stream that says when it is over, also where its client left before the first line."""

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
        settings: of the server.
        workers: each answers one request at a time; the caller closes them.
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
        for status, text in ((404, "there is nothing here"), (405, "this method isn't taken")):
            app.add_exception_handler(status, _plain(status, text))
        return app

    async def health(self, request: Request) -> Response:
        """Who this is; with the right token also how it is doing."""
        said: dict[str, Any] = {
            "service": "artiworld backend",
            "status": "ok",
            "token_needed": self._login.needed,
        }
        if self._login.needed and "authorization" not in request.headers:
            return JSONResponse(said)
        try:
            self._let_in(request)
        except _Refused as refused:
            return _refusal(refused)
        said |= {
            "predictor": self.settings.predictor,
            "version": version("artiworld"),
            "max_bytes": self.settings.max_bytes,
            "workers": len(self._workers),
            "under_way": self._under_way,
        }
        return JSONResponse(said)

    async def predict(self, request: Request) -> Response:
        """Answer one object; see the module's words."""
        try:
            self._let_in(request)
            if self._under_way >= self.settings.waiting:
                raise _Refused(503, f"{self._under_way} requests are under way; try again soon")
            self._under_way += 1
            try:
                body = await self._body(request)
                read_header(body)
            except BaseException:
                self._under_way -= 1
                raise
        except RequestError as error:
            return _refusal(_Refused(400, str(error)))
        except _Refused as refused:
            return _refusal(refused)
        return _Stream(self._answer(request, body), self._left)

    def _left(self) -> None:
        self._under_way -= 1

    def _let_in(self, request: Request) -> None:
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        address = request.client.host if request.client is not None else ""
        known = self._login.try_token(token if kind.lower() == "bearer" else "", address)
        if known is None:
            raise _Refused(429, "too many wrong tokens; wait a minute")
        if not known:
            raise _Refused(401, "the token is missing or wrong")

    async def _body(self, request: Request) -> bytes:
        if request.headers.get("content-type") != CONTENT_TYPE:
            raise _Refused(415, f"send the parts as {CONTENT_TYPE}")
        most = self.settings.max_bytes
        told = request.headers.get("content-length", "0")
        out = bytearray()
        stream = request.stream()
        try:
            while not (told.isdigit() and int(told) > most):
                async with asyncio.timeout(BODY_SECONDS):
                    out += await anext(stream)
                if len(out) > most:
                    break
            raise _Refused(413, f"the request is larger than {most / 1e6:g} MB")
        except StopAsyncIteration:
            return bytes(out)
        except TimeoutError as error:
            raise _Refused(408, "the request doesn't go on") from error

    async def _answer(self, request: Request, body: bytes) -> AsyncIterator[bytes]:
        """Lines of JSON until the job ends; a client that leaves cancels it."""
        index = min(self._jobs, key=lambda i: len(self._jobs[i]))
        before = self._jobs[index]
        changed = asyncio.Event()
        loop = asyncio.get_running_loop()

        def wake(*_: object) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(changed.set)

        job: Job[Any] = self._workers[index].submit(
            backend_tasks.predict, np.frombuffer(body, np.uint8), on_progress=wake
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
        # The traceback belongs to whoever runs the backend, not to its clients.
        print(job.error.details, flush=True)
    return _line(error=str(job.error), kind=kind)


def _line(**values: Any) -> bytes:
    return json.dumps(values, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def _refusal(refused: _Refused) -> Response:
    return JSONResponse({"error": str(refused)}, refused.status)


def _plain(status: int, text: str) -> Any:
    async def answer(request: Request, error: Exception) -> Response:
        return JSONResponse({"error": text}, status)

    return answer
