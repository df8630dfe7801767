"""Coming in and going out: passwords, invitations, browser sessions."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from app.server.api.guard import State, TheEntrance, Visitor
from app.server.entrance import TooManyAttempts, session_cookie
from model.core.errors import ConfigurationError

router = APIRouter(tags=["login"])


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


@router.post("/login")
def log_in(
    body: LoginBody, request: Request, response: Response, entrance: TheEntrance
) -> dict[str, Any]:
    """Begin a browser session; the answer sets its cookie."""
    try:
        secret = entrance.log_in(body.name, body.password, _address(request))
    except TooManyAttempts:
        raise
    except ConfigurationError as error:
        raise HTTPException(401, str(error)) from error
    _set_cookie(request, response, secret)
    return {"logged_in": True}


@router.post("/logout")
def log_out(person: Visitor, request: Request, response: Response, state: State) -> dict[str, Any]:
    """End this browser session."""
    if person.session is not None:
        state.store.people.credentials.end_session(person.session, _address(request))
    _set_cookie(request, response, "")
    return {"logged_in": False}


@router.get("/me")
def me(person: Visitor) -> dict[str, Any]:
    """Current user and permissions."""
    role = None if person.account is None else person.account.role
    return {"name": person.name, "role": role, "scopes": sorted(person.scopes)}


@router.post("/invitation")
def invitation(body: InvitationBody, state: State) -> dict[str, Any]:
    """Whom an invitation is for."""
    account = state.store.people.accounts.invited(body.code)
    if account is None:
        raise HTTPException(404, "This invitation expired or was used; ask for a new one.")
    return {"name": account.name, "role": account.role}


@router.post("/invitation/accept")
def accept_invitation(
    body: ClaimBody, request: Request, response: Response, state: State, entrance: TheEntrance
) -> dict[str, Any]:
    """Choose a password; the answer sets the cookie of a browser session."""
    address = _address(request)
    account = state.store.people.accounts.claim(body.code, body.password, address)
    _set_cookie(request, response, entrance.begin(account, address))
    return {"name": account.name, "role": account.role}


@router.post("/password")
def change_password(body: PasswordBody, person: Visitor, state: State) -> dict[str, Any]:
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


def _set_cookie(request: Request, response: Response, secret: str) -> None:
    secure = request.headers.getlist("X-Forwarded-Proto") == ["https"]
    port = request.app.state.origins.port
    response.headers["Set-Cookie"] = session_cookie(secret, port, secure=secure)
