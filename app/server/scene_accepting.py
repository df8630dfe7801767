"""Accepting and rejecting objects from the scene, one after the other, in the background.

The scene's session records the decisions; here they are carried out in the objects' own sessions.
An object with errors isn't accepted: it waits for a person who fixes it or gives a reason. Nor is
one with warnings, unless the person was shown them. The decisions of a server that died are carried
out when the scene is opened again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from app.server.acceptances import acceptance_record, carry_out
from app.server.jobs import CLICKS
from app.server.names import joint_title
from app.server.observable import Notice
from app.server.part_tasks import PartSource, validate_joints
from app.server.scene_state import HELD, SceneState, Work
from app.server.validating import problems_of, required_problem, unknown_names
from model.core.errors import CommandError
from model.validation.examine import with_low_confidence, with_unknown_names
from model.validation.report import Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import DecisionRecord, Document, review_problems
from sessions.scene_commands import Decided, DecideObjects
from sessions.state import Context, SessionState, apply
from sessions.store import clean_who

Mark = Literal["", "validating", "on_hold"]
Entry = tuple[int, DecisionRecord]
"""Session id of an object, and the decision about it."""


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why an object wasn't accepted.

    Attributes:
        why: in a sentence, with the joint that it is about.
        document: the object's document then.
        report: the validation report; None where something else was the reason.
    """

    why: str
    document: Document
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
    """The decisions about a scene's objects that are being carried out.

    Args:
        is_accepting: whether an object is being accepted as an open object, by session id.

    Attributes:
        refused: session id → why the object wasn't accepted.
    """

    def __init__(self, scene: SceneState, is_accepting: Callable[[int], bool]) -> None:
        self._scene = scene
        self._is_accepting = is_accepting
        self._queue: dict[Entry, SessionState] = {}  # and the object's state at the decision
        self._known: tuple[DecisionRecord, ...] = scene.document.decided
        self._total = 0
        self._done = 0
        self._running: Entry | None = None
        self._outcomes: list[_Outcome] = []
        self._expected: dict[tuple[str, Decided, tuple[int, ...]], Notice] = {}
        self._ineffective: set[Entry] = set()
        self._elsewhere: set[DecisionRecord] = set()  # carried out by other servers
        self.refused: dict[int, Refusal] = {}

    def refusal(self, work: Work) -> Refusal | None:
        """Return why the present object wasn't accepted, or None."""
        refusal = self.refused.get(work.id)
        if refusal is None or not _same(refusal.document, work.document):
            return None
        return None if work.document.review.state in ("accepted", "rejected") else refusal

    def why_refused(self, work: Work) -> str:
        """Like :meth:`refusal`, in a sentence, or ""."""
        refusal = self.refusal(work)
        return "" if refusal is None else refusal.why

    def mark(self, work: Work) -> Mark:
        """Return whether the object is being validated, or on hold."""
        if work.id in self.waiting or self._is_accepting(work.id):
            return "validating"
        return "" if self.refusal(work) is None else "on_hold"

    @property
    def waiting(self) -> frozenset[int]:
        """Session ids of objects that are being accepted."""
        return frozenset(i for i, _ in self._queue)

    def hold(self, work: Work, reason: str, report: ValidationReport | None) -> None:
        """Put on hold the acceptance of an object that was opened, and then left.

        Args:
            reason: used where validation reports nothing.
        """
        if report is not None and report.severity != Severity.OK:
            reason = self._worst(work.document, report)
        self.refused[work.id] = Refusal(reason, work.document, report)
        self._scene.changed()

    @staticmethod
    def _worst(doc: Document, report: ValidationReport) -> str:
        """Return a report's worst finding, with the joint that it is about."""
        worst = report.joints[0]
        return f"{joint_title(doc, worst.child)}: {worst.message}"

    def expect(self, command: DecideObjects, who: str, notice: Notice) -> None:
        """Report the outcome of a decision that follows to ``notice``."""
        self._expected[clean_who(who), command.decision, command.objects] = notice

    # --- decisions

    def had_no_effect(self, record: DecisionRecord) -> bool:
        """True if it was an acceptance and accepted none of its objects."""
        here = record.decision == "accept" and record not in self._elsewhere
        return here and all(
            (i, record) in self._ineffective or not self._carried_out(i, record)
            for i in record.objects
        )

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
                    self.refused.pop(i, None)
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
                self.refused.pop(i, None)
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

    # --- one after the other

    def go_on(self) -> None:
        """Drop what is decided otherwise, and start with the next object that is ready."""
        scene = self._scene
        for entry, asked in list(self._queue.items()):
            work = scene.works[entry[0]]
            if work.document.review.state == "accepted":
                self._ineffective.add(entry)
                self._accepted(entry)
            elif work.live.state.seq != asked.seq and (moved := work.live.moved_since(asked)):
                self._refuse(entry, moved)
        if "accept" in scene.jobs:
            if self._running not in self._queue:
                scene.jobs.cancel("accept")
            return
        self._running = None
        for entry in list(self._queue):
            work = scene.works[entry[0]]
            doc = work.document
            problems = work.live.moved_since(self._queue[entry]) or "; ".join(review_problems(doc))
            if problems:
                self._refuse(entry, problems)
                continue
            assert doc.segmentation is not None
            if work.drawn is None or work.drawn.labels != doc.segmentation.labels:
                continue  # its parts are being cut; this is called again
            self._validate(work, entry)
            return

    def _progress(self, work: Work, step: str) -> tuple[float, str]:
        return self._done / max(1, self._total), f"{step} {work.item.obj.id}"

    def _is_current(self, work: Work, entry: Entry) -> bool:
        """True if the object is unchanged and the decision is still to be carried out."""
        return entry in self._queue and not work.live.moved_since(self._queue[entry])

    def _validate(self, work: Work, entry: Entry) -> None:
        scene, doc = self._scene, work.document
        source, tree = work.part_source(scene.services.workspace), doc.tree
        assert source is not None and tree is not None
        job = scene.services.workers.prediction.submit(
            validate_joints, source, tree, priority=6, preempted_by=CLICKS
        )

        def keep(answer: ValidationReport) -> None:
            if not self._is_current(work, entry):
                return  # go_on says so
            report = with_low_confidence(answer, tree, doc.predicted_confidence)
            settings = scene.services.store.project.settings
            report = with_unknown_names(report, tree, *unknown_names(doc, settings))
            required = required_problem(doc, report, settings.required)
            if (
                required
                or report.severity == Severity.ERROR
                or (report.severity == Severity.WARNING and not entry[1].looked)
            ):
                self._refuse(entry, required or self._worst(doc, report), report)
            else:
                self._save(work, entry, source, report)

        self._running = entry
        scene.start("accept", job, keep, self._progress(work, "checking"), work)

    def _save(self, work: Work, entry: Entry, source: PartSource, report: ValidationReport) -> None:
        scene, drawn, asked, record = self._scene, work.drawn, self._queue[entry], entry[1]
        assert asked.present.tree is not None and drawn is not None
        command = cmd.Accept("", problems_of(report), decided_at=record.at)
        provenance = acceptance_record(
            apply(asked, command, Context(record.by, "")),
            scene.services.store.history(work.id),
            drawn.source,
            report,
            warnings_seen=record.looked,
            scene=work.source(scene.path, scene.services.workspace),
        )
        job = scene.services.drafts.finish(source, asked.present.tree, _silent)

        def keep(draft: Path) -> None:
            if not self._is_current(work, entry):
                return
            self._drop(entry)
            carry_out(work.live, asked, command, record.by, draft, provenance)
            self._ineffective.discard(entry)
            self._accepted(entry)
            scene.live.refresh()  # another server may have undone the decision just now

        self._running = entry
        scene.start("accept", job, keep, self._progress(work, "saving"), work)

    def failed(self, message: str) -> None:
        """Refuse the object whose validation or writing failed."""
        if self._running is not None:
            self._refuse(self._running, message)

    def _refuse(self, entry: Entry, why: str, report: ValidationReport | None = None) -> None:
        i, record = entry
        refusal = self.refused[i] = Refusal(why, self._scene.works[i].document, report)
        self._drop(entry)
        self._ineffective.add(entry)
        for outcome in self._outcomes_of(record):
            outcome.refused[i] = refusal
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


def _same(one: Document, other: Document) -> bool:
    """True if both have the same validation report."""
    return (one.tree, one.segmentation, one.parts, one.predicted_confidence) == (
        other.tree,
        other.segmentation,
        other.parts,
        other.predicted_confidence,
    )


def _objects(count: int) -> str:
    return f"{count} object{'s'[: count != 1]}"


def _silent(fraction: float, message: str) -> None:
    """Ignore progress: the scene reports which object is saved; its steps are too quick to read."""
