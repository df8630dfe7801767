"""Sessions: commands, undo, history, predictions."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter, HTTPException
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from app.server.api.guard import Annotator, Reader, State
from app.server.api.objects import (
    decide,
    document_json,
    joints_json,
    opened,
    record_of,
    wait,
    wait_on_loop,
)
from app.server.app_state import AppState
from sessions.commands import AddRegion, Redo, Undo, from_json, to_json
from sessions.credentials import Person
from sessions.describe import describe
from sessions.live import LiveSession

router = APIRouter(tags=["sessions"])
KINDS: frozenset[str] = frozenset(
    {
        "add_click", "remove_prompt", "clear_prompts", "add_part", "name_part", "delete_part",
        "set_category", "set_joint", "set_composite", "set_root", "reset_joint", "lock_joint",
        "set_completion",
    }
)  # fmt: skip
"""Commands that a script may give; the others are results of jobs, or have a route of their own."""


class CommandBody(BaseModel):
    """A command as the history shows it.

    Attributes:
        command: its fields, and its name under ``kind``.
        expected_seq: number of the last command that the script knows; None: whatever it is.
        labels: whether to answer only once the labels that follow from it are there.
    """

    command: dict[str, Any]
    expected_seq: int | None = None
    labels: bool = False


@router.get("/objects/{object_id}/commands")
def history(object_id: int, person: Reader, state: State, after: int = 0) -> list[dict[str, Any]]:
    """All commands of an object in order, with author and time."""
    record_of(state, object_id)
    return [
        {"seq": e.seq, "at": e.at, "who": e.who, "text": describe(e.command),
         "command": to_json(e.command)}
        for e in state.store.history(object_id, after=after)
    ]  # fmt: skip


@router.post("/objects/{object_id}/commands")
async def give(
    object_id: int, body: CommandBody, person: Annotator, state: State
) -> dict[str, Any]:
    """Give one command; the answer is the object after it."""
    live, after = await run_in_threadpool(_give, object_id, body, person, state)
    if body.labels and after["prompts"]:
        await wait_on_loop(lambda: live.document.segmentation_current)
        after = await run_in_threadpool(document_json, live.state)
    return after


def _give(
    object_id: int, body: CommandBody, person: Person, state: AppState
) -> tuple[LiveSession, dict[str, Any]]:
    kind = body.command.get("kind")
    if kind not in KINDS:
        raise HTTPException(422, f"command.kind: one of {', '.join(sorted(KINDS))}")
    _check_seq(state, object_id, body.expected_seq)
    after = decide(state, object_id, from_json(body.command), person)
    return state.session(object_id), after


class RegionBody(BaseModel):
    """Elements (faces, of a cloud points) that belong to a part, or that don't.

    Attributes:
        part: its number.
        elements: numbers from 0, as the object has them now.
        positive: whether they belong to it.
        expected_seq: as of a command.
    """

    part: int
    elements: list[int] = Field(min_length=1, max_length=200_000)
    positive: bool = True
    expected_seq: int | None = None


@router.post("/objects/{object_id}/regions", status_code=201)
def add_region(object_id: int, body: RegionBody, person: Annotator, state: State) -> dict[str, Any]:
    """Mark a region of an object as part of something; the answer is the object after it."""
    count = opened(state, object_id).need_asset().element_count
    elements = np.unique(np.asarray(body.elements, np.int64))
    if elements[0] < 0 or elements[-1] >= count:
        raise HTTPException(422, f"elements: the object has those from 0 to {count - 1}")
    _check_seq(state, object_id, body.expected_seq)
    state.store.people.role_for(object_id, Undo(), person.name, person.role)  # before it is stored
    ref = state.store.put_array(elements)
    command = AddRegion(body.part, ref, body.positive, len(elements), "script")
    return decide(state, object_id, command, person)


@router.post("/objects/{object_id}/undo")
def undo(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Take back the last decision."""
    return decide(state, object_id, Undo(), person)


@router.post("/objects/{object_id}/redo")
def redo(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Do again what was taken back last."""
    return decide(state, object_id, Redo(), person)


@router.post("/objects/{object_id}/prediction", status_code=202)
def predict(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Begin to predict the joints; ask for the result until it isn't running any more."""
    obj = opened(state, object_id)
    wait(lambda: obj.document.segmentation_current)
    # Refused now, where the result would be: the job takes a while.
    state.store.people.role_for(object_id, Undo(), person.name, person.role)
    obj.predict(person.name)
    return {"running": True}


@router.get("/objects/{object_id}/prediction")
def prediction(object_id: int, person: Reader, state: State) -> dict[str, Any]:
    """The last prediction, and whether one is running."""
    record_of(state, object_id)
    doc = state.session(object_id).document
    found = doc.prediction
    return {
        "running": state.is_predicting(object_id),
        "backend": None if found is None else found.backend,
        "seconds": None if found is None else found.seconds,
        "problems": [] if found is None else list(found.problems),
        "stale": doc.prediction_stale,
        "joints": joints_json(doc),
    }


def _check_seq(state: AppState, object_id: int, expected: int | None) -> None:
    record_of(state, object_id)
    seq = state.session(object_id).state.seq
    if expected is not None and seq != expected:
        raise HTTPException(409, f"the object is at command {seq}, not {expected}")
