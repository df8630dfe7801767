"""People: accounts, tokens, and the record of what happened to them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, HTTPException, Query, Request
from pydantic import BaseModel, Field

from app.server.api.guard import Count, Id, Json, Manager, Reader, State, Visitor
from sessions.account_tables import MOST_EVENTS
from sessions.credentials import TOKEN_DAYS
from sessions.review import Role

people_router = APIRouter(tags=["people"])


class InviteBody(BaseModel):
    """Name and role of an invited person."""

    name: str = Field(max_length=200)
    role: Role = "annotator"


class RoleBody(BaseModel):
    """New role of an account."""

    role: Role


class TokenBody(BaseModel):
    """Label, scopes and lifetime in days of a new token."""

    label: str = Field(max_length=200)
    scopes: list[str] = Field(min_length=1, max_length=10)
    days: Count = TOKEN_DAYS


@people_router.get("/users")
def users(person: Manager, state: State) -> list[Json]:
    """All accounts."""
    return [asdict(account) for account in state.store.people.accounts.all()]


@people_router.post("/users", status_code=201)
def invite(body: InviteBody, person: Manager, request: Request, state: State) -> Json:
    """Invite a person; the code is shown once, and goes behind /login#invitation=."""
    code = state.store.people.accounts.invite(body.name, body.role, person.name)
    return {"code": code, "path": f"/login#invitation={code}"}


@people_router.put("/users/{name}/role")
def set_role(name: str, body: RoleBody, person: Manager, state: State) -> Json:
    """Change what a person may do, from the next command on."""
    return asdict(state.store.people.accounts.set_role(name, body.role, person.name))


@people_router.post("/users/{name}/disable")
def disable(name: str, person: Manager, state: State) -> Json:
    """Keep a person out; decisions stay."""
    state.store.people.accounts.disable(name, person.name)
    return {"disabled": name}


@people_router.post("/users/{name}/revoke")
def revoke(name: str, person: Manager, state: State) -> Json:
    """End all browser sessions and tokens of a person, who may log in again."""
    people = state.store.people
    people.credentials.revoke(people.accounts.find(name), person.name)
    return {"revoked": name}


@people_router.get("/tokens")
def tokens(person: Reader, state: State) -> list[Json]:
    """One's own tokens, without their secrets."""
    return [asdict(t) for t in state.store.people.credentials.tokens(person.account)]


@people_router.post("/tokens", status_code=201)
def make_token(body: TokenBody, person: Visitor, state: State) -> Json:
    """Make a token in a logged-in browser; its secret is shown once."""
    if person.account is None or person.session is None:
        raise HTTPException(403, "make tokens in a browser in which you are logged in")
    credentials = state.store.people.credentials
    secret = credentials.make_token(person.account, body.label, body.scopes, body.days, person.name)
    return {"token": secret}


@people_router.delete("/tokens/{token_id}")
def revoke_token(token_id: Id, person: Visitor, state: State) -> Json:
    """Revoke one of one's own tokens in a logged-in browser; a manager may revoke any."""
    if person.session is None and "manage" not in person.scopes:
        raise HTTPException(403, "revoke tokens in a browser, or with the scope manage")
    credentials = state.store.people.credentials
    own = None if "manage" in person.scopes else person.account
    if all(t.id != token_id for t in credentials.tokens(own)):
        raise HTTPException(404, f"there is no token {token_id}")
    credentials.revoke_token(token_id, person.name)
    return {"revoked": token_id}


@people_router.get("/set-aside")
def set_aside(person: Manager, state: State) -> list[Json]:
    """Stored items that this server works on and that failed, with their errors."""
    aside = state.stored.aside
    found = [(*key, *why) for key in list(aside) if (why := aside.get(key))]
    return [{"work": w, "item": f"{i}", "failures": n, "error": e} for w, i, n, e in found]


@people_router.get("/audit")
def audit(
    person: Manager,
    state: State,
    name: str | None = None,
    kind: str | None = None,
    since: str | None = None,
    before: Count | None = None,
    count: Annotated[int, Query(ge=1, le=MOST_EVENTS)] = 200,
) -> list[Json]:
    """Audit log of accounts, newest first; ``before`` an id gives the next page."""
    log = state.store.people.audit
    events = log.events(name=name, kind=kind, since=since, before=before, count=count)
    return [asdict(event) for event in events]


@people_router.get("/audit/decisions")
def decisions(
    person: Manager,
    state: State,
    who: str | None = None,
    object_id: Annotated[Id | None, Query(alias="object")] = None,
    kind: str | None = None,
    since: str | None = None,
    first: Count = 0,
    count: Annotated[int, Query(ge=1, le=MOST_EVENTS)] = 200,
) -> list[Json]:
    """Decisions about objects with their authors, newest first."""
    log = state.store.people.audit
    found = log.decisions(
        who=who, object_id=object_id, kind=kind, since=since, first=first, count=count
    )
    return [asdict(one) for one in found]
