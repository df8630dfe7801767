"""viser's web server, made safe to leave running.

viser 1.1.1 listens on all interfaces without login, accepts any page's websocket, lets any client
open a public tunnel and takes uploads of any size. There are no settings for that, so this file
wraps the call with which viser opens its port. It uses viser's internals, so the version is
pinned.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import logging
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qsl, quote, unquote, urlsplit

import viser
import websockets.asyncio.server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.server.entrance import Entrance, Origins, is_plain_netloc
from app.server.login import Login, login_page
from app.server.network import (
    HEADERS,
    ApiConnections,
    OncePerMinute,
    Places,
    Room,
    SharedConnection,
    check_address,
    is_loopback,
)
from app.server.page import Page, guard_messages
from app.server.uploads import UploadGuard
from model.core.errors import ConfigurationError, StoreError
from model.core.packages import install_command
from sessions.credentials import Person

VISER_VERSION = "1.1.1"
MAX_MESSAGE_BYTES = 16 * 2**20
"""Largest websocket message from a browser; uploads come in parts of 0.5 MB."""
MAX_CONNECTIONS = 64
MAX_PATH = 2000
"""Characters; file systems refuse names that are much longer."""
APP_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; font-src 'self' data:; "
    "connect-src 'self' {websocket} blob: data:; worker-src 'self' blob: data:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = HEADERS | {"Cross-Origin-Opener-Policy": "same-origin"}

SESSION_CHECK_SECONDS = 2.0
"""Period of asking whether the browser session of a connection was revoked."""

_log = logging.getLogger("artiworld.http")
_PERSON: ContextVar[Person | None] = ContextVar("person", default=None)
"""Whose connection a task serves."""


@dataclass(frozen=True)
class RouteRequest:
    """A GET request of a visitor who is logged in.

    Attributes:
        path: decoded, without the query.
        query: decoded; the last of repeated names counts.
    """

    path: str
    query: Mapping[str, str]


@dataclass(frozen=True)
class RouteAnswer:
    """The answer of a route.

    Attributes:
        body, content_type, status: of the HTTP response.
        download_name: the browser saves the body under this name instead of showing it.
    """

    body: bytes
    content_type: str = "application/json"
    status: int = 200
    download_name: str | None = None


Route = Callable[[RouteRequest], RouteAnswer]
"""Answers a request, on a thread of its own, so it may read files."""


def guarded_server(
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    max_upload_bytes: int = 500_000_000,
    routes: Mapping[str, Route] | None = None,
    *,
    label: str | None = None,
    allowed_origins: tuple[str, ...] = (),
    trusted_proxies: tuple[str, ...] = (),
    entrance: Entrance | None = None,
    api: Callable[[Origins], Any] | None = None,
    room: Room | None = None,
) -> viser.ViserServer:
    """Start a viser server behind the guard.

    Args:
        host: address to listen at; any but this machine's own needs a token.
        port: port to listen at; 0 for any free one.
        token: token of the visitors; None admits every user of this machine.
        max_upload_bytes: largest file.
        routes: path → answer, beside viser's page; a path that ends in "/" is a prefix.
        label: title of the panel and of the browser's tab.
        allowed_origins: other addresses of this server behind a proxy, such as
            ``https://scans.example.org``.
        trusted_proxies: addresses or networks whose X-Forwarded-For the API believes.
        entrance: knows the visitors, by account where there are accounts; None: by the token.
        api: makes the ASGI application below :data:`~app.server.network.API`; None: none.
        room: for uploads; None: for two of the largest.

    Raises:
        ConfigurationError: where the address can't be used, or is public without a token.
    """
    if viser.__version__ != VISER_VERSION:
        raise ConfigurationError(
            f"viser {viser.__version__} is installed, but the web server's guard needs "
            f"{VISER_VERSION}; run: {install_command(f'viser=={VISER_VERSION}')}"
        )
    entrance = entrance or Entrance(None, Login(token))
    if not entrance.needed and not is_loopback(host):
        raise ConfigurationError(
            f"--host {host} is open to other machines; give a --token, or use --host 127.0.0.1"
        )
    check_address(host, port)
    page = Page(label or "ArtiWorld", max_upload_bytes)
    origins = Origins(host, allowed_origins)
    connections = None if api is None else ApiConnections(api(origins), trusted_proxies)
    places, found = Places(trusted_proxies), dict(routes or {})
    guard = _Guard(Login(token), entrance, origins, page, found, connections, places)
    with _wrapped_serve(guard), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    endpoint = server._websock_server
    if not guard.wrapped or (port and server.get_port() != port):
        server.stop()
        raise ConfigurationError(f"port {port} was taken just now; choose another with --port")
    origins.port = server.get_port()
    for kind in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        endpoint.unregister_handler(kind)
    server.request_share_url = _no_tunnel
    uploads = UploadGuard(max_upload_bytes, room or Room(2 * max_upload_bytes))
    uploads.attach(endpoint)
    endpoint.on_client_connect(uploads.attach_client)
    endpoint.on_client_connect(guard_messages)
    guard_messages(endpoint)
    endpoint.on_client_connect(guard.attach_person)
    endpoint.on_client_disconnect(uploads.forget)
    endpoint.on_client_disconnect(entrance.forget_tab)
    guard.ready = True
    return server


def _no_tunnel(*_: object, **__: object) -> None:
    raise ConfigurationError("sharing through a public tunnel is switched off")


@contextlib.contextmanager
def _wrapped_serve(guard: _Guard) -> Iterator[None]:
    module = websockets.asyncio.server  # viser takes "serve" from it
    real = module.serve

    def serve(handler: Any, host: str, port: int, *, process_request: Any, **settings: Any) -> Any:
        guard.wrapped = True
        settings["max_size"] = MAX_MESSAGE_BYTES
        settings["create_connection"] = type(
            "Connection", (SharedConnection,), {"api": guard.api, "places": guard.places}
        )
        return real(
            guard.limited(handler),
            host,
            port,
            process_request=guard.process(process_request),
            process_response=guard.finish,
            server_header=None,
            logger=_log,
            **settings,
        )

    module.serve = serve
    try:
        yield
    finally:
        module.serve = real


@dataclass
class _Guard:
    """Decides about every HTTP request and websocket, on the server's event loop."""

    login: Login
    entrance: Entrance
    origins: Origins
    page: Page
    routes: Mapping[str, Route]
    api: ApiConnections | None
    places: Places
    ready: bool = False
    wrapped: bool = False
    _open: dict[ServerConnection, Person] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Port scanners leave requests incomplete.
        _log.addFilter(lambda record: record.getMessage() != "opening handshake failed")
        for log in (_log, logging.getLogger("asyncio")):
            log.addFilter(OncePerMinute())

    def limited(self, handler: Callable[[ServerConnection], Any]) -> Callable[..., Any]:
        async def limited_handler(connection: ServerConnection) -> None:
            if len(self._open) >= MAX_CONNECTIONS:
                await connection.close(1013, "too many connections")
                return
            person = await self._person(connection.request)
            if person is None:  # it ended since the handshake began
                await connection.close(1008, "log in again")
                return
            self._open[connection] = person
            _PERSON.set(person)
            check = asyncio.create_task(self._end_with_session(connection, person))
            try:
                await handler(connection)
            finally:
                check.cancel()
                del self._open[connection]

        return limited_handler

    async def attach_person(self, connection: Any) -> None:
        """Note whose browser it is, in the task that serves the connection."""
        person = _PERSON.get()
        if person is not None:
            self.entrance.tabs[connection.client_id] = person

    async def _person(self, request: Request | None) -> Person | None:
        cookies = [] if request is None else request.headers.get_all("Cookie")
        return await asyncio.to_thread(self.entrance.visitor, cookies, self.origins.port)

    async def _end_with_session(self, connection: ServerConnection, person: Person) -> None:
        """Close a connection soon after its browser session was revoked."""
        while True:
            await asyncio.sleep(SESSION_CHECK_SECONDS)
            try:
                ended = await asyncio.to_thread(self._has_ended, person)
            except StoreError:  # the database is away: nobody can decide anything, either
                continue
            if ended:
                await connection.close(1008, "logged out")
                return

    def _has_ended(self, person: Person) -> bool:
        if person.session is None:  # it began before there were accounts
            return self.entrance.with_accounts
        now = self.entrance.session(person.session)
        # With another role the page connects again, as who it is then.
        return now is None or now.account != person.account

    def process(self, viser_page: Callable[..., Any]) -> Callable[..., Any]:
        async def process_request(
            connection: ServerConnection, request: Request
        ) -> Response | None:
            if len(request.path) > MAX_PATH:
                return _text(HTTPStatus.REQUEST_URI_TOO_LONG, "the address is too long")
            path = unquote(request.path.partition("?")[0])
            if path == "/healthz":
                return _text(HTTPStatus.OK, json.dumps({"status": "ok"}), "application/json")
            if not self.ready:
                answer = _text(HTTPStatus.SERVICE_UNAVAILABLE, "starting")
                answer.headers["Refresh"] = "1"  # the browser asks again after a second
                return answer
            person = await self._person(request)
            connection.known = person is not None  # type: ignore[attr-defined]
            login = self.entrance.needed
            problem = self.origins.problem(request.headers.get_all, login=login)
            if problem:
                return _text(HTTPStatus.FORBIDDEN, problem)
            if path == "/login":
                if self.entrance.with_accounts:
                    oidc = self.entrance.oidc
                    label = "" if oidc is None else oidc.settings.label
                    name = "" if person is None else person.name
                    return _page(login_page("account", person=name, provider=label))
                return self._answer_login(connection, request)
            if person is None:
                return self._not_logged_in(request, path)
            route = self._route(path)
            if route is not None:
                query = dict(parse_qsl(urlsplit(request.path).query))
                answer = await asyncio.to_thread(_call_route, route, RouteRequest(path, query))
                return _response(answer)
            answer = viser_page(connection, request)
            return None if answer is None else self.page.prepare(answer)

        return process_request

    def finish(self, _: ServerConnection, request: Request, response: Response) -> None:
        """Add the security headers to every response."""
        for name, value in _HEADERS.items():
            response.headers[name] = value
        if "Content-Security-Policy" not in response.headers:
            host = next(iter(request.headers.get_all("Host")), "")
            websocket = f"ws://{host} wss://{host}" if is_plain_netloc(host) else ""
            policy = APP_POLICY.format(websocket=websocket)
            response.headers["Content-Security-Policy"] = policy
        if "Cache-Control" not in response.headers and response.status_code != 101:
            response.headers["Cache-Control"] = "no-store"

    def _answer_login(self, connection: ServerConnection, request: Request) -> Response:
        if not self.login.needed:
            return _redirect("/")
        query = dict(parse_qsl(urlsplit(request.path).query))
        by_header = request.headers.get_all("X-ArtiWorld-Token")
        token = unquote(by_header[0]) if by_header else query.get("token")
        if token is None:
            return _page(login_page("token"))
        address = str((connection.remote_address or ("",))[0])
        right = self.login.try_token(token, address)
        if right:
            response = _text(HTTPStatus.OK, "welcome") if by_header else _redirect("/")
            secure = request.headers.get_all("X-Forwarded-Proto") == ["https"]
            response.headers["Set-Cookie"] = self.login.cookie(self.origins.port, secure=secure)
            return response
        _log.warning("login refused to %s", address)
        if right is None:
            status, problem = HTTPStatus.TOO_MANY_REQUESTS, "Too many wrong tokens; wait a minute."
        else:
            status, problem = HTTPStatus.UNAUTHORIZED, "That is not the token."
        page = _page(login_page("token", problem=problem), status)
        return _text(status, problem) if by_header else page

    def _not_logged_in(self, request: Request, path: str) -> Response:
        if path == "/" and "Upgrade" not in request.headers:
            return _redirect("/login")
        return _text(HTTPStatus.UNAUTHORIZED, "log in first, at /login")

    def _route(self, path: str) -> Route | None:
        if path in self.routes:
            return self.routes[path]
        folders = [r for r in self.routes if r.endswith("/") and r != "/" and path.startswith(r)]
        return self.routes[max(folders, key=len)] if folders else None


def _call_route(route: Route, request: RouteRequest) -> RouteAnswer:
    try:
        return route(request)
    except Exception:  # the connection's handler must go on
        _log.exception("route %s failed", request.path)
        return RouteAnswer(b"this went wrong; see the server's log", "text/plain", 500)


def _text(status: HTTPStatus, text: str, kind: str = "text/plain; charset=utf-8") -> Response:
    return _response(RouteAnswer(text.encode(), kind, status))


def _page(page: tuple[bytes, str], status: HTTPStatus = HTTPStatus.OK) -> Response:
    body, policy = page
    response = _response(RouteAnswer(body, "text/html; charset=utf-8", status))
    response.headers["Content-Security-Policy"] = policy
    return response


def _redirect(target: str) -> Response:
    response = _text(HTTPStatus.SEE_OTHER, "")
    response.headers["Location"] = target
    return response


def _response(answer: RouteAnswer) -> Response:
    headers = Headers(
        {
            "Date": formatdate(usegmt=True),
            "Connection": "close",
            "Content-Type": answer.content_type,
            "Content-Length": str(len(answer.body)),
        }
    )
    if answer.download_name is not None:
        name = quote(answer.download_name, safe="")
        headers["Content-Disposition"] = f"attachment; filename*=UTF-8''{name}"
    status = HTTPStatus(answer.status)
    return Response(status.value, status.phrase, headers, answer.body)
