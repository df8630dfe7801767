"""Sessions: commands, undo, history, predictions."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException
from pydantic import BaseModel

from app.server.api.guard import Annotator, Reader, State
from app.server.api.objects import decide, joints_json, opened, record_of, wait
from app.server.app_state import AppState
from sessions.commands import Redo, Undo, from_json, to_json
from sessions.describe import describe

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
    """

    command: dict[str, Any]
    expected_seq: int | None = None


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
def give(object_id: int, body: CommandBody, person: Annotator, state: State) -> dict[str, Any]:
    """Give one command; the answer is the object after it."""
    kind = body.command.get("kind")
    if kind not in KINDS:
        raise HTTPException(422, f"command.kind: one of {', '.join(sorted(KINDS))}")
    _check_seq(state, object_id, body.expected_seq)
    return decide(state, object_id, from_json(body.command), person)


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
