"""Sessions: commands, undo, history, predictions; and reviews: submit, accept, send back,
reopen.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter, HTTPException
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from app.server.accepting import accept, acceptance_over, withdraw
from app.server.api.guard import Annotator, Reader, Reviewer, State
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
from model.core.errors import CommandError
from sessions.commands import (
    AddComment,
    AddRegion,
    Redo,
    Reject,
    Reopen,
    ResolveComment,
    Submit,
    Undo,
    from_json,
    to_json,
)
from sessions.credentials import Person
from sessions.live import LiveSession
from sessions.review import RejectReason

sessions_router = APIRouter(tags=["sessions"])
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


@sessions_router.get("/objects/{object_id}/commands")
def history(object_id: int, person: Reader, state: State, after: int = 0) -> list[dict[str, Any]]:
    """All commands of an object in order, with author and time."""
    record_of(state, object_id)
    return [
        {
            "seq": e.seq,
            "at": e.at,
            "who": e.who,
            "text": e.command.describe(),
            "command": to_json(e.command),
        }
        for e in state.store.history(object_id, after=after)
    ]


@sessions_router.post("/objects/{object_id}/commands")
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
    if "answer" in body.command:
        raise HTTPException(422, "command.answer: labels come from the segmenter alone")
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


@sessions_router.post("/objects/{object_id}/regions", status_code=201)
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


@sessions_router.post("/objects/{object_id}/undo")
def undo(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Take back the last decision."""
    return decide(state, object_id, Undo(), person)


@sessions_router.post("/objects/{object_id}/redo")
def redo(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Do again what was taken back last."""
    return decide(state, object_id, Redo(), person)


@sessions_router.post("/objects/{object_id}/prediction", status_code=202)
def predict(object_id: int, person: Annotator, state: State) -> dict[str, Any]:
    """Begin to predict the joints; ask for the result until it isn't running any more."""
    obj = opened(state, object_id)
    wait(lambda: obj.document.segmentation_current)
    # Refused now, where the result would be: the job takes a while.
    state.store.people.role_for(object_id, Undo(), person.name, person.role)
    obj.predict(person.name)
    return {"running": True}


@sessions_router.get("/objects/{object_id}/prediction")
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


reviews_router = APIRouter(tags=["reviews"])


class CommentBody(BaseModel):
    """Human-readable comment."""

    comment: str = ""


class AcceptBody(CommentBody):
    """Request to accept an object.

    Attributes:
        override: reason for accepting despite errors.
        warnings_seen: whether a person saw the warnings of the checks.
    """

    override: str = ""
    warnings_seen: bool = False


class RejectBody(CommentBody):
    """Why an object goes back.

    Attributes:
        joint: child link of the joint that the comment is about.
        place: the place that it is about, metres, object frame.
    """

    reason: RejectReason
    joint: str = ""
    place: tuple[float, float, float] | None = None


class NewCommentBody(BaseModel):
    """A comment, and what it is about: a joint by its child link, or a place as of a rejection."""

    text: str
    joint: str = ""
    place: tuple[float, float, float] | None = None


class DoneBody(BaseModel):
    """New state of a comment."""

    done: bool = True


@reviews_router.post("/objects/{object_id}/comments", status_code=201)
def add_comment(
    object_id: int, body: NewCommentBody, person: Reviewer, state: State
) -> dict[str, Any]:
    """Pin a comment to an object; it stays in its state."""
    return decide(state, object_id, AddComment(body.text, body.joint, body.place), person)


@reviews_router.put("/objects/{object_id}/comments/{number}")
def resolve_comment(
    object_id: int, number: int, body: DoneBody, person: Annotator, state: State
) -> dict[str, Any]:
    """Mark a comment as done, or as open again."""
    return decide(state, object_id, ResolveComment(number, body.done), person)


@reviews_router.get("/objects/{object_id}/checks")
def checks(object_id: int, person: Reader, state: State) -> dict[str, Any]:
    """Validation report of the joints, once it is complete."""
    obj = opened(state, object_id)
    wait(
        lambda: (
            obj.validation.report is not None
            or bool(obj.validation.problem)
            or obj.document.tree is None
        )
    )
    report = obj.validation.report
    found = None if report is None else report.to_json()
    return {"report": found, "problem": obj.validation.problem}


@reviews_router.post("/objects/{object_id}/submit")
def submit(object_id: int, body: CommentBody, person: Annotator, state: State) -> dict[str, Any]:
    """Hand an object in for review, once the checks that the project requires found nothing."""
    if state.store.project.settings.required:
        obj = opened(state, object_id)
        asked, check = obj.live.refresh(), obj.validation
        wait(lambda: obj.document.tree is None or bool(check.report or check.problem))
        if refusal := check.required_problem():
            raise CommandError(refusal)
        command = Submit(body.comment)
        return document_json(obj.live.do(command, person.name, role=person.role, since=asked))
    return decide(state, object_id, Submit(body.comment), person)


@reviews_router.post("/objects/{object_id}/accept")
def accept_object(
    object_id: int, body: AcceptBody, person: Reviewer, state: State
) -> dict[str, Any]:
    """Accept an object; its asset is written and read back first."""
    obj = opened(state, object_id)
    asked = obj.live.refresh()  # it may have been submitted at another server just now
    wait(lambda: obj.validation.report is not None or bool(obj.validation.problem))
    seen = obj.validation.report if body.warnings_seen else None
    refused: list[CommandError] = []
    accept(
        obj,
        body.comment,
        person.name,
        body.override,
        seen=seen,
        refused=refused.append,
        state=asked,
    )
    try:
        wait(lambda: bool(refused) or acceptance_over(obj))
    except HTTPException:
        withdraw(obj)
        raise
    if refused:
        raise refused[0]
    if obj.document.review.state != "accepted":
        raise CommandError("it wasn't accepted: its asset couldn't be written")
    return document_json(obj.state)


@reviews_router.post("/objects/{object_id}/reject")
def reject(object_id: int, body: RejectBody, person: Reviewer, state: State) -> dict[str, Any]:
    """Send an object back to its annotator."""
    command = Reject(body.reason, body.comment, "", body.joint, body.place, listed=True)
    return decide(state, object_id, command, person)


@reviews_router.post("/objects/{object_id}/reopen")
def reopen(object_id: int, body: CommentBody, person: Reviewer, state: State) -> dict[str, Any]:
    """Reopen an accepted or rejected object."""
    return decide(state, object_id, Reopen(body.comment), person)
