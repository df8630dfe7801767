"""Accepting and rejecting objects from the scene, one after the other, in the background.

The scene's session says what was decided; here it is carried out in the objects' own sessions. An
object that the gate calls broken isn't accepted: it waits for a person who mends it or says why it
is right. What a killed server left undone is done when the scene is opened again.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from app.accepting import acceptance_record, asset_folder
from app.judging_tasks import judge_joints
from app.part_tasks import PartSource
from model.exporters.asset_folder import publish
from model.gate.report import GateReport
from sessions import commands as cmd
from sessions.document import DecisionRecord, Document
from sessions.state import Context, apply, review_problems

if TYPE_CHECKING:
    from app.scene_desk import SceneDesk
    from app.scene_rows import Work


class Accepting:
    """The decisions of a scene on their way.

    Attributes:
        refused: session id → why the object wasn't accepted, and the document that was refused.
    """

    def __init__(self, desk: SceneDesk) -> None:
        self._desk = desk
        self._queue: list[tuple[int, DecisionRecord]] = []
        self._seen: tuple[DecisionRecord, ...] = desk.document.decided
        self._asked = 0
        self._done = 0
        self._told_refused: set[int] = set()
        self._vain: set[tuple[int, DecisionRecord]] = set()
        self.refused: dict[int, tuple[str, Document]] = {}

    def why_refused(self, work: Work) -> str:
        """Why the object as it is now wasn't accepted, or ""."""
        why, document = self.refused.get(work.id, ("", None))
        return why if document is not None and document.tree == work.document.tree else ""

    @property
    def waiting(self) -> frozenset[int]:
        """Session ids of objects that are being accepted."""
        return frozenset(i for i, _ in self._queue)

    # --- decisions

    def in_vain(self, record: DecisionRecord) -> bool:
        """Whether it was an acceptance and none of its objects was accepted by it."""
        return all((i, record) in self._vain for i in record.objects)

    def told(self, record: DecisionRecord) -> str:
        """What was decided, in a few words."""
        work = self._desk.works.get(record.objects[0])
        if len(record.objects) > 1 or work is None:
            return f"{record.decision} {len(record.objects)} objects"
        return f"{record.decision} {work.item.obj.id}"

    def take_up(self) -> None:
        """What was decided and not carried out before the server ended."""
        store = self._desk.bench.store
        for record in self._seen:
            left = [i for i in record.objects if i in self._desk.works]
            self._carry_out(record, [i for i in left if store.object(i).updated < record.at])

    def follow(self) -> None:
        """Carry out what is new, take back what is gone."""
        before, self._seen = self._seen, self._desk.document.decided
        for record in before:
            if record not in self._seen:
                self._take_back(record)
        for record in self._seen:
            if record not in before:
                self._carry_out(record, list(record.objects))

    def _carry_out(self, record: DecisionRecord, objects: list[int]) -> None:
        for i in objects:
            work = self._desk.works.get(i)
            if work is None:
                continue
            if record.decision == "accept":
                if not self._queue:
                    self._asked = self._done = 0
                    self._told_refused.clear()
                self._queue.append((i, record))
                self._asked += 1
            elif work.document.review.state != "rejected":
                work.live.do(cmd.Reject(record.reason, decided_at=record.at), record.by)

    def _take_back(self, record: DecisionRecord) -> None:
        self._queue = [(i, r) for i, r in self._queue if r != record]
        state = {"accept": "accepted", "reject": "rejected"}[record.decision]
        for i in record.objects:
            work = self._desk.works.get(i)
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
        desk = self._desk
        if "accept" in desk.jobs:
            return
        for entry in list(self._queue):
            i, record = entry
            work = desk.works[i]
            doc = work.document
            problems = review_problems(doc)
            if doc.review.state == "accepted" or problems:
                self._drop(entry)
                self._vain.add(entry)
                if problems:
                    self.refused[i] = ("; ".join(problems), doc)
                continue
            assert doc.segmentation is not None
            if work.drawn is None or work.drawn.labels != doc.segmentation.labels:
                continue  # its parts are being cut; this is called again
            self._judge(work, record)
            return
        if not self._queue:
            self._say_end()

    def _told(self, work: Work, what: str) -> tuple[float, str]:
        return self._done / max(1, self._asked), f"{what} {work.item.obj.id}"

    def _judge(self, work: Work, record: DecisionRecord) -> None:
        desk, doc = self._desk, work.document
        assert doc.tree is not None
        source = self._source(work)
        job = desk.bench.prediction.submit(judge_joints, source, doc.tree, priority=6)

        def keep(report: GateReport) -> None:
            if work.document.tree != doc.tree:
                return  # edited meanwhile: it is judged again
            if report.verdict == "broken":
                self._refuse(work, report.joints[0].sentence)
            elif (work.id, record) in self._queue:
                self._save(work, record, source, report)

        desk.start("accept", job, keep, self._told(work, "judging"), work)

    def _source(self, work: Work) -> PartSource:
        doc = work.document
        assert work.drawn is not None and work.item.copy is not None
        return PartSource(
            work.drawn.folder, self._desk.bench.workspace, work.drawn.labels, doc.part_names,
            doc.category, work.item.copy.name,
        )  # fmt: skip

    def _save(
        self, work: Work, record: DecisionRecord, source: PartSource, report: GateReport
    ) -> None:
        desk, doc = self._desk, work.document
        assert doc.tree is not None and work.drawn is not None
        doubts = tuple(f"{j.joint}: {j.sentence}" for j in report.joints if j.verdict != "fine")
        command = cmd.Accept("", doubts, decided_at=record.at)
        store = desk.bench.store
        after = apply(work.live.state, command, Context(record.by, record.at))
        told = acceptance_record(after, store.history(work.id), work.drawn.source, report)
        folder = asset_folder(desk.bench.workspace, store.object(work.id))
        job = desk.bench.draft_asset(source, doc.tree, _silent)

        def keep(draft: Path) -> None:
            now = work.document
            if now.tree != doc.tree or now.segmentation != doc.segmentation:
                return  # edited meanwhile: it is judged again
            if (work.id, record) not in self._queue:
                return  # taken back meanwhile
            written = str(publish(draft, folder, told).folder)
            self._drop((work.id, record))
            self._vain.discard((work.id, record))
            work.live.do(command, record.by)
            work.live.do(cmd.Saved(written), record.by)

        desk.start("accept", job, keep, self._told(work, "saving"), work)

    def failed(self, work: Work, message: str) -> None:
        """The gate or the writers broke on an object."""
        self._refuse(work, message)

    def _refuse(self, work: Work, why: str) -> None:
        self.refused[work.id] = (why, work.document)
        self._told_refused.add(work.id)
        self._vain.update(e for e in self._queue if e[0] == work.id)
        self._queue = [(i, r) for i, r in self._queue if i != work.id]
        self._done += 1

    def _drop(self, entry: tuple[int, DecisionRecord]) -> None:
        if entry in self._queue:
            self._queue.remove(entry)
            self._done += 1

    def _say_end(self) -> None:
        asked, self._asked = self._asked, 0
        if not asked:
            return
        refused = len(self._told_refused)
        accepted = asked - refused
        if accepted:
            self._desk.tell("Accepted", f"{accepted} object{'s'[: accepted != 1]}", "green")
        if refused:
            first = self._desk.works[next(iter(self._told_refused))]
            self._desk.tell(
                f"{refused} not accepted",
                f"{first.item.obj.id}: {self.refused[first.id][0]} Open it to mend it, or to say "
                "why it is right",
                "yellow",
            )


def _silent(fraction: float, message: str) -> None:
    """The scene tells which object is saved; its own steps are too quick to read."""
