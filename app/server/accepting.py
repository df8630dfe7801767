"""Accepting one open object: its asset is written, read back, and only then the decision counts.

The asset is a draft until nothing can speak against the decision any more; then it takes the place
of the one that was accepted before.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.server.display_names import in_words
from app.server.validating import Wish
from model.core.asset import Source
from model.core.errors import CommandError
from model.io.assets.asset_folder import publish
from model.io.assets.reader import recover
from model.validation.report import GateReport
from sessions import commands as cmd
from sessions.document import Document
from sessions.provenance import provenance
from sessions.state import Context, SessionState, apply, review_problems
from sessions.store import Begun, Entry, ObjectRecord

if TYPE_CHECKING:
    from app.server.app_state import Workbench
    from app.server.open_object import OpenObject
    from app.server.part_tasks import PartSource

log = logging.getLogger(__name__)


def accept(
    obj: OpenObject,
    comment: str,
    who: str,
    at: str,
    override: str = "",
    *,
    looked_at: GateReport | None = None,
    refused: Callable[[CommandError], None] | None = None,
) -> None:
    """Write the asset, read it back, and only then record the decision.

    Args:
        override: why it is right although the gate calls a joint broken.
        looked_at: the gate's answer whose doubts the person was shown.
        refused: gets what keeps it from being accepted where that comes out only later; all tabs
            are told where it is None.

    Raises:
        CommandError: where something is missing, or the gate needs a reason.
        LookFirstError: where the gate doubts something that the person wasn't shown.
    """
    if "save" in obj.jobs:
        obj.tell("Accepting", "It is being saved already", "gray")
        return
    state = obj.state
    doc = state.present
    problems = review_problems(doc)
    if problems:
        raise CommandError("; ".join(problems))
    assert doc.tree is not None
    source = obj.source(doc)
    store = obj.bench.store

    begun = Begun(state.seq, comment, override)

    def again() -> None:
        try:
            _check_unchanged(obj, doc, source)
        except CommandError as error:
            store.accepting_ends(obj.record.id)
            _refuse(obj, error, refused)
            obj.bench.tell_queue()
            return
        try:
            _check_judged(obj)
            accept(obj, comment, who, at, override, looked_at=looked_at, refused=refused)
        except CommandError as error:
            _hold(obj, begun, str(error))
            _refuse(obj, error, refused)

    if not _admits(obj, Wish(override, looked_at, again), begun):
        return
    gate = obj.judging.report
    command = cmd.Accept(comment, obj.judging.doubts(), override)
    after = apply(state, command, Context(who, at))
    record = acceptance_record(
        after, store.history(obj.record.id), _source_record(obj), gate, override,
        looked_at=gate is not None and gate is looked_at, scene=_in_scene(obj),
    )  # fmt: skip
    folder = asset_folder(obj.bench.workspace, obj.record)
    store.accepting_begins(obj.record.id, begun)
    job = obj.bench.draft_asset(source, doc.tree, obj.jobs.progress("save"))

    def keep(draft: Path) -> None:
        try:
            _check_unchanged(obj, doc, source)
        except CommandError as error:
            _refuse(obj, error, refused)
            return
        # Only now: an asset that was accepted before stays until this one is to take its place.
        written = str(publish(draft, folder, record).folder)
        obj.do(command, who)
        obj.do(cmd.Saved(written), who)
        obj.tell("Accepted", f"Saved in {written}", "green")

    obj.start("save", job, keep)
    obj.changed()


def take_back(obj: OpenObject) -> bool:
    """Take back the wish to accept it as soon as its joints are judged; all tabs are told.

    Returns:
        Whether there was one that nothing had come of yet.
    """
    if not obj.judging.take_back():
        return False
    obj.bench.store.accepting_ends(obj.record.id)
    obj.tell("Not accepted", "Taken back before the joints were judged", "gray")
    obj.bench.tell_queue()
    obj.changed()
    return True


def _admits(obj: OpenObject, wish: Wish, begun: Begun) -> bool:
    """Whether it may be accepted now; False where the wish waits for the gate.

    Raises:
        CommandError: where it may not.
    """
    judging, store = obj.judging, obj.bench.store
    waits = judging.report is None and not judging.problem
    if waits and judging.waiting and not (begun.comment or begun.override):
        asked = f"{obj.bench.called(obj.record)}: as soon as the joints are judged"
        obj.tell("Accepting", f"{asked}, as was asked before", "gray")
        return False
    if waits:  # first, as the gate may answer any moment: what was typed outlives this server
        store.accepting_begins(obj.record.id, begun)
    try:
        admitted = judging.admits(wish)
    except CommandError:
        if waits:
            store.accepting_ends(obj.record.id)
        raise
    if not admitted:
        obj.bench.tell_queue()
        obj.changed()
    return admitted


def _check_judged(obj: OpenObject) -> None:
    """Refuse where there is no verdict: whoever went on meanwhile doesn't know.

    Raises:
        CommandError: saying why there is none.
    """
    if obj.judging.report is None:
        why = obj.judging.problem.rstrip(".")
        raise CommandError(f"The joints couldn't be judged: {why}. Y accepts it unjudged")


def _hold(obj: OpenObject, begun: Begun, why: str) -> None:
    """Keep that the gate held it back, and what was typed for it, until it is decided or changed;
    whoever asked may have gone on."""
    why = in_words(obj.document, why)
    if obj.bench.desk is not None:
        obj.bench.desk.accepting.hold(obj.record.id, why, obj.judging.report)
    obj.bench.hold(obj.record.id, replace(begun, seq=obj.state.seq, held=why))


def take_up(bench: Workbench) -> dict[int, Begun]:
    """See to the acceptances that a server which died has begun.

    One that was decided is finished. The others wait for a person: what the gate says of them, and
    what it showed, is gone. So does what the gate held back.

    Returns:
        Objects that wait → what was begun; they do so until their next command.
    """
    waiting: dict[int, Begun] = {}
    for object_id, begun in bench.store.accepting().items():
        record = bench.store.object(object_id)
        folder = asset_folder(bench.workspace, record)
        recover(folder)
        if record.seq == begun.seq:
            waiting[object_id] = begun
            if begun.held:
                continue
            log.warning(
                "%s: its acceptance was begun and not finished; accept it again, unless another "
                "server is at it", record.name,
            )  # fmt: skip
            continue
        live = bench.hub.session(object_id)
        doc = live.document
        if doc.review.state == "accepted" and doc.saved is None and folder.is_dir():
            live.do(cmd.Saved(str(folder)), doc.review.by)
        bench.store.accepting_ends(object_id)
    return waiting


def _check_unchanged(obj: OpenObject, before: Document, source: PartSource) -> None:
    """Refuse where the object isn't any more what was to be accepted.

    Raises:
        CommandError: saying what happened meanwhile.
    """
    now = obj.live.refresh().present  # another server may be at work on it
    if now.segmentation is None or (now.tree, obj.source(now)) != (before.tree, source):
        raise CommandError("It was edited meanwhile: accept it again")
    if now.review != before.review:
        raise CommandError(f"It was {now.review.state} meanwhile by {now.review.by}")


def _refuse(
    obj: OpenObject, error: CommandError, refused: Callable[[CommandError], None] | None
) -> None:
    if refused is None:
        obj.tell("Not accepted", str(error), "yellow")
    else:
        refused(error)


def _in_scene(obj: OpenObject) -> dict[str, Any] | None:
    desk = obj.bench.desk
    work = None if desk is None else desk.works.get(obj.record.id)
    return None if desk is None or work is None else work.source(desk.path, obj.bench.workspace)


def _source_record(obj: OpenObject) -> Source:
    asset = obj.asset
    assert asset is not None
    return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale)


def acceptance_record(
    after: SessionState,
    history: list[Entry],
    source: Source,
    gate: GateReport | None,
    override: str = "",
    *,
    looked_at: bool = False,
    scene: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What ``provenance.json`` of an accepted asset holds, the gate's answer included.

    Args:
        override: why it was accepted although the gate calls a joint broken, else "".
        looked_at: whether the person had been shown what the gate doubts.
        scene: of what was worked on in a scene, what its source is there.
    """
    record = provenance(after, history, source)
    record["source"].update(scene or {})
    said = {"override": override, "looked_at": looked_at}
    record["gate"] = None if gate is None else {**gate.to_json(), **said}
    return record


def asset_folder(workspace: Path, record: ObjectRecord) -> Path:
    """Where the accepted asset of an object goes."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", record.name).strip("._") or "object"
    return workspace / "assets" / f"{plain[:60]}-{record.id}"
