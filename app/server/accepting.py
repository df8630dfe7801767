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
from model.core.errors import CommandError
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.command_log import ACCEPT
from sessions.document import review_problems
from sessions.review import transition
from sessions.state import Context, SessionState, apply
from sessions.store import PendingAcceptance


def accept(
    obj: OpenObject,
    comment: str,
    who: str,
    override: str = "",
    *,
    seen: ValidationReport | None = None,
    refused: Callable[[CommandError], None] | None = None,
    state: SessionState | None = None,
) -> None:
    """Write the asset, read it back, and only then record the decision.

    Args:
        override: reason for accepting it despite errors.
        seen: the report whose warnings the person was shown.
        refused: gets what prevents the acceptance where that is found only later; where it is
            None, all tabs show it.
        state: the state that the person decided about; None is the present one.

    Raises:
        CommandError: where something is missing, there are errors and no reason, or the object
            moved on since ``state``.
        UnseenWarningsError: where there are warnings that the person wasn't shown.
    """
    state = obj.state if state is None else state
    pending = PendingAcceptance(state.seq, comment, override)
    _Acceptance(obj, pending, who, seen, refused, state).begin()


class _Acceptance(AcceptanceRequest):
    """An acceptance from the request to the decision."""

    def __init__(
        self,
        obj: OpenObject,
        pending: PendingAcceptance,
        who: str,
        seen: ValidationReport | None,
        refused: Callable[[CommandError], None] | None,
        state: SessionState,
    ) -> None:
        super().__init__(pending.override, seen, state)
        self._obj, self._pending, self._who, self._refused = obj, pending, who, refused
        self._begun = time.time()

    def begin(self) -> None:
        """Write the asset, or wait for the report; see :func:`accept`."""
        obj, pending = self._obj, self._pending
        if "save" in obj.jobs:
            obj.notify("Accepting", "It is being saved already", "gray")
            return
        self._check()
        validation, acceptances = obj.validation, obj.services.acceptances
        waiting_text = f"{obj.display_name}: when the checks pass"
        waits = validation.report is None and not validation.problem
        if waits and validation.acceptance_waits and not (pending.comment or pending.override):
            obj.notify("Accepting", f"{waiting_text}, as requested before", "gray")
            return
        if waits:  # first, as the report may arrive any moment: the comment outlives this server
            acceptances.begin(obj.record.id, pending)
        try:
            admitted = validation.admits(self)
        except CommandError:
            if waits:
                acceptances.end(obj.record.id)
            raise
        if admitted:
            self._write()
            return
        obj.notify("Accepting", waiting_text, "blue")
        obj.services.queue.changed()
        obj.changed()

    def report_ended(self) -> None:
        """Go on with the report; the person may be at another object by now."""
        obj = self._obj
        try:
            self._check_unmoved()
        except CommandError as error:
            obj.services.acceptances.end(obj.record.id)
            self._refuse(error)
            obj.services.queue.changed()
            return
        try:
            if obj.validation.report is None:  # whoever went on meanwhile doesn't know
                why = obj.validation.problem.rstrip(".")
                raise CommandError(f"The checks failed: {why}. Press Y to accept it unchecked")
            self._check()
            if obj.validation.admits(self):
                self._write()
        except CommandError as error:
            self._hold(str(error))
            self._refuse(error)

    def _check(self) -> None:
        obj, doc = self._obj, self.state.present
        self._check_unmoved()
        # First: an annotator must neither write an asset nor leave a pending acceptance.
        command = cmd.Accept(self._pending.comment)
        role = obj.services.store.people.role_for(obj.record.id, command, self._who)
        transition(doc.review.state, "accept", role)
        if problems := review_problems(doc):
            raise CommandError("; ".join(problems))
        obj.source(doc)  # refuses while the object is still being read

    def _check_unmoved(self) -> None:
        if moved := self._obj.live.moved_since(self.state):
            raise CommandError(moved)

    def _write(self) -> None:
        obj, state, who, override = self._obj, self.state, self._who, self.override
        services, report, doc = obj.services, obj.validation.report, state.present
        assert doc.tree is not None
        source = obj.source(doc)
        command = cmd.Accept(self._pending.comment, obj.validation.known_problems(), override)
        record = acceptance_record(
            apply(state, command, Context(who, "")),
            services.store.history(obj.record.id),
            obj.need_asset().source,
            report,
            override,
            warnings_seen=report is not None and report is self.seen,
            scene=None if obj.in_scene is None else obj.in_scene.source(),
        )
        services.acceptances.begin(obj.record.id, self._pending)
        job = services.drafts.finish(source, doc.tree, obj.jobs.progress("save"))

        def keep(draft: Path) -> None:
            try:
                written = carry_out(obj.live, state, command, who, draft, record)
            except CommandError as error:
                self._refuse(error)
                return
            obj.record_job(ACCEPT, self._begun, time.time() - self._begun)
            obj.notify("Accepted", f"Saved in {written}", "green")

        obj.start("save", job, keep)
        obj.changed()

    def _hold(self, reason: str) -> None:
        """Put it on hold until it is decided or the object changes."""
        obj = self._obj
        reason = display_text(obj.document, reason)
        if obj.in_scene is not None:
            obj.in_scene.hold(reason, obj.validation.report)
        held = replace(self._pending, seq=obj.state.seq, hold_reason=reason)
        obj.services.acceptances.hold(obj.record.id, held)

    def _refuse(self, error: CommandError) -> None:
        if self._refused is None:
            self._obj.notify("Not accepted", str(error), "yellow")
        else:
            self._refused(error)


def acceptance_over(obj: OpenObject) -> bool:
    """True once an acceptance is decided or has failed; its job ends a moment earlier."""
    if obj.being_accepted:
        return False
    return obj.record.id not in obj.services.store.pending_acceptances()


def withdraw(obj: OpenObject) -> bool:
    """Withdraw an acceptance that waits for validation; whether there was one."""
    if not obj.validation.withdraw():
        return False
    obj.services.acceptances.end(obj.record.id)
    obj.notify("Not accepted", "Cancelled before the checks were done", "gray")
    obj.services.queue.changed()
    obj.changed()
    return True
