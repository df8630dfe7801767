"""Accepting one open object: its asset is written, read back, and only then the decision counts.

The asset is a draft until nothing can speak against the decision any more; then it takes the place
of the one that was accepted before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from app.server.acceptance_record import acceptance_record, asset_folder
from app.server.display_names import in_words
from app.server.open_object import OpenObject
from app.server.part_tasks import PartSource
from app.server.validating import Wish
from model.core.asset import Source
from model.core.errors import CommandError
from model.io.assets.asset_folder import publish
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.document import Document
from sessions.state import Context, apply, review_problems
from sessions.store import PendingAcceptance


def accept(
    obj: OpenObject,
    comment: str,
    who: str,
    at: str,
    override: str = "",
    *,
    looked_at: ValidationReport | None = None,
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
    acceptances = obj.services.acceptances

    begun = PendingAcceptance(state.seq, comment, override)

    def again() -> None:
        try:
            _check_unchanged(obj, doc, source)
        except CommandError as error:
            acceptances.end(obj.record.id)
            _refuse(obj, error, refused)
            obj.services.queue.notify()
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
        after, obj.services.store.history(obj.record.id), _source_record(obj), gate, override,
        looked_at=gate is not None and gate is looked_at,
        scene=None if obj.in_scene is None else obj.in_scene.source(),
    )  # fmt: skip
    folder = asset_folder(obj.services.workspace, obj.record)
    acceptances.begin(obj.record.id, begun)
    job = obj.services.drafts.finish(source, doc.tree, obj.jobs.progress("save"))

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
    obj.services.acceptances.end(obj.record.id)
    obj.tell("Not accepted", "Taken back before the joints were judged", "gray")
    obj.services.queue.notify()
    obj.changed()
    return True


def _admits(obj: OpenObject, wish: Wish, begun: PendingAcceptance) -> bool:
    """Whether it may be accepted now; False where the wish waits for the gate.

    Raises:
        CommandError: where it may not.
    """
    judging, acceptances = obj.judging, obj.services.acceptances
    waits = judging.report is None and not judging.problem
    if waits and judging.waiting and not (begun.comment or begun.override):
        asked = f"{obj.display_name}: as soon as the joints are judged"
        obj.tell("Accepting", f"{asked}, as was asked before", "gray")
        return False
    if waits:  # first, as the gate may answer any moment: what was typed outlives this server
        acceptances.begin(obj.record.id, begun)
    try:
        admitted = judging.admits(wish)
    except CommandError:
        if waits:
            acceptances.end(obj.record.id)
        raise
    if not admitted:
        obj.tell("Accepting", f"{obj.display_name}: as soon as the joints are judged", "blue")
        obj.services.queue.notify()
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


def _hold(obj: OpenObject, begun: PendingAcceptance, why: str) -> None:
    """Keep that the gate held it back, and what was typed for it, until it is decided or changed;
    whoever asked may have gone on."""
    why = in_words(obj.document, why)
    if obj.in_scene is not None:
        obj.in_scene.hold(why, obj.judging.report)
    obj.services.acceptances.hold(obj.record.id, replace(begun, seq=obj.state.seq, held=why))


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


def _source_record(obj: OpenObject) -> Source:
    asset = obj.asset
    assert asset is not None
    return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale)
