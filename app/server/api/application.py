"""The application: routes, errors, and the page that documents them."""

from __future__ import annotations

import secrets
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, Response
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from app.server.api.entry import entry_router, oidc_router
from app.server.api.guard import ApiGuard, Reader
from app.server.api.objects import assets_router, objects_router, work_router
from app.server.api.people import people_router
from app.server.api.project import project_router, statistics_router, webhooks_router
from app.server.api.sessions import reviews_router, sessions_router
from app.server.app_state import AppState
from app.server.entrance import Entrance, Origins
from app.server.network import API, refusal
from model.core.errors import ArtiworldError, CommandError, NoSpaceError, StoreError, no_space
from sessions.accounts import TooManyAttempts
from sessions.review import NotPermittedError

_STATUS: tuple[tuple[type[ArtiworldError], int], ...] = (
    (TooManyAttempts, 429),
    (NotPermittedError, 403),
    (CommandError, 409),
    (NoSpaceError, 507),
    (StoreError, 503),
    (ArtiworldError, 400),
)
"""Error → status of the answer; the first that fits counts."""
_DOCUMENTS = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "favicon.png": "image/png",
}
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: REST API</title>
<link rel="stylesheet" href="{api}/docs/swagger-ui.css"></head><body><div id="ui"></div>
<script src="{api}/docs/swagger-ui-bundle.js"></script>
<script nonce="{nonce}">
SwaggerUIBundle({{ url: "{api}/openapi.json", dom_id: "#ui", deepLinking: true,
  requestInterceptor: (request) => {{ request.headers["X-ArtiWorld"] = "1"; return request; }} }});
</script></body></html>
"""


def make_application(app_state: AppState, entrance: Entrance, origins: Origins) -> ASGIApp:
    """Return the ASGI application of the API."""
    app = FastAPI(
        title="ArtiWorld",
        version=version("artiworld"),
        description="Everything that the screens decide, for scripts. See docs/teams.md.",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
    )
    app.state.app_state, app.state.entrance, app.state.origins = app_state, entrance, origins
    for router in (
        entry_router,
        oidc_router,
        objects_router,
        sessions_router,
        reviews_router,
        work_router,
        assets_router,
        statistics_router,
        people_router,
        project_router,
        webhooks_router,
    ):
        app.include_router(router, prefix=API)
    app.add_api_route(f"{API}/openapi.json", _description, include_in_schema=False)
    app.add_api_route(f"{API}/docs", _page, include_in_schema=False)
    app.add_api_route(f"{API}/docs/{{name}}", _document, include_in_schema=False)
    app.add_exception_handler(ArtiworldError, _refused)
    app.add_exception_handler(OSError, _failed)
    app.add_exception_handler(HTTPException, refusal)
    app.add_exception_handler(RequestValidationError, _invalid)
    limit = app_state.config.max_upload_mb * 1_000_000
    return ApiGuard(app, origins, entrance, f"{API}/objects", limit)


def _description(request: Request, person: Reader) -> Response:
    return JSONResponse(request.app.openapi())


def _page(person: Reader) -> Response:
    nonce = secrets.token_urlsafe(16)
    policy = (
        f"default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self'; base-uri 'none'; frame-ancestors 'none'"
    )
    page = _PAGE.format(api=API, nonce=nonce)
    return HTMLResponse(page, headers={"Content-Security-Policy": policy})


def _document(name: str, person: Reader) -> Response:
    if name not in _DOCUMENTS:
        raise HTTPException(404, "not found")
    content = (files("fastapi_offline") / "static" / name).read_bytes()
    return Response(content, media_type=_DOCUMENTS[name])


def _refused(request: Request, error: Exception) -> Response:
    status = next(status for kind, status in _STATUS if isinstance(error, kind))
    return JSONResponse({"error": str(error)}, status)


def _failed(request: Request, error: Any) -> Response:
    if (full := no_space(error.filename or "the workspace", error)) is None:
        raise error
    return _refused(request, full)


def _invalid(request: Request, error: Any) -> Response:
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return JSONResponse({"error": f"{where}: {first['msg']}"}, 422)
