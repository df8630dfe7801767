"""Accepting one open object: its asset is written, read back, and only then the decision counts.

The asset stays a draft until nothing can prevent the decision any more. One that was accepted
before is set aside while its object is not accepted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from app.server.acceptances import acceptance_record, carry_out
from app.server.jobs import Job
from app.server.names import display_text
from app.server.open_object import OpenObject
from app.server.validating import AcceptanceRequest
from model.core.errors import ArtiworldError, CommandError, NoSpaceError
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.command_log import ACCEPT
from sessions.document import review_problems
from sessions.review import transition
from sessions.state import Context, SessionState, apply
from sessions.store import PendingAcceptance


@dataclass(frozen=True, eq=False)
class Order:
    """A decision about several objects that an acceptance carries out.

    Attributes:
        at: its time, or "".
        looked: whether the person was shown the warnings.
        lock: held while the acceptance is recorded.
        stands: whether it wasn't taken back yet.
    """

    at: str = ""
    looked: bool = False
    lock: AbstractContextManager[Any] = field(default_factory=nullcontext)
    stands: Callable[[], bool] = lambda: True


ALONE = Order()
"""Order of an acceptance that a person asks for at the object."""


def accept(
    obj: OpenObject,
    comment: str,
    who: str,
    override: str = "",
    *,
    seen: ValidationReport | None = None,
    refused: Callable[[ArtiworldError], None] | None = None,
    state: SessionState | None = None,
    order: Order = ALONE,
) -> None:
    """Write the asset, read it back, and only then record the decision.

    Args:
        override: reason for accepting it despite errors.
        seen: the report whose warnings the person was shown.
        refused: gets what prevents the acceptance, or writing its asset, where that is found only
            later; where it is None, all tabs show it.
        state: the state that the person decided about; None is the present one.
        order: the decision that it is part of.

    Raises:
        CommandError: where something is missing, there are errors and no reason, or the object
            moved on since ``state``.
        UnseenWarningsError: where there are warnings that the person wasn't shown.
    """
    state = obj.state if state is None else state
    pending = PendingAcceptance(state.seq, comment, override)
    _Acceptance(obj, pending, who, seen, refused, state, order).begin()


class _Acceptance(AcceptanceRequest):
    """An acceptance from the request to the decision."""

    def __init__(
        self,
        obj: OpenObject,
        pending: PendingAcceptance,
        who: str,
        seen: ValidationReport | None,
        refused: Callable[[ArtiworldError], None] | None,
        state: SessionState,
        order: Order,
    ) -> None:
        super().__init__(pending.override, seen, state, looked=order.looked)
        self._obj, self._pending, self._who, self._refused = obj, pending, who, refused
        self._order, self._begun = order, time.time()

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
        validation.update()  # of an object that nobody opened
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
            hold(self._obj, str(error), self._pending)
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
        source, read = obj.source(doc), obj.read_source(doc)
        assert read is not None
        command = cmd.Accept(
            self._pending.comment, obj.validation.known_problems(), override, self._order.at
        )
        record = acceptance_record(
            apply(state, command, Context(who, "")),
            services.store.history(obj.record.id),
            read[1],
            report,
            override,
            warnings_seen=self.has_seen(report),
            scene=obj.scene_source,
        )
        services.acceptances.begin(obj.record.id, self._pending)
        job = services.drafts.finish(source, doc.tree, obj.jobs.progress("save"))

        def keep(draft: Path) -> None:
            with self._order.lock:
                if not self._order.stands():
                    return
                try:
                    written = carry_out(obj.live, state, command, who, draft, record)
                except (CommandError, NoSpaceError) as error:
                    self._refuse(error)
                    return
            obj.jobs.record(ACCEPT, self._begun, time.time() - self._begun)
            obj.notify("Accepted", f"Saved in {written}", "green")

        def pass_on(job: Job[Path]) -> None:
            if self._refused is not None and isinstance(job.error, ArtiworldError):
                self._refused(job.error)

        job.add_done_callback(pass_on)  # before the job's end counts
        obj.start("save", job, keep)
        obj.changed()

    def _refuse(self, error: ArtiworldError) -> None:
        if self._refused is None:
            self._obj.notify("Not accepted", str(error), "yellow")
        else:
            self._refused(error)


def hold(obj: OpenObject, reason: str, pending: PendingAcceptance | None = None) -> None:
    """Put an acceptance on hold until the object is decided or changes."""
    held = PendingAcceptance(0) if pending is None else pending
    held = replace(held, seq=obj.state.seq, hold_reason=display_text(obj.document, reason))
    obj.services.acceptances.hold(obj.record.id, held)


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
