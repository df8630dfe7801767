"""The gate's answer on one open object: asked for anew whenever its joints or parts change."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from app.server.display_names import joint_title
from app.server.jobs import CLICKS
from app.server.object_context import ObjectContext
from app.server.validation_tasks import judge_joints
from model.core.errors import CommandError
from model.core.tree import KinematicTree
from model.validation.low_confidence import with_low_confidence
from model.validation.report import Fix, Severity, ValidationReport
from sessions.document import Document

KEPT = 16
"""Answers kept for undo and redo."""

Revision = tuple[KinematicTree, str]
"""What an answer belongs to: the tree, and the reference of the labels."""

Sure = tuple[tuple[str, float], ...]
"""Child link and confidence of each joint that is still the predictor's."""


@dataclass(frozen=True, eq=False)
class JointCheck:
    """A joint that runs into something.

    Attributes:
        q: radians or metres where it is deepest. depth: metres beyond the penetration at rest.
        where: (3,) the contact in the object frame.
        other: the link that is hit.
    """

    joint: str
    q: float
    depth: float
    where: tuple[float, float, float]
    other: str | None


class LookFirstError(CommandError):
    """The gate doubts something that the person wasn't shown before accepting."""


@dataclass(frozen=True, eq=False)
class Wish:
    """An accept that a person asks for; see :func:`app.server.accepting.accept`.

    Attributes:
        again: asks anew; called once the gate has answered where it hasn't yet.
    """

    override: str
    looked_at: ValidationReport | None
    again: Callable[[], None]


class Judging:
    """Runs the gate for an object and keeps its answers by revision."""

    def __init__(self, obj: ObjectContext) -> None:
        self._obj = obj
        self._answers: OrderedDict[Revision, ValidationReport] = OrderedDict()
        self._told: dict[tuple[Revision, Sure], ValidationReport] = {}
        self._asked: Revision | None = None
        self._problem: tuple[Revision, str] | None = None
        self._waiting: Wish | None = None
        self._wished: Revision | None = None  # what the waiting wish is about
        self._lock = threading.Lock()

    @property
    def waiting(self) -> bool:
        """Whether somebody wants it accepted as soon as the joints are judged."""
        return self._waiting is not None

    @property
    def report(self) -> ValidationReport | None:
        """The answer to the present joints and parts, with what the predictor itself doubts; None
        while there is none. The same until something changes."""
        document = self._obj.document
        revision = self._revision(document)
        answer = None if revision is None else self._answers.get(revision)
        if revision is None or answer is None:
            return None
        sure = document.unsettled
        key = revision, tuple(sorted(sure.items()))
        told = self._told.get(key)
        # All tabs get the same one, also where two ask at once.
        return told or self._told.setdefault(key, with_low_confidence(answer, revision[0], sure))

    @property
    def checks(self) -> list[JointCheck]:
        """The collisions to mark."""
        report = self.report
        return [] if report is None else checks_of(report)

    @property
    def problem(self) -> str:
        """Why the present joints couldn't be judged, or ""."""
        if self._problem is None or self._problem[0] != self._revision(self._obj.document):
            return ""
        return self._problem[1]

    def ask(self) -> None:
        """Start the gate where the present joints have no answer yet."""
        obj = self._obj
        revision = self._revision(obj.document)
        if self._waiting is not None and revision != self._wished:
            self._accept_waiting()  # it hears that this is another object now
        if revision is None:
            self._asked = None
            return
        if revision == self._asked or obj.predicting:
            return
        self._asked = revision
        obj.jobs.cancel("check")
        obj.services.drafts.stop()
        if revision in self._answers:
            self._answers.move_to_end(revision)
            self._prepare(revision)
            return
        job = obj.services.workers.prediction.submit(
            judge_joints,
            obj.source(),
            revision[0],
            on_progress=obj.jobs.progress("check"),
            key=("check", obj.record.id),
            gives_way=CLICKS,
        )
        obj.start("check", job, lambda report: self._keep(revision, report))

    def forget_request(self) -> None:
        """The gate was stopped to make room for other work; ask again."""
        self._asked = None

    def failed(self, message: str) -> None:
        """The gate broke on the joints it was asked for last."""
        if self._asked is not None:
            with self._lock:
                self._problem = (self._asked, message)
        self._accept_waiting()

    def _keep(self, revision: Revision, report: ValidationReport) -> None:
        with self._lock:
            self._answers[revision] = report
        while len(self._answers) > KEPT:
            self._answers.popitem(last=False)
        self._told = {k: v for k, v in self._told.items() if k[0] in self._answers}
        if revision != self._revision(self._obj.document):
            return
        if self._waiting is None:
            self._prepare(revision)
        self._accept_waiting()

    def _prepare(self, revision: Revision) -> None:
        """Write what will be accepted while the person still looks at it."""
        obj = self._obj
        decided = obj.document.review.state == "accepted"
        if decided or obj.asset is None or self._answers[revision].severity == Severity.ERROR:
            return  # what is broken will be edited
        obj.services.drafts.prepare(obj.source(), revision[0])

    @staticmethod
    def _revision(document: Document) -> Revision | None:
        if document.tree is None or document.segmentation is None:
            return None
        return document.tree, document.segmentation.labels

    # --- accepting

    def admits(self, wish: Wish) -> bool:
        """Whether the object may be accepted now; False where it will be once the gate answered.

        Raises:
            CommandError: where the gate calls a joint broken and no reason is given.
            LookFirstError: where it doubts something that the person wasn't shown.
        """
        with self._lock:  # the gate may answer just now
            report = self.report
            waits = report is None and not self.problem
            self._waiting = wish if waits else None
            self._wished = self._revision(self._obj.document)
        if waits:
            return False
        document = self._obj.document
        if report is not None and report.severity == Severity.ERROR and not wish.override.strip():
            count, worst = len(report.joints_with(Severity.ERROR)), report.joints[0]
            what = f"{joint_title(document, worst.child)} is broken: {worst.message}"
            more = f" So {'are' if count > 2 else 'is'} {count - 1} more." if count > 1 else ""
            raise CommandError(f"{what}{more} Mend it, or say why it is right")
        if report and report.severity == Severity.WARNING and wish.looked_at is not report:
            count, worst = len(report.joints_with(Severity.WARNING)), report.joints[0]
            more = f" {count - 1} more to look at." if count > 1 else ""
            raise LookFirstError(
                f"{joint_title(document, worst.child)}: {worst.message}{more} "
                "Y again accepts it as it is"
            )
        return True

    def _accept_waiting(self) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, None
        if waiting is not None:
            waiting.again()

    def take_back(self) -> bool:
        """Nobody wants it accepted any more; whether somebody did and it wasn't decided yet."""
        with self._lock:  # the gate may answer just now
            waiting, self._waiting = self._waiting, None
        return waiting is not None

    def doubts(self) -> tuple[str, ...]:
        """For the record of an acceptance: what was known to be broken or doubtful."""
        report = self.report
        if report is None:
            return (f"the joints were not judged: {self.problem}",) if self.problem else ()
        return tuple(f"{j.joint}: {j.message}" for j in report.joints if j.severity != Severity.OK)

    def mend(self, joint: str, kind: str) -> Fix:
        """The mend of that kind for a joint.

        Raises:
            CommandError: where the joints changed meanwhile.
        """
        report = self.report
        found = None if report is None else report.of(joint)
        for mend in () if found is None else found.fixes:
            if mend.kind == kind:
                return mend
        raise CommandError("the joints changed meanwhile; they are being judged again")


def checks_of(report: ValidationReport) -> list[JointCheck]:
    """The collisions of a gate's answer as the views mark them."""
    return [
        JointCheck(j.joint, f.q.get(j.joint, 0.0), f.depth, f.where, f.other)
        for j in report.joints
        for f in j.findings
        if f.kind in ("collision", "jammed") and f.severity != Severity.OK and f.where is not None
    ]
