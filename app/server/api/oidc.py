"""Login with an organisation's provider: there and back."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from app.server.api.guard import State, TheEntrance
from app.server.entrance import session_cookie
from app.server.login import answer_page, cookie_name
from app.server.network import API, url
from app.server.oidc import OidcLogin
from model.core.errors import ConfigurationError
from sessions.credentials import LOGIN_SECONDS

router = APIRouter(tags=["login"])
_CALLBACK = f"{API}/oidc/callback"


@router.get("/oidc/login")
def log_in_there(request: Request, state: State, entrance: TheEntrance) -> Response:
    """Go to the provider; nothing in the address decides where one comes back to."""
    try:
        address, browser = _need(entrance.oidc).begin(_redirect(request, state))
    except ConfigurationError as error:
        return _page(str(error), 502)
    answer = RedirectResponse(address, 303)
    answer.headers["Set-Cookie"] = _cookie(request, browser)
    return answer


@router.get("/oidc/callback")
def come_back(
    request: Request,
    state: State,
    entrance: TheEntrance,
) -> Response:
    """Take the provider's answer; a browser session begins where it is right."""
    oidc = _need(entrance.oidc)
    browser = request.cookies.get(_name(request), "")
    people = state.store.people
    try:
        account = oidc.finish(dict(request.query_params), browser, _redirect(request, state))
    except ConfigurationError as error:
        people.audit.add("login_failed", "", "provider", str(error), _address(request))
        return _page(str(error), 403)
    answer = _page("", 200)
    secure = request.headers.getlist("X-Forwarded-Proto") == ["https"]
    secret = entrance.begin(account, _address(request))
    port = request.app.state.origins.port
    answer.headers.append("Set-Cookie", session_cookie(secret, port, secure=secure))
    answer.headers.append("Set-Cookie", _cookie(request, ""))
    return answer


def _need(oidc: OidcLogin | None) -> OidcLogin:
    if oidc is None:
        raise HTTPException(404, "people log in with a password here")
    return oidc


def _redirect(request: Request, state: State) -> str:
    """This server's address for the provider: as it is configured, not as a request says."""
    config = state.config
    own = url(config.host, request.app.state.origins.port)
    return (config.allowed_origins[0].rstrip("/") if config.allowed_origins else own) + _CALLBACK


def _name(request: Request) -> str:
    return f"{cookie_name(request.app.state.origins.port)}_login"


def _cookie(request: Request, secret: str) -> str:
    # Lax: the provider's page leads back here, and a strict cookie would stay behind.
    seconds = int(LOGIN_SECONDS) if secret else 0
    secure = request.headers.getlist("X-Forwarded-Proto") == ["https"]
    return (
        f"{_name(request)}={secret}; Path={_CALLBACK}; HttpOnly; SameSite=Lax; Max-Age={seconds}"
        + ("; Secure" if secure else "")
    )


def _page(problem: str, status: int) -> Response:
    body, policy = answer_page(problem)
    return HTMLResponse(body, status, headers={"Content-Security-Policy": policy})


def _address(request: Request) -> str:
    return "" if request.client is None else request.client.host
