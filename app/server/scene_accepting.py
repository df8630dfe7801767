"""Decisions about objects of a scene, carried out one after the other in the background.

The scene's session records the decisions; here they are carried out in the objects' own sessions,
as for any open object. One with errors is put on hold: it waits for a person who fixes it or gives
a reason. So is one with warnings, unless the person was shown them. The decisions of a server that
died are carried out when the scene is opened again, undone ones are reverted.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

from app.server.accepting import Order, accept, acceptance_over, hold, withdraw
from app.server.names import display_text, joint_title
from app.server.observable import Notice
from app.server.scene_state import HELD, SceneState, Work
from model.core.errors import ArtiworldError, CommandError
from model.validation.report import Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import DecisionRecord
from sessions.scene_commands import Decided, DecideObjects
from sessions.state import SessionState
from sessions.store import clean_who

Mark = Literal["", "validating", "on_hold"]
Entry = tuple[int, DecisionRecord]
"""Session id of an object, and the decision about it."""


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why an object wasn't accepted.

    Attributes:
        why: in a sentence, with the joint that it is about.
        report: the validation report; None where something else was the reason.
    """

    why: str
    report: ValidationReport | None = None

    @property
    def only_warnings(self) -> bool:
        """True if a person may accept it after seeing its warnings."""
        return self.report is not None and self.report.severity == Severity.WARNING


@dataclass(eq=False)
class _Outcome:
    """Results of one decision about several objects, for the person who made it.

    Attributes:
        left: sessions that are still to be accepted.
        accepted: number of objects accepted. refused: sessions that weren't, and why.
    """

    record: DecisionRecord
    notice: Notice
    left: set[int]
    accepted: int = 0
    refused: dict[int, Refusal] = field(default_factory=dict)


class Accepting:
    """The decisions about a scene's objects that are being carried out."""

    def __init__(self, scene: SceneState) -> None:
        self._scene = scene
        self._queue: dict[Entry, SessionState] = {}  # and the object's state at the decision
        self._known: tuple[DecisionRecord, ...] = scene.document.decided
        self._total = 0
        self._done = 0
        self._running: Entry | None = None
        self._outcomes: list[_Outcome] = []
        self._expected: dict[tuple[str, Decided, tuple[int, ...]], Notice] = {}
        self._elsewhere: set[DecisionRecord] = set()  # carried out by other servers

    @staticmethod
    def refusal(work: Work) -> Refusal | None:
        """Return why the present object wasn't accepted, or None."""
        why, doc = work.hold_reason, work.document
        if not why or doc.review.state in ("accepted", "rejected"):
            return None
        report = work.validation.report
        if report is not None and report.severity != Severity.OK:
            worst = report.joints[0]
            if display_text(doc, worst.message) in why:
                return Refusal(f"{joint_title(doc, worst.child)}: {worst.message}", report)
        return Refusal(why)

    def why_refused(self, work: Work) -> str:
        """Like :meth:`refusal`, in a sentence, or ""."""
        refusal = self.refusal(work)
        return "" if refusal is None else refusal.why

    def mark(self, work: Work) -> Mark:
        """Return whether the object is being validated, or on hold."""
        if work.id in self.waiting or work.being_accepted:
            return "validating"
        return "" if self.refusal(work) is None else "on_hold"

    @property
    def waiting(self) -> frozenset[int]:
        """Session ids of objects that are being accepted."""
        return frozenset(i for i, _ in self._queue)

    @property
    def busy(self) -> dict[str, tuple[float, str]]:
        """Progress (0..1) and message of the acceptance under way; empty without one."""
        if self._running not in self._queue or self._running is None:
            return {}
        work = self._scene.works[self._running[0]]
        step = "saving" if "save" in work.jobs else "checking"
        return {"accept": (self._done / max(1, self._total), f"{step} {work.display_name}")}

    def expect(self, command: DecideObjects, who: str, notice: Notice) -> None:
        """Report the outcome of a decision that follows to ``notice``."""
        self._expected[clean_who(who), command.decision, command.objects] = notice

    # --- decisions

    def had_no_effect(self, record: DecisionRecord) -> bool:
        """True if it was an acceptance and accepted none of its objects."""
        here = record.decision == "accept" and record not in self._elsewhere
        return here and not any(self._carried_out(i, record) for i in record.objects)

    def _carried_out(self, i: int, record: DecisionRecord) -> bool:
        """True if the decision, maybe of an earlier server, has accepted an object, or will."""
        if (i, record) in self._queue:
            return True
        entries = self._scene.services.store.history(i)
        return any(
            isinstance(e.command, cmd.Accept) and e.command.decided_at == record.at for e in entries
        )

    def describe(self, record: DecisionRecord) -> str:
        """Describe a decision in a few words."""
        work = self._scene.works.get(record.objects[0])
        if len(record.objects) > 1 or work is None:
            return f"{record.decision} {len(record.objects)} objects"
        return f"{record.decision} {work.item.obj.id}"

    def resume(self) -> None:
        """Carry out the decisions that an earlier server left."""
        store = self._scene.services.store
        before, self._known = self._known, self._scene.document.decided
        for record in before:
            left = [i for i in record.objects if i in self._scene.works]
            left = [i for i in left if store.object(i).updated < record.at]
            for i in left:
                self._scene.works[i].live.settle()  # its server may have ended while writing
            self._carry_out(record, left)

    def update(self, decided: tuple[DecisionRecord, ...], *, here: bool = True) -> None:
        """Carry out new decisions, revert those that were undone.

        Args:
            decided: all present decisions.
            here: whether they were made in this server; otherwise another one carries them out.
        """
        before, self._known = self._known, decided
        for record in before:
            if record not in self._known:
                self._queue = {e: s for e, s in self._queue.items() if e[1] != record}
                if record not in self._scene.document.decided:
                    self._revert(record)
                for outcome in [o for o in self._outcomes_of(record) if o.left]:
                    outcome.notice("Not accepted", f"undone: {self.describe(record)}", "yellow")
                    self._outcomes.remove(outcome)
                for i in record.objects:
                    self._forget_hold(i)
        for record in self._known:
            if record not in before:
                if here:
                    self._carry_out(record, list(record.objects))
                else:
                    self._elsewhere.add(record)
        self._total = self._done + len(self._queue)

    def _carry_out(self, record: DecisionRecord, objects: list[int]) -> None:
        key = record.by, record.decision, record.objects
        notice = self._expected.pop(key, self._scene.notify)
        if record.decision == "accept":
            objects = [i for i in objects if i in self._scene.works]
            if not self._queue:
                self._total = self._done = 0
            self._outcomes.append(_Outcome(record, notice, set(objects)))
            for i in objects:
                self._forget_hold(i)
                for outcome in [o for o in self._outcomes if o.record.by == record.by]:
                    outcome.refused.pop(i, None)
                self._queue[i, record] = self._scene.works[i].live.state
                self._total += 1
            return
        for i in objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            instances = len(self._scene.twins(work.item.obj.id))
            if instances > 1:
                notice("Rejected", f"{_objects(instances)}: instances share a decision", "gray")
            if work.document.review.state != "rejected":
                work.live.do(cmd.Reject(record.reason, decided_at=record.at), record.by)

    def _revert(self, record: DecisionRecord) -> None:
        state = {"accept": "accepted", "reject": "rejected"}[record.decision]
        for i in record.objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            now = work.live.refresh()
            review = now.present.review
            if (review.state, review.by, review.decided_at) != (state, record.by, record.at):
                continue  # not carried out by this, or decided again since
            undoes = now.can_undo and now.present.label.startswith(record.decision)
            with suppress(CommandError):  # decided again, or another server was first
                work.live.do(cmd.Undo() if undoes else cmd.Reopen(), record.by, since=now)

    def _forget_hold(self, i: int) -> None:
        work = self._scene.works.get(i)
        if work is not None and work.hold_reason:
            work.services.acceptances.end(i)

    # --- one after the other

    def go_on(self) -> None:
        """Drop what is decided otherwise, and start with the next object that is ready."""
        scene, running = self._scene, self._running
        for entry, asked in list(self._queue.items()):
            work = scene.works[entry[0]]
            under_way = entry == running and not (work.hold_reason or acceptance_over(work))
            if under_way or entry not in self._queue:
                continue
            if work.document.review.state == "accepted":
                self._accepted(entry)
            elif work.live.state.seq != asked.seq and (moved := work.live.moved_since(asked)):
                self._refuse(entry, moved)
            elif entry == running:
                self._refuse(entry, work.failure or "it was cancelled")
        if running in self._queue:
            return
        if running is not None and self._running is not None:  # taken back
            self._stop(scene.works[running[0]])
        self._running = None
        for entry in list(self._queue):
            work = scene.works[entry[0]]
            free = entry in self._queue and not work.being_accepted
            if free and work.read_source(work.document) is not None:
                self._begin(work, entry)
                if self._running is not None:
                    return

    @staticmethod
    def _stop(work: Work) -> None:
        withdraw(work)
        work.jobs.cancel("save")
        if not work.is_shown:
            work.jobs.cancel("check")
            work.validation.forget_request()

    def _begin(self, work: Work, entry: Entry) -> None:
        scene, record = self._scene, entry[1]
        order = Order(record.at, record.looked, scene.lock, lambda: entry in self._queue)

        def refused(error: ArtiworldError) -> None:
            with scene.lock:
                if entry in self._queue:
                    self._refuse(entry, str(error))

        self._running, work.failure = entry, ""
        try:
            accept(work, "", record.by, refused=refused, state=self._queue[entry], order=order)
        except CommandError as error:
            self._refuse(entry, str(error))

    def _refuse(self, entry: Entry, why: str) -> None:
        i, record = entry
        work = self._scene.works[i]
        if work.document.review.state not in ("accepted", "rejected") and not work.hold_reason:
            hold(work, why)
        self._drop(entry)
        for outcome in self._outcomes_of(record):
            outcome.refused[i] = self.refusal(work) or Refusal(why)
            self._settle(outcome, i)

    def _accepted(self, entry: Entry) -> None:
        self._drop(entry)
        i, record = entry
        for outcome in self._outcomes_of(record):
            outcome.accepted += len(self._scene.twins(self._scene.works[i].item.obj.id))
            self._settle(outcome, i)

    def _drop(self, entry: Entry) -> None:
        if self._queue.pop(entry, None) is not None:
            self._done += 1
        if entry == self._running:
            self._running = None

    def _outcomes_of(self, record: DecisionRecord) -> list[_Outcome]:
        return [o for o in self._outcomes if o.record == record]

    def _settle(self, outcome: _Outcome, i: int) -> None:
        """Report the outcome of a decision once all its objects are done."""
        outcome.left.discard(i)
        if outcome.left:
            return
        self._outcomes.remove(outcome)
        if outcome.accepted:
            outcome.notice("Accepted", _objects(outcome.accepted), "green")
        # Without those that the person decided again meanwhile.
        on_hold = [(self._scene.works[i], refusal) for i, refusal in outcome.refused.items()]
        if not on_hold:
            return
        work, first = next(
            ((w, r) for w, r in on_hold if r.report is not None and not r.only_warnings),
            on_hold[0],
        )
        count = sum(len(self._scene.twins(w.item.obj.id)) for w, _ in on_hold)
        more = f" The others: Show, {HELD}." if len(on_hold) > 1 else ""
        advice = (
            # By now the person may be at another object.
            "Select it again: Y accepts it anyway, Enter shows it."
            if first.only_warnings
            else "Select it again: Enter shows the error; fix it, or give a reason."
            if first.report is not None
            else "Select it again: Enter opens it."
        )
        outcome.notice(
            f"{_objects(count)} not accepted",
            f"{work.item.obj.id}, {first.why.rstrip('.')}. {advice}{more}",
            "yellow",
        )


def _objects(count: int) -> str:
    return f"{count} object{'s'[: count != 1]}"
