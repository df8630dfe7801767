"""Accepting and rejecting objects from the scene, one after the other, in the background.

The scene's session says what was decided; here it is carried out in the objects' own sessions. What
the gate calls broken isn't accepted: it waits for a person who mends it or says why it is right;
nor is what it wants looked at, unless the person was shown it. What a killed server left undone is
done when the scene is opened again.
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
from app.server.validation_tasks import judge_joints
from model.io.assets.asset_folder import publish
from model.validation.low_confidence import with_low_confidence
from model.validation.report import Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import DecisionRecord, Document
from sessions.state import Context, apply, review_problems

Mark = Literal["", "judging", "held"]


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why an object wasn't accepted.

    Attributes:
        why: in a sentence, with the joint that it is about.
        document: what was refused.
        report: the gate's answer; None where something else was the matter.
    """

    why: str
    document: Document
    report: ValidationReport | None = None

    @property
    def wants_a_look(self) -> bool:
        """Whether a person who was shown it may accept it as it is."""
        return self.report is not None and self.report.severity == Severity.WARNING


@dataclass(eq=False)
class _Told:
    """What becomes of the objects of one decision, for whoever made it.

    Attributes:
        left: sessions that are still to be accepted.
        accepted: objects that were. refused: sessions that weren't.
    """

    record: DecisionRecord
    notice: Notice
    left: set[int]
    accepted: int = 0
    refused: list[int] = field(default_factory=list)


class Accepting:
    """The decisions of a scene on their way.

    Attributes:
        refused: session id → why the object wasn't accepted.
    """

    def __init__(self, scene: SceneState, is_accepting: Callable[[int], bool]) -> None:
        self._scene = scene
        self._is_accepting = is_accepting
        self._queue: list[tuple[int, DecisionRecord]] = []
        self._seen: tuple[DecisionRecord, ...] = scene.document.decided
        self._asked = 0
        self._done = 0
        self._running: tuple[int, DecisionRecord] | None = None
        self._told: list[_Told] = []
        self._expected: dict[tuple[int, ...], Notice] = {}
        self._looked: dict[int, Document] = {}
        self._vain: set[tuple[int, DecisionRecord]] = set()
        self.refused: dict[int, Refusal] = {}

    def refusal(self, work: Work) -> Refusal | None:
        """Why the object as it is now wasn't accepted, or None."""
        refusal = self.refused.get(work.id)
        if refusal is None or not _same(refusal.document, work.document):
            return None
        return None if work.document.review.state in ("accepted", "rejected") else refusal

    def why_refused(self, work: Work) -> str:
        """The same in a sentence, or ""."""
        refusal = self.refusal(work)
        return "" if refusal is None else refusal.why

    def mark(self, work: Work) -> Mark:
        """Whether the gate is at work on the object, or holds it back."""
        if work.id in self.waiting or self._is_accepting(work.id):
            return "judging"
        return "" if self.refusal(work) is None else "held"

    @property
    def waiting(self) -> frozenset[int]:
        """Session ids of objects that are being accepted."""
        return frozenset(i for i, _ in self._queue)

    def hold(self, work: Work, why: str, report: ValidationReport | None) -> None:
        """Put on hold the acceptance of an object that was opened, and then left.

        Args:
            why: the reason where validation reports nothing.
        """
        if report is not None and report.severity != Severity.OK:
            why = self._said(work.document, report)
        self.refused[work.id] = Refusal(why, work.document, report)
        self._scene.changed()

    @staticmethod
    def _said(doc: Document, report: ValidationReport) -> str:
        """What is worst of a gate's answer, with the joint that it is about."""
        worst = report.joints[0]
        return f"{joint_title(doc, worst.child)}: {worst.message}"

    def expect(self, objects: tuple[int, ...], notice: Notice) -> None:
        """The next decision about these is made by whoever hears ``notice``."""
        self._expected[objects] = notice

    # --- decisions

    def in_vain(self, record: DecisionRecord) -> bool:
        """Whether it was an acceptance and none of its objects was accepted by it."""
        return record.decision == "accept" and all(
            (i, record) in self._vain or not self._carried_out(i, record) for i in record.objects
        )

    def _carried_out(self, i: int, record: DecisionRecord) -> bool:
        """Whether the decision, maybe of an earlier server, has accepted an object, or will."""
        if (i, record) in self._queue:
            return True
        entries = self._scene.services.store.history(i)
        return any(
            isinstance(e.command, cmd.Accept) and e.command.decided_at == record.at for e in entries
        )

    def told(self, record: DecisionRecord) -> str:
        """What was decided, in a few words."""
        work = self._scene.works.get(record.objects[0])
        if len(record.objects) > 1 or work is None:
            return f"{record.decision} {len(record.objects)} objects"
        return f"{record.decision} {work.item.obj.id}"

    def take_up(self) -> None:
        """What was decided and not carried out before the server ended."""
        store = self._scene.services.store
        before, self._seen = self._seen, self._scene.document.decided
        for record in before:
            left = [i for i in record.objects if i in self._scene.works]
            self._carry_out(record, [i for i in left if store.object(i).updated < record.at])

    def follow(self, decided: tuple[DecisionRecord, ...], *, here: bool = True) -> None:
        """Carry out what is new, take back what is gone.

        Args:
            decided: all that is decided now.
            here: whether it was decided in this server; else another one sees to the objects.
        """
        before, self._seen = self._seen, decided
        for record in before:
            if record not in self._seen:
                self._queue = [(i, r) for i, r in self._queue if r != record]
                if here:
                    self._take_back(record)
                self._told = [t for t in self._told if t.record != record]
                for i in record.objects:
                    self.refused.pop(i, None)
        for record in self._seen:
            if record not in before and here:
                self._carry_out(record, list(record.objects))
        self._asked = self._done + len(self._queue)
        if self._running is not None and self._running not in self._queue:
            self._scene.jobs.cancel("accept")

    def _carry_out(self, record: DecisionRecord, objects: list[int]) -> None:
        notice = self._expected.pop(record.objects, self._scene.tell)
        if record.decision == "accept":
            objects = [i for i in objects if i in self._scene.works]
            if not self._queue:
                self._asked = self._done = 0
            self._told.append(_Told(record, notice, set(objects)))
            for i in objects:
                if record.looked:
                    self._looked[i] = self._scene.works[i].document
                self.refused.pop(i, None)
                self._queue.append((i, record))
                self._asked += 1
            return
        for i in objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            self._overtake(work, record, notice)
            if work.document.review.state != "rejected":
                work.live.do(cmd.Reject(record.reason, decided_at=record.at), record.by)

    def _overtake(self, work: Work, record: DecisionRecord, by: Notice) -> None:
        """An object that is being accepted was rejected: whoever accepts it is told."""
        for entry in [e for e in self._queue if e[0] == work.id]:
            self._drop(entry)
            self._vain.add(entry)
            for told in [t for t in self._told if t.record == entry[1]]:
                if told.notice != by:
                    told.notice(
                        "Not accepted",
                        f"{work.item.obj.id} was rejected meanwhile by {record.by}",
                        "yellow",
                    )
                self._settle(told, work.id)

    def _take_back(self, record: DecisionRecord) -> None:
        state = {"accept": "accepted", "reject": "rejected"}[record.decision]
        for i in record.objects:
            work = self._scene.works.get(i)
            if work is None:
                continue
            review = work.document.review
            if (review.state, review.by, review.decided_at) != (state, record.by, record.at):
                continue  # not carried out by this, or decided anew since
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
                self._vain.add(entry)
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
            self._judge(work, record)
            return

    def _progress(self, work: Work, what: str) -> tuple[float, str]:
        return self._done / max(1, self._asked), f"{what} {work.item.obj.id}"

    def _judge(self, work: Work, record: DecisionRecord) -> None:
        scene, doc = self._scene, work.document
        assert doc.tree is not None
        source = self._source(work)
        job = scene.services.workers.prediction.submit(
            judge_joints, source, doc.tree, priority=6, gives_way=CLICKS
        )

        def keep(answer: ValidationReport) -> None:
            assert doc.tree is not None
            report = with_low_confidence(answer, doc.tree, doc.unsettled)
            if not _as_it_was(doc, work.live.refresh().present):
                return  # edited or decided on meanwhile: it is looked at again
            if (work.id, record) not in self._queue:
                return  # taken back meanwhile
            looked = self._looked.get(work.id)
            seen = looked is not None and _same(looked, work.document)
            warned = report.severity == Severity.WARNING
            if report.severity == Severity.ERROR or (warned and not seen):
                self._refuse(work, self._said(doc, report), report)
            else:
                self._save(work, record, source, report, seen)

        self._running = (work.id, record)
        scene.start("accept", job, keep, self._progress(work, "judging"), work)

    def _source(self, work: Work) -> PartSource:
        doc = work.document
        assert work.drawn is not None and work.item.copy is not None
        return PartSource(
            work.drawn.folder, self._scene.services.workspace, work.drawn.labels, doc.part_names,
            doc.category, work.name,
        )  # fmt: skip

    def _save(
        self, work: Work, record: DecisionRecord, source: PartSource, report: ValidationReport,
        looked_at: bool,
    ) -> None:  # fmt: skip
        scene, doc = self._scene, work.document
        assert doc.tree is not None and work.drawn is not None
        doubts = tuple(
            f"{j.joint}: {j.message}" for j in report.joints if j.severity != Severity.OK
        )
        command = cmd.Accept("", doubts, decided_at=record.at)
        store = scene.services.store
        after = apply(work.live.state, command, Context(record.by, record.at))
        told = acceptance_record(
            after, store.history(work.id), work.drawn.source, report, looked_at=looked_at,
            scene=work.source(scene.path, scene.services.workspace),
        )  # fmt: skip
        folder = asset_folder(scene.services.workspace, store.object(work.id))
        job = scene.services.drafts.finish(source, doc.tree, _silent)

        def keep(draft: Path) -> None:
            if not _as_it_was(doc, work.live.refresh().present):
                return  # edited or decided on meanwhile: it is looked at again
            if (work.id, record) not in self._queue:
                return  # taken back meanwhile
            written = str(publish(draft, folder, told).folder)
            self._vain.discard((work.id, record))
            work.live.do(command, record.by)
            work.live.do(cmd.Saved(written), record.by)
            self._accepted((work.id, record))

        self._running = (work.id, record)
        scene.start("accept", job, keep, self._progress(work, "saving"), work)

    def failed(self, work: Work, message: str) -> None:
        """The gate or the writers broke on an object."""
        self._refuse(work, message)

    def _refuse(self, work: Work, why: str, report: ValidationReport | None = None) -> None:
        self.refused[work.id] = Refusal(why, work.document, report)
        for entry in [e for e in self._queue if e[0] == work.id]:
            self._drop(entry)
            self._vain.add(entry)
            for told in [t for t in self._told if t.record == entry[1]]:
                told.refused.append(work.id)
                self._settle(told, work.id)

    def _accepted(self, entry: tuple[int, DecisionRecord]) -> None:
        self._drop(entry)
        i, record = entry
        for told in [t for t in self._told if t.record == record]:
            told.accepted += len(self._scene.twins(self._scene.works[i].item.obj.id))
            self._settle(told, i)

    def _drop(self, entry: tuple[int, DecisionRecord]) -> None:
        if entry in self._queue:
            self._queue.remove(entry)
            self._done += 1
        if all(i != entry[0] for i, _ in self._queue):
            self._looked.pop(entry[0], None)

    def _settle(self, told: _Told, i: int) -> None:
        """Tell whoever decided what became of it once nothing is left to do."""
        told.left.discard(i)
        if told.left:
            return
        self._told.remove(told)
        if told.accepted:
            told.notice("Accepted", _objects(told.accepted), "green")
        # Without those that were decided on anew meanwhile.
        held = [(self._scene.works[i], self.refused[i]) for i in told.refused if i in self.refused]
        if not held:
            return
        work, first = next(
            ((w, r) for w, r in held if r.report is not None and not r.wants_a_look), held[0]
        )
        count = sum(len(self._scene.twins(w.item.obj.id)) for w, _ in held)
        more = f" The others: Show, {HELD}." if len(held) > 1 else ""
        what = (
            # By now the person may be at another object.
            "Choose it again: Y accepts it as it is, Enter shows it."
            if first.wants_a_look
            else "Choose it again: Enter shows where; mend it, or say why it is right."
            if first.report is not None
            else "Choose it again: Enter opens it."
        )
        told.notice(
            f"{_objects(count)} not accepted",
            f"{work.item.obj.id}, {first.why} {what}{more}",
            "yellow",
        )


def _same(one: Document, other: Document) -> bool:
    """Whether the gate would say the same of both."""
    return (one.tree, one.segmentation, one.parts, one.unsettled) == (
        other.tree, other.segmentation, other.parts, other.unsettled,
    )  # fmt: skip


def _as_it_was(one: Document, other: Document) -> bool:
    """Whether the same would be written of both, and nobody decided anything since."""
    return _same(one, other) and (one.category, one.review) == (other.category, other.review)


def _objects(count: int) -> str:
    return f"{count} object{'s'[: count != 1]}"


def _silent(fraction: float, message: str) -> None:
    """The scene tells which object is saved; its own steps are too quick to read."""
