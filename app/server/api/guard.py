"""Authentication of API requests, and early refusal of those that aren't allowed."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from http.cookies import CookieError
from typing import Annotated, Any

from fastapi import Depends, HTTPException, Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.server.app_state import AppState
from app.server.entrance import Entrance, Origins
from sessions.credentials import Person
from sessions.credentials import Scope as TokenScope

log = logging.getLogger(__name__)
BODY_SECONDS = 30.0
"""Longest pause in the middle of a request."""
DISCARD_SECONDS = 1.0
"""How long the body of a refused request is read, and thrown away."""
JSON_BYTES = 1_000_000
"""Largest request but for an upload."""
OWN_HEADER = "X-ArtiWorld"
"""A page of another site can't send it, so a request with a cookie needs it to change anything."""
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    # The next request on a kept connection could be for viser's pages, which others answer.
    "Connection": "close",
}


class _Refused(Exception):
    def __init__(self, status: int, text: str) -> None:
        self.status, self.text = status, text
        super().__init__(text)


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
            person = await self._who(scope, headers)
            scope.setdefault("state", {})["person"] = person
            limit = self._upload_bytes if scope["path"] == self._upload_path else JSON_BYTES
            await self._app(scope, _limited(receive, limit, headers), answer)
        except _Refused as refused:
            if begun:
                raise
            if "Expect" not in headers:  # it waits for the answer before it sends
                await _discard(receive)
            body = json.dumps({"error": refused.text}).encode()
            kind = (b"content-type", b"application/json")
            start = {"type": "http.response.start", "status": refused.status, "headers": [kind]}
            await answer(start)
            await answer({"type": "http.response.body", "body": body})

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
            raise _Refused(400, "bad cookie") from error
        problem = self._origins.problem(headers.getlist, login=login)
        if problem:
            raise _Refused(403, problem)
        changes = scope["method"] not in ("GET", "HEAD", "OPTIONS")
        if changes and not kind and OWN_HEADER not in headers:
            raise _Refused(403, f"send the header {OWN_HEADER}: 1, or a token")
        return person


async def _discard(receive: Receive) -> None:
    """Take what is on its way: a client that is cut off while it sends never sees the answer."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(DISCARD_SECONDS):
            while (await receive()).get("more_body"):
                pass


def _limited(receive: Receive, limit: int, headers: Headers) -> Receive:
    declared = headers.get("Content-Length", "0")
    if not declared.isdigit() or int(declared) > limit:
        raise _Refused(413, f"the request is larger than {limit / 1e6:g} MB")
    taken = 0

    async def next_message() -> Message:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        if taken > limit:
            raise _Refused(413, f"the request is larger than {limit / 1e6:g} MB")
        return message

    async def in_time() -> Message:
        if taken and taken >= int(declared) > 0:  # only the end of the connection may come
            return await receive()
        try:
            async with asyncio.timeout(BODY_SECONDS):
                return await next_message()
        except TimeoutError as error:
            if taken >= int(declared):
                return {"type": "http.disconnect"}
            raise _Refused(408, "the request timed out") from error

    return in_time


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


State = Annotated[AppState, Depends(_state)]
TheEntrance = Annotated[Entrance, Depends(_entrance)]
Visitor = Annotated[Person, Depends(_person)]
Reader = Annotated[Person, need("read")]
Annotator = Annotated[Person, need("annotate")]
Reviewer = Annotated[Person, need("review")]
Manager = Annotated[Person, need("manage")]
