"""Objects: upload, list, filter, and what is decided about one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query, Request
from starlette.concurrency import run_in_threadpool

from app.server.api.guard import Annotator, Reader, State
from app.server.app_state import AppState
from app.server.open_object import OpenObject
from model.core import codec
from sessions.commands import Command
from sessions.credentials import Person
from sessions.database import ObjectRecord
from sessions.document import Document
from sessions.state import SessionState, needed_jobs

router = APIRouter(tags=["objects"])
MOST = 500
"""Objects in one answer."""
OPEN_SECONDS = 60.0
"""Longest wait for an object to be read, or for labels that are being computed."""
POLL_SECONDS, LOOK_SECONDS = 0.05, 0.01
"""Pause between two looks of a waiting thread, and of the event loop."""
KEEP_SECONDS = 300.0
"""An object that a script worked on stays open so long after: it would be encoded anew else."""


@router.get("/objects")
def list_objects(
    person: Reader,
    state: State,
    review_state: Annotated[str | None, Query(alias="state")] = None,
    category: str | None = None,
    search: str = "",
    assigned_to: str | None = None,
    first: Annotated[int, Query(ge=0)] = 0,
    count: Annotated[int, Query(ge=1, le=MOST)] = 100,
) -> dict[str, Any]:
    """List objects in the order of the queue, filtered."""
    assigned = state.store.people.work.assigned()
    words = search.lower().split()
    found = [
        r for r in state.queue.records()
        if review_state in (None, r.state)
        and category in (None, r.category)
        and assigned_to in (None, assigned.get(r.id))
        and all(w in f"{r.name} {r.category or ''}".lower() for w in words)
    ]  # fmt: skip
    shown = found[first : first + count]
    return {"total": len(found), "objects": [_line(r, assigned.get(r.id)) for r in shown]}


@router.post("/objects", status_code=201)
async def upload(request: Request, name: str, person: Annotator, state: State) -> dict[str, Any]:
    """Add a file, or a zip of one object or several; the body is its content."""
    content = await request.body()
    object_id = await run_in_threadpool(state.add_upload, name, content)
    record = await run_in_threadpool(state.store.object, object_id)
    return _line(record, None)


@router.get("/objects/{object_id}")
def one_object(object_id: int, person: Reader, state: State) -> dict[str, Any]:
    """Decisions about one object: parts, prompts, joints, review."""
    record = record_of(state, object_id)
    assigned = state.store.people.work.assigned().get(object_id)
    now = state.session(object_id).refresh()  # another server may be ahead
    return {**_line(record, assigned), **document_json(now)}


def record_of(state: AppState, object_id: int) -> ObjectRecord:
    """Return an object of the queue.

    Raises:
        HTTPException: 404, where the queue hasn't it.
    """
    if all(r.id != object_id for r in state.queue.records()):
        raise HTTPException(404, f"there is no object {object_id}")
    return state.store.object(object_id)


def opened(state: AppState, object_id: int) -> OpenObject:
    """Return an object that is read, after a wait if needed.

    Raises:
        HTTPException: where it can't be read, or takes too long.
    """
    record_of(state, object_id)
    obj = state.object(object_id, KEEP_SECONDS)
    wait(lambda: obj.asset is not None or obj.problem is not None)
    if obj.problem is not None:
        raise HTTPException(409, f"the object can't be read: {obj.problem}")
    return obj


def decide(state: AppState, object_id: int, command: Command, person: Person) -> dict[str, Any]:
    """Give a command; returns the object after it.

    The asset is read only where that is needed: before the first decision, as a file's own parts
    and joints come first, and where the labels have to follow.
    """
    record_of(state, object_id)
    live = state.session(object_id)
    if live.state.seq == 0:
        opened(state, object_id)
    after = live.do(command, person.name, role=person.role)
    if needed_jobs(after):
        state.object(object_id, KEEP_SECONDS)
    return document_json(after)


def wait(ready: Callable[[], bool]) -> None:
    """Wait for a job.

    Raises:
        HTTPException: 503, after :data:`OPEN_SECONDS`.
    """
    end = time.monotonic() + OPEN_SECONDS
    while not ready():
        _check_time(end)
        time.sleep(POLL_SECONDS)


async def wait_on_loop(ready: Callable[[], bool]) -> None:
    """As :func:`wait`, without a thread: all requests share forty. The event loop calls ``ready``,
    which must only look."""
    end = time.monotonic() + OPEN_SECONDS
    while not ready():
        _check_time(end)
        await asyncio.sleep(LOOK_SECONDS)


def _check_time(end: float) -> None:
    if time.monotonic() > end:
        raise HTTPException(503, "this takes long; ask again later")


def document_json(state: SessionState) -> dict[str, Any]:
    """Return the present decisions as JSON data."""
    doc, review = state.present, state.present.review
    return {
        "seq": state.seq,
        "can_undo": state.can_undo,
        "can_redo": state.can_redo,
        "prompts": [codec.write(p) for p in doc.prompts],
        "parts": [{"id": p.id, "name": p.name, "link": p.link} for p in doc.parts],
        "segmented": doc.segmentation is not None and doc.segmentation_current,
        "elements": {} if doc.segmentation is None else codec.write(doc.segmentation.counts),
        "joints": joints_json(doc),
        "prediction_stale": doc.prediction_stale,
        "review": codec.write(review),
        "comments": [codec.write(c) for c in doc.comments],
        "saved": doc.saved is not None and review.state == "accepted",
    }


def joints_json(doc: Document) -> list[dict[str, Any]]:
    """Return the joints with the confidence of those that nobody edited."""
    if doc.tree is None:
        return []
    sure = doc.predicted_confidence
    return [{**codec.write(j), "confidence": sure.get(j.child)} for j in doc.tree.joints]


def _line(record: ObjectRecord, assigned: str | None) -> dict[str, Any]:
    # Without path and digest, which would mark second annotations of the same content.
    return {
        "id": record.id, "name": record.name, "state": record.state, "category": record.category,
        "who": record.who, "updated": record.updated, "created": record.created,
        "assigned_to": assigned or record.assigned_to,
        "prompt_count": record.prompts, "part_count": record.parts,
    }  # fmt: skip
