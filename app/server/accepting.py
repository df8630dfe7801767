"""Accepting one open object: its asset is written, read back, and only then the decision counts.

The asset stays a draft until nothing can prevent the decision any more. One that was accepted
before is set aside while its object is not accepted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from app.server.acceptances import acceptance_record, carry_out
from app.server.names import display_text
from app.server.open_object import OpenObject
from app.server.validating import AcceptanceRequest
from model.core.asset import Source
from model.core.errors import ArtiworldError, CommandError, NoSpaceError
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.command_log import ACCEPT
from sessions.review import Role, transition
from sessions.state import Context, SessionState, apply, review_problems
from sessions.store import PendingAcceptance


def accept(
    obj: OpenObject,
    comment: str,
    who: str,
    override: str = "",
    *,
    seen: ValidationReport | None = None,
    refused: Callable[[ArtiworldError], None] | None = None,
    asked: float | None = None,
    state: SessionState | None = None,
) -> None:
    """Write the asset, read it back, and only then record the decision.

    Args:
        override: reason for accepting it despite errors.
        seen: the report whose warnings the person was shown.
        refused: gets what prevents the acceptance, or writing its asset, where that is found only
            later; where it is None, all tabs show it.
        asked: when the person asked for it, seconds since 1970; None is now.
        state: the state that the person decided about; None is the present one.

    Raises:
        CommandError: where something is missing, there are errors and no reason, or the object
            moved on since ``state``.
        UnseenWarningsError: where there are warnings that the person wasn't shown.
    """
    if "save" in obj.jobs:
        obj.notify("Accepting", "It is being saved already", "gray")
        return
    begun = time.time() if asked is None else asked
    state = obj.state if state is None else state
    _check_unmoved(obj, state)
    doc = state.present
    # First: an annotator must neither write an asset nor leave a pending acceptance.
    transition(doc.review.state, "accept", _role(obj, cmd.Accept(comment), who))
    problems = review_problems(doc)
    if problems:
        raise CommandError("; ".join(problems))
    assert doc.tree is not None
    source = obj.source(doc)
    services = obj.services
    pending = PendingAcceptance(state.seq, comment, override)

    def retry() -> None:
        try:
            _check_unmoved(obj, state)
        except CommandError as error:
            services.acceptances.end(obj.record.id)
            _refuse(obj, error, refused)
            services.queue.changed()
            return
        try:
            _check_validated(obj)
            accept(
                obj, comment, who, override, seen=seen, refused=refused, asked=begun, state=state
            )
        except CommandError as error:
            _hold(obj, pending, str(error))
            _refuse(obj, error, refused)

    if not _admits(obj, AcceptanceRequest(override, seen, retry, state), pending):
        return
    report = obj.validation.report
    command = cmd.Accept(comment, obj.validation.known_problems(), override)
    record = acceptance_record(
        apply(state, command, Context(who, "")),
        services.store.history(obj.record.id),
        _source_record(obj),
        report,
        override,
        warnings_seen=report is not None and report is seen,
        scene=None if obj.in_scene is None else obj.in_scene.source(),
    )
    services.acceptances.begin(obj.record.id, pending)
    job = services.drafts.finish(source, doc.tree, obj.jobs.progress("save"))

    def keep(draft: Path) -> None:
        try:
            written = carry_out(obj.live, state, command, who, draft, record)
        except (CommandError, NoSpaceError) as error:
            _refuse(obj, error, refused)
            return
        obj.record_job(ACCEPT, begun, time.time() - begun)
        obj.notify("Accepted", f"Saved in {written}", "green")

    if refused is not None:  # before the job's end counts
        job.add_done_callback(lambda job: _pass_on(job.error, refused))
    obj.start("save", job, keep)
    obj.changed()


def _pass_on(error: Exception | None, refused: Callable[[ArtiworldError], None]) -> None:
    if isinstance(error, ArtiworldError):
        refused(error)


def _role(obj: OpenObject, command: cmd.Accept, who: str) -> Role:
    return obj.services.store.people.role_for(obj.record.id, command, who)


def acceptance_over(obj: OpenObject) -> bool:
    """True once an acceptance is decided or has failed; its job ends a moment earlier."""
    if obj.being_accepted:
        return False
    return obj.services.acceptances.is_over(obj.record.id)


def withdraw(obj: OpenObject) -> bool:
    """Withdraw an acceptance that waits for validation; whether there was one."""
    if not obj.validation.withdraw():
        return False
    obj.services.acceptances.end(obj.record.id)
    obj.notify("Not accepted", "Cancelled before the checks were done", "gray")
    obj.services.queue.changed()
    obj.changed()
    return True


def _admits(obj: OpenObject, request: AcceptanceRequest, pending: PendingAcceptance) -> bool:
    """True if it may be accepted now, False if the request waits for validation.

    Raises:
        CommandError: where it may not.
    """
    validation, acceptances = obj.validation, obj.services.acceptances
    waiting_text = f"{obj.display_name}: when the checks pass"
    waits = validation.report is None and not validation.problem
    if waits and validation.acceptance_waits and not (pending.comment or pending.override):
        obj.notify("Accepting", f"{waiting_text}, as requested before", "gray")
        return False
    if waits:  # first, as the report may arrive any moment: the comment outlives this server
        acceptances.begin(obj.record.id, pending)
    try:
        admitted = validation.admits(request)
    except CommandError:
        if waits:
            acceptances.end(obj.record.id)
        raise
    if not admitted:
        obj.notify("Accepting", waiting_text, "blue")
        obj.services.queue.changed()
        obj.changed()
    return admitted


def _check_validated(obj: OpenObject) -> None:
    """Refuse where there is no report: the person who went on meanwhile doesn't know.

    Raises:
        CommandError: with the reason why there is none.
    """
    if obj.validation.report is None:
        why = obj.validation.problem.rstrip(".")
        raise CommandError(f"The checks failed: {why}. Press Y to accept it unchecked")


def _hold(obj: OpenObject, pending: PendingAcceptance, reason: str) -> None:
    """Put the acceptance on hold until it is decided or the object changes."""
    reason = display_text(obj.document, reason)
    if obj.in_scene is not None:
        obj.in_scene.hold(reason, obj.validation.report)
    obj.services.acceptances.hold(
        obj.record.id, replace(pending, seq=obj.state.seq, hold_reason=reason)
    )


def _check_unmoved(obj: OpenObject, state: SessionState) -> None:
    if moved := obj.live.moved_since(state):
        raise CommandError(moved)


def _refuse(
    obj: OpenObject, error: ArtiworldError, refused: Callable[[ArtiworldError], None] | None
) -> None:
    if refused is None:
        obj.notify("Not accepted", str(error), "yellow")
    else:
        refused(error)


def _source_record(obj: OpenObject) -> Source:
    asset = obj.need_asset()
    return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale, asset.shift)
