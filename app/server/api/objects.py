"""Objects: upload, list, filter, what is decided about one; who is given which and who is there;
and the accepted ones as files.
"""

from __future__ import annotations

import asyncio
import functools
import os
import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel, Field

from app.server.api import guard
from app.server.api.guard import Annotator, Count, Id, Json, LongRouter, Manager, Reader, State
from app.server.app_state import AppState
from app.server.export_tasks import ExportTask, export_one, zipped
from app.server.network import NO_ROOM, discard
from app.server.open_object import OpenObject
from model.core import codec
from model.core.files import unnamed_file
from model.core.progress import each
from model.io.export.registry import exporter_names
from model.physics.simulation_values import PhysicsSettings
from sessions.accounts import Account
from sessions.commands import Command
from sessions.credentials import Person
from sessions.database import ObjectRecord
from sessions.document import Document
from sessions.state import SessionState

objects_router = APIRouter(tags=["objects"])
MOST = 500
"""Objects in one answer."""
OPEN_SECONDS = 600.0
"""Longest wait for an object to be read, or for labels that are being computed."""
POLL_SECONDS = 0.02
"""Pause between two looks of a waiting thread."""
KEEP_SECONDS = 300.0
"""An object that a script worked on stays open so long after: it would be encoded anew else."""


@objects_router.get("/objects")
def list_objects(
    person: Reader,
    state: State,
    review_state: Annotated[str | None, Query(alias="state")] = None,
    category: str | None = None,
    search: str = "",
    assigned_to: str | None = None,
    first: Count = 0,
    count: Annotated[int, Query(ge=1, le=MOST)] = 100,
) -> Json:
    """List objects in the order of the queue, filtered."""
    assigned = state.store.people.work.assigned()
    words = search.lower().split()
    found = [
        r
        for r in state.queue.records()
        if review_state in (None, r.state)
        and category in (None, r.category)
        and assigned_to in (None, assigned.get(r.id))
        and all(w in f"{r.name} {r.category or ''}".lower() for w in words)
    ]
    shown = found[first : first + count]
    return {"total": len(found), "objects": [_line(r, assigned.get(r.id)) for r in shown]}


@objects_router.post("/objects", status_code=201)
async def upload(request: Request, name: str, person: Annotator, state: State) -> Any:
    """Add a file, or a zip of one object or several; the body is its content."""
    size = int(request.headers.get("Content-Length", state.config.max_upload_mb * 1_000_000))
    try:
        content = unnamed_file(state.workspace)
        if not state.room.take(content, size, person.name):
            raise HTTPException(429, NO_ROOM)
        async for block in request.stream():
            await asyncio.to_thread(content.write, block)
        content.seek(0)
    except (HTTPException, OSError):
        await discard(request.receive, request.headers)
        raise

    def add() -> Json:
        return _line(state.store.object(state.add_upload(name, content)), None)

    return await guard.in_time(person, add)


@objects_router.get("/jobs/{number}")
async def job(number: str, person: guard.Visitor) -> Any:
    """The result of a request that was answered with a job, once; 202 while it is worked on."""
    return await guard.result_of(person, number)


@objects_router.get("/objects/{object_id}")
def one_object(object_id: Id, person: Reader, state: State) -> Json:
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


def opened(state: AppState, object_id: int, person: Person) -> OpenObject:
    """Return an object that is read, after a wait if needed.

    Raises:
        HTTPException: where it can't be read, or takes too long.
    """
    record_of(state, object_id)
    obj = state.object(object_id, KEEP_SECONDS, person.name)
    wait(lambda: obj.asset is not None or obj.problem is not None)
    if obj.problem is not None:
        raise HTTPException(409, f"the object can't be read: {obj.problem}")
    return obj


def decide(state: AppState, object_id: int, command: Command, person: Person) -> Json:
    """Give a command; returns the object after it.

    The asset is read only where that is needed: before the first decision, as a file's own parts
    and joints come first, and where the labels have to follow.
    """
    record_of(state, object_id)
    live = state.session(object_id)
    if live.state.seq == 0:
        opened(state, object_id, person)
    after = live.do(command, person.name, role=person.role)
    if after.present.needs_labels:
        state.object(object_id, KEEP_SECONDS, person.name)
    return document_json(after)


def wait(ready: Callable[[], bool]) -> None:
    """Wait for a job.

    Raises:
        HTTPException: 503, after :data:`OPEN_SECONDS`.
    """
    end = time.monotonic() + OPEN_SECONDS
    while not ready():
        if time.monotonic() > end:
            raise HTTPException(503, "this takes long; ask again later")
        time.sleep(POLL_SECONDS)


def document_json(state: SessionState) -> Json:
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


def joints_json(doc: Document) -> list[Json]:
    """Return the joints with the confidence of those that nobody edited."""
    if doc.tree is None:
        return []
    sure = doc.predicted_confidence
    return [{**codec.write(j), "confidence": sure.get(j.child)} for j in doc.tree.joints]


def _line(record: ObjectRecord, assigned: str | None) -> Json:
    # Without path and digest, which would mark second annotations of the same content.
    plain = ("id", "name", "state", "category", "who", "updated", "created")
    return {field: getattr(record, field) for field in plain} | {
        "assigned_to": assigned or record.assigned_to,
        "prompt_count": record.prompts,
        "part_count": record.parts,
    }


work_router = APIRouter(tags=["work"])


class AssignBody(BaseModel):
    """Objects, and the people who get them in turn; no people: nobody has them any more."""

    objects: list[Id] = Field(min_length=1, max_length=10_000)
    people: list[str] = Field(max_length=1000)


@work_router.post("/assignments")
def assign(body: AssignBody, person: Manager, state: State) -> Json:
    """Assign objects to one person, or to several in turn."""
    people = state.store.people
    accounts = [people.accounts.find(name) for name in body.people]
    given = people.work.assign(body.objects, accounts, person.name)
    state.queue.changed()
    return {"assigned": {str(i): name for i, name in given.items()}}


@work_router.post("/next")
def next_object(person: Annotator, state: State) -> Json:
    """Lease the next object: first what came back, then what is assigned, then anything free."""
    found = state.store.people.work.next(_account(person), state.queue.records())
    return {"id": found}


@work_router.get("/objects/{object_id}/presence")
def presence(object_id: Id, person: Reader, state: State) -> list[Json]:
    """Users who have an object open, and who leased it."""
    record_of(state, object_id)
    return [asdict(one) for one in state.store.people.work.present(object_id)]


@work_router.post("/objects/{object_id}/enter")
def enter(object_id: Id, person: Annotator, state: State) -> Json:
    """Say that one works on an object; again within a minute."""
    record_of(state, object_id)
    state.store.people.work.enter(object_id, _account(person))
    return {"here": True}


@work_router.post("/objects/{object_id}/leave")
def leave(object_id: Id, person: Annotator, state: State) -> Json:
    """Leave an object; others may take it."""
    record_of(state, object_id)
    state.store.people.work.leave(object_id, _account(person))
    return {"here": False}


def _account(person: Person) -> Account:
    if person.account is None:
        raise HTTPException(409, "there are no accounts here, so nothing is leased to anybody")
    return person.account


assets_router = LongRouter(tags=["assets"])


@assets_router.get("/assets")
def list_assets(person: Reader, state: State) -> Json:
    """All accepted objects that have an asset, and the formats in which it can be had."""
    found = []

    def find(record: ObjectRecord) -> None:
        saved = state.session(record.id).document.saved
        if saved is not None and state.store.assets.has(saved):
            line = {f: getattr(record, f) for f in ("id", "name", "category")}
            found.append(line | {"accepted_by": saved.by, "at": saved.at})

    each([r for r in state.queue.records() if r.state == "accepted"], find, lambda *_: None)
    return {"formats": ["asset", *exporter_names()], "assets": found}


@assets_router.get("/assets/{object_id}")
def download(object_id: Id, person: Reader, state: State, format: str = "asset") -> Response:
    """Download an asset as a zip: "asset" as it was accepted, or in a simulator's format."""
    name = record_of(state, object_id).name
    if format not in ("asset", *exporter_names()):
        raise HTTPException(422, f"format: one of asset, {', '.join(exporter_names())}")
    folder = state.store.assets.folder(state.session(object_id).document.saved)
    if folder is None:
        raise HTTPException(404, "the object has no asset: it wasn't accepted yet")
    if format == "asset":
        return _zipped(folder, name, person, state)
    out = state.workspace / "exports" / f".{secrets.token_hex(8)}"
    task = ExportTask(
        folder, ((format, out),), PhysicsSettings(), state.workspace / "collision", check=False
    )
    try:
        saving = state.workers.saving
        saving.submit(export_one, task, priority=-1, most_seconds=OPEN_SECONDS).result()
        return _zipped(out, f"{name}_{format}", person, state)
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _zipped(folder: Path, name: str, person: Person, state: AppState) -> Response:
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in name)[:80] or "asset"
    file = zipped(folder, plain)
    size = os.fstat(file.fileno()).st_size
    if not state.room.take(file, size, person.name):
        raise HTTPException(429, NO_ROOM)
    quoted = plain.encode("ascii", "replace").decode().replace("?", "_")
    headers = {"Content-Disposition": f'attachment; filename="{quoted}.zip"'}
    headers["Content-Length"] = f"{size}"
    blocks = iter(functools.partial(file.read, 1 << 16), b"")
    return StreamingResponse(blocks, media_type="application/zip", headers=headers)
