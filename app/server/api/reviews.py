"""Reviews: submit, accept, send back, reopen."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException
from pydantic import BaseModel

from app.server.accepting import accept, acceptance_over, withdraw
from app.server.api.guard import Annotator, Reader, Reviewer, State
from app.server.api.objects import decide, document_json, opened, wait
from model.core.errors import CommandError
from sessions.commands import AddComment, Reject, Reopen, ResolveComment, Submit
from sessions.review import RejectReason

router = APIRouter(tags=["reviews"])


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


@router.post("/objects/{object_id}/comments", status_code=201)
def add_comment(
    object_id: int, body: NewCommentBody, person: Reviewer, state: State
) -> dict[str, Any]:
    """Pin a comment to an object; it stays in its state."""
    return decide(state, object_id, AddComment(body.text, body.joint, body.place), person)


@router.put("/objects/{object_id}/comments/{number}")
def resolve_comment(
    object_id: int, number: int, body: DoneBody, person: Annotator, state: State
) -> dict[str, Any]:
    """Mark a comment as done, or as open again."""
    return decide(state, object_id, ResolveComment(number, body.done), person)


@router.get("/objects/{object_id}/checks")
def checks(object_id: int, person: Reader, state: State) -> dict[str, Any]:
    """Validation report of the joints, once it is complete."""
    obj = opened(state, object_id)
    wait(lambda: obj.validation.report is not None or bool(obj.validation.problem)
         or obj.document.tree is None)  # fmt: skip
    report = obj.validation.report
    found = None if report is None else report.to_json()
    return {"report": found, "problem": obj.validation.problem}


@router.post("/objects/{object_id}/submit")
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


@router.post("/objects/{object_id}/accept")
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
        obj, body.comment, person.name, body.override, seen=seen, refused=refused.append,
        state=asked,
    )  # fmt: skip
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


@router.post("/objects/{object_id}/reject")
def reject(object_id: int, body: RejectBody, person: Reviewer, state: State) -> dict[str, Any]:
    """Send an object back to its annotator."""
    command = Reject(body.reason, body.comment, "", body.joint, body.place, listed=True)
    return decide(state, object_id, command, person)


@router.post("/objects/{object_id}/reopen")
def reopen(object_id: int, body: CommentBody, person: Reviewer, state: State) -> dict[str, Any]:
    """Reopen an accepted or rejected object."""
    return decide(state, object_id, Reopen(body.comment), person)
