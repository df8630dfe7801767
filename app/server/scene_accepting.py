"""Accepting and rejecting objects from the scene, one after the other, in the background.

The scene's session records the decisions; here they are carried out in the objects' own sessions.
An object with errors isn't accepted: it waits for a person who fixes it or gives a reason. Nor is
one with warnings, unless the person was shown them. The decisions of a server that died are carried
out when the scene is opened again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from app.server.acceptance_record import acceptance_record, asset_folder
from app.server.display_names import joint_title
from app.server.jobs import CLICKS
from app.server.observable import Notice
from app.server.part_tasks import PartSource
from app.server.scene_rows import HELD, Work
from app.server.scene_state import SceneState
from app.server.validating import problems_of, required_problem, unknown_names
from app.server.validation_tasks import validate_joints
from model.validation.low_confidence import with_low_confidence
from model.validation.naming import with_unknown_names
from model.validation.report import Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import DecisionRecord, Document
from sessions.state import Context, apply, review_problems

Mark = Literal["", "validating", "on_hold"]


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
        """Whether a person who was shown it may accept it anyway."""
        return self.report is not None and self.report.severity == Severity.WARNING


@dataclass(eq=False)
class _Outcome:
    """What has become of the objects of one decision, for the person who made it.

    Attributes:
        left: sessions that are still to be accepted.
        accepted: number of objects accepted. refused: sessions that weren't.
    """

    record: DecisionRecord
    notice: Notice
    left: set[int]
    accepted: int = 0
    refused: list[int] = field(default_factory=list)


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
        self._queue: list[tuple[int, DecisionRecord]] = []
        self._known: tuple[DecisionRecord, ...] = scene.document.decided
        self._total = 0
        self._done = 0
        self._running: tuple[int, DecisionRecord] | None = None
        self._outcomes: list[_Outcome] = []
        self._expected: dict[tuple[int, ...], Notice] = {}
        self._warnings_seen: dict[int, Document] = {}
        self._ineffective: set[tuple[int, DecisionRecord]] = set()
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

    def expect(self, objects: tuple[int, ...], notice: Notice) -> None:
        """Report the outcome of the next decision about these to ``notice``."""
        self._expected[objects] = notice

    # --- decisions

    def had_no_effect(self, record: DecisionRecord) -> bool:
        """Whether it was an acceptance and accepted none of its objects."""
        return record.decision == "accept" and all(
            (i, record) in self._ineffective or not self._carried_out(i, record)
            for i in record.objects
        )

    def _carried_out(self, i: int, record: DecisionRecord) -> bool:
        """Whether the decision, maybe of an earlier server, has accepted an object, or will."""
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
            self._carry_out(record, [i for i in left if store.object(i).updated < record.at])

    def update(self, decided: tuple[DecisionRecord, ...], *, here: bool = True) -> None:
        """Carry out new decisions, revert those that were undone.

        Args:
            decided: all present decisions.
            here: whether they were made in this server; otherwise another one carries them out.
        """
        before, self._known = self._known, decided
        for record in before:
            if record not in self._known:
                self._queue = [(i, r) for i, r in self._queue if r != record]
                if here:
                    self._revert(record)
                self._outcomes = [o for o in self._outcomes if o.record != record]
                for i in record.objects:
                    self.refused.pop(i, None)
        for record in self._known:
            if record not in before and here:
                self._carry_out(record, list(record.objects))
        self._total = self._done + len(self._queue)
        if self._running is not None and self._running not in self._queue:
            self._scene.jobs.cancel("accept")

    def _carry_out(self, record: DecisionRecord, objects: list[int]) -> None:
        notice = self._expected.pop(record.objects, self._scene.notify)
        if record.decision == "accept":
            objects = [i for i in objects if i in self._scene.works]
            if not self._queue:
                self._total = self._done = 0
            self._outcomes.append(_Outcome(record, notice, set(objects)))
            for i in objects:
                if record.looked:
                    self._warnings_seen[i] = self._scene.works[i].document
                self.refused.pop(i, None)
                self._queue.append((i, record))
                self._total += 1
            return
        for i in objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            self._preempt(work, record, notice)
            if work.document.review.state != "rejected":
                work.live.do(cmd.Reject(record.reason, decided_at=record.at), record.by)

    def _preempt(self, work: Work, record: DecisionRecord, by: Notice) -> None:
        """Stop accepting an object that was rejected, and tell the person who accepts it."""
        for entry in [e for e in self._queue if e[0] == work.id]:
            self._drop(entry)
            self._ineffective.add(entry)
            for outcome in self._outcomes_of(entry[1]):
                if outcome.notice != by:
                    outcome.notice(
                        "Not accepted",
                        f"{work.item.obj.id} was rejected meanwhile by {record.by}",
                        "yellow",
                    )
                self._settle(outcome, work.id)

    def _revert(self, record: DecisionRecord) -> None:
        state = {"accept": "accepted", "reject": "rejected"}[record.decision]
        for i in record.objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            review = work.document.review
            if (review.state, review.by, review.decided_at) != (state, record.by, record.at):
                continue  # not carried out by this, or decided again since
            undoes = work.live.state.can_undo and work.document.label.startswith(record.decision)
            work.live.do(cmd.Undo() if undoes else cmd.Reopen(), record.by)

    # --- one after the other

    def go_on(self) -> None:
        """Start with the next object that is ready."""
        scene = self._scene
        if "accept" in scene.jobs:
            return
        self._running = None
        for entry in list(self._queue):
            i, record = entry
            work = scene.works[i]
            doc = work.document
            problems = review_problems(doc)
            if doc.review.state == "accepted":
                self._ineffective.add(entry)
                self._accepted(entry)
                continue
            if doc.review.state == "rejected" and doc.review.at > record.at:
                problems = (f"it was rejected meanwhile by {doc.review.by}.",)
            if problems:
                self._refuse(work, "; ".join(problems))
                continue
            assert doc.segmentation is not None
            if work.drawn is None or work.drawn.labels != doc.segmentation.labels:
                continue  # its parts are being cut; this is called again
            self._validate(work, record)
            return

    def _progress(self, work: Work, step: str) -> tuple[float, str]:
        return self._done / max(1, self._total), f"{step} {work.item.obj.id}"

    def _is_current(self, work: Work, record: DecisionRecord, doc: Document) -> bool:
        """Whether the object is as it was, and the decision is still to be carried out."""
        unchanged = _unchanged(doc, work.live.refresh().present)
        return unchanged and (work.id, record) in self._queue

    def _validate(self, work: Work, record: DecisionRecord) -> None:
        scene, doc = self._scene, work.document
        source, tree = work.part_source(scene.services.workspace), doc.tree
        assert source is not None and tree is not None
        job = scene.services.workers.prediction.submit(
            validate_joints, source, tree, priority=6, preempted_by=CLICKS
        )

        def keep(answer: ValidationReport) -> None:
            if not self._is_current(work, record, doc):
                return
            report = with_low_confidence(answer, tree, doc.predicted_confidence)
            settings = scene.services.store.project.settings
            report = with_unknown_names(report, tree, *unknown_names(doc, settings))
            shown = self._warnings_seen.get(work.id)
            seen = shown is not None and _same(shown, work.document)
            required = required_problem(doc, report, settings.required)
            if required or report.severity == Severity.ERROR or (
                report.severity == Severity.WARNING and not seen
            ):  # fmt: skip
                self._refuse(work, required or self._worst(doc, report), report)
            else:
                self._save(work, record, source, report, seen)

        self._running = (work.id, record)
        scene.start("accept", job, keep, self._progress(work, "checking"), work)

    def _save(
        self,
        work: Work,
        record: DecisionRecord,
        source: PartSource,
        report: ValidationReport,
        warnings_seen: bool,
    ) -> None:
        scene, doc, store = self._scene, work.document, self._scene.services.store
        assert doc.tree is not None and work.drawn is not None
        command = cmd.Accept("", problems_of(report), decided_at=record.at)
        after = apply(work.live.state, command, Context(record.by, record.at))
        written_record = acceptance_record(
            after, store.history(work.id), work.drawn.source, report, warnings_seen=warnings_seen,
            scene=work.source(scene.path, scene.services.workspace),
        )  # fmt: skip
        folder = asset_folder(scene.services.workspace, store.object(work.id))
        job = scene.services.drafts.finish(source, doc.tree, _silent)

        def keep(draft: Path) -> None:
            if not self._is_current(work, record, doc):
                return
            written = str(store.assets.publish(draft, folder, written_record))
            self._ineffective.discard((work.id, record))
            work.live.do(command, record.by)
            work.live.do(cmd.Saved(written), record.by)
            self._accepted((work.id, record))

        self._running = (work.id, record)
        scene.start("accept", job, keep, self._progress(work, "saving"), work)

    def failed(self, work: Work, message: str) -> None:
        """Refuse an object whose validation or writing failed."""
        self._refuse(work, message)

    def _refuse(self, work: Work, why: str, report: ValidationReport | None = None) -> None:
        self.refused[work.id] = Refusal(why, work.document, report)
        for entry in [e for e in self._queue if e[0] == work.id]:
            self._drop(entry)
            self._ineffective.add(entry)
            for outcome in self._outcomes_of(entry[1]):
                outcome.refused.append(work.id)
                self._settle(outcome, work.id)

    def _accepted(self, entry: tuple[int, DecisionRecord]) -> None:
        self._drop(entry)
        i, record = entry
        for outcome in self._outcomes_of(record):
            outcome.accepted += len(self._scene.twins(self._scene.works[i].item.obj.id))
            self._settle(outcome, i)

    def _drop(self, entry: tuple[int, DecisionRecord]) -> None:
        if entry in self._queue:
            self._queue.remove(entry)
            self._done += 1
        if all(i != entry[0] for i, _ in self._queue):
            self._warnings_seen.pop(entry[0], None)

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
        # Without those that were decided again meanwhile.
        on_hold = [
            (self._scene.works[i], self.refused[i]) for i in outcome.refused if i in self.refused
        ]
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
            f"{work.item.obj.id}, {first.why} {advice}{more}",
            "yellow",
        )


def _same(one: Document, other: Document) -> bool:
    """Whether both have the same validation report."""
    return (one.tree, one.segmentation, one.parts, one.predicted_confidence) == (
        other.tree, other.segmentation, other.parts, other.predicted_confidence,
    )  # fmt: skip


def _unchanged(one: Document, other: Document) -> bool:
    """Whether both would be written the same, and nobody decided anything in between."""
    return _same(one, other) and (one.category, one.review) == (other.category, other.review)


def _objects(count: int) -> str:
    return f"{count} object{'s'[: count != 1]}"


def _silent(fraction: float, message: str) -> None:
    """Ignore progress: the scene reports which object is saved; its steps are too quick to read."""
