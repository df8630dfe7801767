"""Work: who is given what, and who is there."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, HTTPException
from pydantic import BaseModel, Field

from app.server.api.guard import Annotator, Manager, Reader, State
from app.server.api.objects import record_of
from sessions.accounts import Account
from sessions.credentials import Person

router = APIRouter(tags=["work"])


class AssignBody(BaseModel):
    """Objects, and the people who get them in turn; no people: nobody has them any more."""

    objects: list[int] = Field(min_length=1, max_length=10_000)
    people: list[str] = Field(max_length=1000)


@router.post("/assignments")
def assign(body: AssignBody, person: Manager, state: State) -> dict[str, Any]:
    """Assign objects to one person, or to several in turn."""
    people = state.store.people
    accounts = [people.accounts.find(name) for name in body.people]
    given = people.work.assign(body.objects, accounts, person.name)
    state.queue.changed()
    return {"assigned": {str(i): name for i, name in given.items()}}


@router.post("/next")
def next_object(person: Annotator, state: State) -> dict[str, Any]:
    """Lease the next object: first what came back, then what is assigned, then anything free."""
    found = state.store.people.work.next(_account(person), state.queue.records())
    return {"id": found}


@router.get("/objects/{object_id}/presence")
def presence(object_id: int, person: Reader, state: State) -> list[dict[str, Any]]:
    """Users who have an object open, and who leased it."""
    record_of(state, object_id)
    return [asdict(one) for one in state.store.people.work.present(object_id)]


@router.post("/objects/{object_id}/enter")
def enter(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Say that one works on an object; again within a minute."""
    record_of(state, object_id)
    state.store.people.work.enter(object_id, _account(person))
    return {"here": True}


@router.post("/objects/{object_id}/leave")
def leave(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Leave an object; others may take it."""
    record_of(state, object_id)
    state.store.people.work.leave(object_id, _account(person))
    return {"here": False}


def _account(person: Person) -> Account:
    if person.account is None:
        raise HTTPException(409, "there are no accounts here, so nothing is leased to anybody")
    return person.account
