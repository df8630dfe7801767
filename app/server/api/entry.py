"""Coming in and going out: passwords, invitations, browser sessions, and login with an
organisation's provider, there and back.
"""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from pydantic import BaseModel, Field

from app.server.api.guard import Json, State, TheEntrance, Visitor
from app.server.login import OidcLogin, cookie_name, login_page
from app.server.network import API, url
from model.core.errors import ConfigurationError
from sessions.accounts import TooManyAttempts
from sessions.credentials import LOGIN_SECONDS, SESSION_SECONDS

entry_router = APIRouter(tags=["login"])


class LoginBody(BaseModel):
    """Name and password."""

    name: str = Field(max_length=200)
    password: str = Field(max_length=2000)


class InvitationBody(BaseModel):
    """The secret of an invitation's link."""

    code: str = Field(max_length=200)


class ClaimBody(InvitationBody):
    """The secret, and the password that the person chose."""

    password: str = Field(max_length=2000)


class PasswordBody(BaseModel):
    """The password so far, and the new one."""

    old: str = Field(max_length=2000)
    new: str = Field(max_length=2000)


@entry_router.post("/login")
def log_in(body: LoginBody, request: Request, response: Response, entrance: TheEntrance) -> Json:
    """Begin a browser session; the answer sets its cookie."""
    try:
        secret = entrance.log_in(body.name, body.password, _address(request))
    except TooManyAttempts:
        raise
    except ConfigurationError as error:
        raise HTTPException(401, str(error)) from error
    _set_cookie(request, response, secret)
    return {"logged_in": True}


@entry_router.post("/logout")
def log_out(person: Visitor, request: Request, response: Response, state: State) -> Json:
    """End this browser session."""
    if person.session is not None:
        state.store.people.credentials.end_session(person.session, _address(request))
    _set_cookie(request, response, "")
    return {"logged_in": False}


@entry_router.get("/me")
def me(person: Visitor) -> Json:
    """Current user and permissions."""
    role = None if person.account is None else person.account.role
    return {"name": person.name, "role": role, "scopes": sorted(person.scopes)}


@entry_router.post("/invitation")
def invitation(body: InvitationBody, state: State) -> Json:
    """Whom an invitation is for."""
    account = state.store.people.accounts.invited(body.code)
    if account is None:
        raise HTTPException(404, "This invitation expired or was used; ask for a new one.")
    return {"name": account.name, "role": account.role}


@entry_router.post("/invitation/accept")
def accept_invitation(body: ClaimBody, request: Request, response: Response, state: State) -> Json:
    """Choose a password; the answer sets the cookie of a browser session."""
    people, address = state.store.people, _address(request)
    account = people.accounts.claim(body.code, body.password, address)
    _set_cookie(request, response, people.credentials.begin_session(account, address))
    return {"name": account.name, "role": account.role}


@entry_router.post("/password")
def change_password(body: PasswordBody, person: Visitor, state: State) -> Json:
    """Change the password; all other browser sessions and all tokens end."""
    if person.account is None or person.session is None:
        raise HTTPException(403, "change it in a browser in which you are logged in")
    accounts = state.store.people.accounts
    if accounts.check(person.name, body.old) is None:
        raise HTTPException(401, "The password so far is wrong.")
    accounts.change_password(person.name, body.new, person.name, keep=person.session)
    return {"changed": True}


def _address(request: Request) -> str:
    return "" if request.client is None else request.client.host


def _set_cookie(request: Request, response: Response, secret: str, *, there: bool = False) -> None:
    """Set the cookie of a browser session, or of a login ``there``; "" as secret ends it."""
    response.set_cookie(
        _name(request) if there else cookie_name(request.app.state.origins.port),
        secret,
        int(LOGIN_SECONDS if there else SESSION_SECONDS) if secret else 0,
        path=_CALLBACK if there else "/",
        secure=request.headers.getlist("X-Forwarded-Proto") == ["https"],
        httponly=True,
        # The provider's page leads back here, and a strict cookie would stay behind.
        samesite="lax" if there else "strict",
    )


oidc_router = APIRouter(tags=["login"])
_CALLBACK = f"{API}/oidc/callback"


@oidc_router.get("/oidc/login")
def log_in_there(request: Request, state: State, entrance: TheEntrance) -> Response:
    """Go to the provider; nothing in the address decides where one comes back to."""
    try:
        address, browser = _need(entrance.oidc).begin(_redirect(request, state))
    except ConfigurationError as error:
        return _page(str(error), 502)
    answer = RedirectResponse(address, 303)
    _set_cookie(request, answer, browser, there=True)
    return answer


@oidc_router.get("/oidc/callback")
def come_back(request: Request, state: State, entrance: TheEntrance) -> Response:
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
    secret = people.credentials.begin_session(account, _address(request))
    _set_cookie(request, answer, secret)
    _set_cookie(request, answer, "", there=True)
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


def _page(problem: str, status: int) -> Response:
    body, policy = login_page("answer", problem=problem)
    return HTMLResponse(body, status, headers={"Content-Security-Policy": policy})
