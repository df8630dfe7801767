"""Authentication of API requests, and early refusal of those that aren't allowed."""

from __future__ import annotations

import asyncio
import functools
import logging
import math
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import Future
from http.cookies import CookieError
from typing import Annotated, Any
from urllib.parse import unquote

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse
from pydantic import Field
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.server.app_state import AppState
from app.server.entrance import Entrance, Origins
from app.server.network import API, HEADERS, LEAST_RATE, discard, limited
from sessions.credentials import Person
from sessions.credentials import Scope as TokenScope

log = logging.getLogger(__name__)
STRANGER_SECONDS = 10.0
"""Longest time of the request of somebody who isn't logged in, such as a login."""
BODY_SECONDS = 30.0
"""Longest time of other requests but for large ones."""
JSON_BYTES = 1_000_000
"""Largest request but for an upload."""
OWN_HEADER = "X-ArtiWorld"
"""A page of another site can't send it, so a request with a cookie needs it to change anything."""
_HEADERS = HEADERS | {
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    # The next request on a kept connection could be for viser's pages, which others answer.
    "Connection": "close",
}


class ApiGuard:
    """ASGI middleware: origin, identity, size and pace of a request; headers of the answer.

    Args:
        app: the API.
        upload_path: path whose body may have ``upload_bytes``.
    """

    def __init__(
        self,
        app: ASGIApp,
        origins: Origins,
        entrance: Entrance,
        upload_path: str,
        upload_bytes: int,
    ) -> None:
        self._app, self._origins, self._entrance = app, origins, entrance
        self._upload_path, self._upload_bytes = upload_path, upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        begun = False

        async def answer(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        headers = Headers(scope=scope)
        try:
            if "\0" in unquote(scope["path"] + scope["query_string"].decode("latin-1")):
                raise HTTPException(400, "the address has a character that no text has")
            person = await self._who(scope, headers)
            scope.setdefault("state", {})["person"] = person
            limit = self._upload_bytes if scope["path"] == self._upload_path else JSON_BYTES
            seconds, rate = (BODY_SECONDS, LEAST_RATE) if person else (STRANGER_SECONDS, math.inf)
            receive = await limited(receive, headers, limit, seconds, rate)
            await self._app(scope, receive, answer)
        except HTTPException as refused:
            if begun:
                raise
            await discard(receive, headers)
            refusal = JSONResponse({"error": refused.detail}, refused.status_code)
            await refusal(scope, receive, answer)

    async def _who(self, scope: Scope, headers: Headers) -> Person | None:
        address = str((scope.get("client") or ("",))[0])
        kind, _, secret = headers.get("Authorization", "").partition(" ")
        cookies = headers.getlist("Cookie")

        def find() -> tuple[Person | None, bool]:
            if kind:  # a wrong token isn't made good by a cookie
                known = kind.lower() == "bearer"
                person = self._entrance.bearer(secret.strip(), address) if known else None
            else:
                person = self._entrance.visitor(cookies, self._origins.port)
            return person, self._entrance.needed

        try:
            person, login = await asyncio.to_thread(find)
        except CookieError as error:
            raise HTTPException(400, "bad cookie") from error
        problem = self._origins.problem(headers.getlist, login=login)
        if problem:
            raise HTTPException(403, problem)
        changes = scope["method"] not in ("GET", "HEAD", "OPTIONS")
        if changes and not kind and OWN_HEADER not in headers:
            raise HTTPException(403, f"send the header {OWN_HEADER}: 1, or a token")
        return person


def _person(request: Request) -> Person:
    person: Person | None = request.state.person
    if person is None:
        raise HTTPException(401, "log in, or send a token that is valid")
    return person


def need(scope: TokenScope) -> Any:
    """Return a dependency: the current user, who needs ``scope``."""

    def allowed(person: Annotated[Person, Depends(_person)]) -> Person:
        if scope not in person.scopes:
            raise HTTPException(403, f"this needs the scope {scope}")
        return person

    return Depends(allowed)


def _state(request: Request) -> AppState:
    return request.app.state.app_state


def _entrance(request: Request) -> Entrance:
    return request.app.state.entrance


Json = dict[str, Any]
Id = Annotated[int, Field(ge=1, le=2**31 - 1)]
"""A number that something is stored under; larger ones don't fit into a database's column."""
Count = Annotated[int, Field(ge=0, le=2**31 - 1)]
"""How many, or a place from 0."""
State = Annotated[AppState, Depends(_state)]
TheEntrance = Annotated[Entrance, Depends(_entrance)]
Visitor = Annotated[Person, Depends(_person)]
Reader = Annotated[Person, need("read")]
Annotator = Annotated[Person, need("annotate")]
Reviewer = Annotated[Person, need("review")]
Manager = Annotated[Person, need("manage")]

ANSWER_SECONDS = 1.5
"""Time after which an answer is a job to ask for."""
MOST_JOBS = 128
"""Requests at a time; a person may have a quarter. So many results wait for their people."""
_jobs: dict[str, tuple[str, Future[Any]]] = {}


async def in_time(person: Person, work: Callable[[], Any]) -> Any:
    """Return the result of ``work``, or after a while an answer with the job to ask for.

    Each has a thread of its own, so quick requests wait for none.

    Raises:
        HTTPException: 429, where a person, or all of them, have too many.
    """
    running = [who for who, answer in _jobs.values() if not answer.done()]
    if len(running) >= MOST_JOBS or running.count(person.name) >= MOST_JOBS // 4:
        raise HTTPException(429, "too many requests are being worked on; wait for some")
    for old in [number for number, (_, answer) in _jobs.items() if answer.done()][:-MOST_JOBS]:
        del _jobs[old]
    number, answer = secrets.token_hex(12), Future[Any]()
    _jobs[number] = person.name, answer
    answer.set_running_or_notify_cancel()  # who leaves doesn't cancel it

    def run() -> None:
        try:
            answer.set_result(work())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=run, name="request", daemon=True).start()
    return await result_of(person, number)


async def result_of(person: Person, number: str) -> Any:
    """Return the result of a person's job, once; or its number again, where it takes longer.

    Raises:
        HTTPException: 404, where the person has no such job.
        Exception: as the work raised it.
    """
    who, answer = _jobs.get(number, (None, Future[Any]()))
    if who != person.name:
        raise HTTPException(404, "there is no such job of yours, or you have its result")
    ended = asyncio.wrap_future(answer)
    ended.add_done_callback(lambda done: done.cancelled() or done.exception())  # raised below
    await asyncio.wait([ended], timeout=ANSWER_SECONDS)
    if not answer.done():
        return JSONResponse({"job": number}, 202, {"Location": f"{API}/jobs/{number}"})
    _jobs.pop(number, None)
    return answer.result()


class LongRouter(APIRouter):
    """Its routes have a ``person`` and may take long."""

    def add_api_route(self, path: str, endpoint: Callable[..., Any], **settings: Any) -> None:
        """See the base class."""

        @functools.wraps(endpoint)
        async def answered(**values: Any) -> Any:
            return await in_time(values["person"], functools.partial(endpoint, **values))

        super().add_api_route(path, answered, **settings)
