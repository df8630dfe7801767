"""Validation of one open object: runs again whenever its joints or parts change."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Hashable
from dataclasses import dataclass

from app.server.jobs import CLICKS
from app.server.names import joint_title
from app.server.object_context import ObjectContext
from app.server.part_tasks import validate_joints
from model.core.errors import CommandError
from model.core.tree import KinematicTree
from model.validation.examine import with_low_confidence, with_unknown_names, with_unusual_height
from model.validation.report import Fix, JointReport, Severity, ValidationReport
from sessions.document import Document, link_problems
from sessions.project_settings import ProjectSettings
from sessions.state import SessionState

REPORTS_KEPT = 16
"""Reports kept for undo and redo."""

Revision = tuple[KinematicTree, str, bool | None]
"""The subject of a report: the tree, the reference of the labels, whether parts are completed."""

Context = tuple[Hashable, ...]
"""Child link and confidence of each joint that no person edited; names that aren't allowed; the
category and the height."""


@dataclass(frozen=True, eq=False)
class JointCollision:
    """A collision to mark in the picture.

    Attributes:
        q: radians or metres where it is deepest.
        depth: metres beyond the penetration at rest.
        where: (3,) the contact in the object frame.
        other: the link that is hit.
    """

    joint: str
    q: float
    depth: float
    where: tuple[float, float, float]
    other: str | None


class UnseenWarningsError(CommandError):
    """Validation reports warnings that the person wasn't shown before accepting."""


class AcceptanceRequest:
    """An acceptance that a person asks for; see :func:`app.server.accepting.accept`.

    Args:
        override: reason for accepting it despite errors, else "".
        seen: the report whose warnings the person was shown, or None.
        state: the state that the person decided about.
        looked: whether the person was shown the warnings, whatever the report.
    """

    def __init__(
        self,
        override: str,
        seen: ValidationReport | None,
        state: SessionState,
        *,
        looked: bool = False,
    ) -> None:
        self.override, self.seen, self.state, self.looked = override, seen, state, looked

    def has_seen(self, report: ValidationReport | None) -> bool:
        """True if the person was shown the warnings of a report."""
        return self.looked or (report is not None and report is self.seen)

    def report_ended(self) -> None:
        """The report is there, where it wasn't yet, or won't come."""
        raise NotImplementedError


class Validation:
    """Validates an object and keeps the reports by revision.

    Args:
        sized: whether it has a size of its own, as no object of a scene.
    """

    def __init__(self, obj: ObjectContext, *, sized: bool) -> None:
        self._obj, self._sized = obj, sized
        self._reports: OrderedDict[Revision, ValidationReport] = OrderedDict()
        self._complete: dict[tuple[Revision, Context], ValidationReport] = {}
        self._requested: Revision | None = None
        self._problem: tuple[Revision, str] | None = None
        self._waiting: AcceptanceRequest | None = None
        self._lock = threading.Lock()

    @property
    def acceptance_waits(self) -> bool:
        """True while the object's acceptance waits for the validation of its joints."""
        return self._waiting is not None

    @property
    def report(self) -> ValidationReport | None:
        """The report on the present joints and parts, with low confidence, unknown names and an
        unusual size; None while there is none. The same object until something changes."""
        state = self._obj.state
        document = state.present
        revision = self._revision(document)
        report = None if revision is None else self._reports.get(revision)
        if revision is None or report is None:
            return None
        confidence = document.predicted_confidence
        names, category = unknown_names(document, self._obj.services.store.project.settings)
        sized = document.category, self._height()
        context = tuple(sorted(confidence.items())), tuple(names.items()), category, sized
        key = revision, context
        complete = self._complete.get(key)
        if complete is None:  # setdefault: all tabs get the same one, also two at a time
            report = with_low_confidence(report, revision[0], confidence)
            report = with_unknown_names(report, revision[0], names, category)
            report = with_unusual_height(report, revision[0], *sized)
            complete = self._complete.setdefault(key, report)
        found = state.seq, complete.severity == Severity.OK
        self._obj.services.checked[self._obj.record.id] = found
        return complete

    def _height(self) -> float | None:
        """Metres, once it is read; None too where a scene or a scan decides on the size."""
        asset, given = self._obj.asset, self._obj.document.placement is not None
        return asset.height if asset is not None and self._sized and not given else None

    @property
    def awaited(self) -> bool:
        """True while a report will come."""
        return not (self.report or self.problem or self._revision(self._obj.document) is None)

    @property
    def collisions(self) -> list[JointCollision]:
        """The collisions to mark."""
        report = self.report
        return [] if report is None else collisions_of(report)

    @property
    def problem(self) -> str:
        """Why the present joints couldn't be validated, or ""."""
        doc = self._obj.document
        if doc.tree is not None and (problems := link_problems(doc)):
            return "; ".join(problems)
        if self._problem is None or self._problem[0] != self._revision(doc):
            return ""
        return self._problem[1]

    def update(self) -> None:
        """Start validating where the present joints have no report yet."""
        obj = self._obj
        revision = self._revision(obj.document)
        self.drop_stale_request()
        if revision is None:
            self._requested = None
            return
        if revision == self._requested or "predict" in obj.jobs:
            return
        self._requested = revision
        obj.jobs.cancel("check")
        obj.services.drafts.stop()
        if revision in self._reports:
            self._reports.move_to_end(revision)
            self._prepare_draft(revision)
            return
        job = obj.services.workers.prediction.submit(
            validate_joints,
            obj.source(),
            revision[0],
            on_progress=obj.jobs.progress("check"),
            key=("check", obj.record.id),
            preempted_by=CLICKS,
        )
        obj.start("check", job, lambda report: self._keep(revision, report))

    def drop_stale_request(self) -> None:
        """End the acceptance that waits where the object was edited or decided meanwhile."""
        waiting = self._waiting
        if waiting is not None and self._obj.live.moved_since(waiting.state):
            self._retry_acceptance()  # which fails

    def forget_request(self) -> None:
        """Validation was stopped to make room for other work; start it again at the next update."""
        self._requested = None

    def failed(self, message: str) -> None:
        """Validation itself failed on the joints of the last request."""
        if self._requested is not None:
            with self._lock:
                self._problem = (self._requested, message)
        self._retry_acceptance()

    def _keep(self, revision: Revision, report: ValidationReport) -> None:
        with self._lock:
            self._reports[revision] = report
        while len(self._reports) > REPORTS_KEPT:
            self._reports.popitem(last=False)
        self._complete = {k: v for k, v in self._complete.items() if k[0] in self._reports}
        if revision != self._revision(self._obj.document) or self.report is None:
            return  # asking for the report records that the object is checked
        if self._waiting is None:
            self._prepare_draft(revision)
        self._retry_acceptance()

    def _prepare_draft(self, revision: Revision) -> None:
        """Write the asset while the person still looks at it, unless errors must be fixed first."""
        obj = self._obj
        decided = obj.document.review.state == "accepted"
        if decided or obj.asset is None or self._reports[revision].severity == Severity.ERROR:
            return
        obj.services.drafts.prepare(obj.source(), revision[0])

    @staticmethod
    def _revision(document: Document) -> Revision | None:
        if document.tree is None or document.segmentation is None or link_problems(document):
            return None
        return document.tree, document.segmentation.labels, document.complete

    # --- accepting

    def admits(self, request: AcceptanceRequest) -> bool:
        """True if the object may be accepted now, False if the request waits for the report.

        Raises:
            CommandError: where there are errors and no reason for an override.
            UnseenWarningsError: where there are warnings that the person wasn't shown.
        """
        with self._lock:  # the report may arrive just now
            report = self.report
            waits = report is None and not self.problem
            self._waiting = request if waits else None
        required = self._obj.services.store.project.settings.required
        if report is None and not waits and required:
            raise CommandError(f"The project requires the checks, which failed: {self.problem}")
        if report is None:
            return not waits
        if refusal := required_problem(self._obj.document, report, required):
            raise CommandError(refusal)
        if report.severity == Severity.ERROR and not request.override.strip():
            raise CommandError(f"{self._summary(report)} Fix it, or give a reason for the override")
        if report.severity == Severity.WARNING and not request.has_seen(report):
            raise UnseenWarningsError(f"{self._summary(report)} Press Y again to accept it anyway")
        return True

    def required_problem(self) -> str:
        """Problem that the project's required checks have found so far, or ""."""
        report, settings = self.report, self._obj.services.store.project.settings
        if report is None:
            return ""
        return required_problem(self._obj.document, report, settings.required)

    def _summary(self, report: ValidationReport) -> str:
        """Return the number of joints as bad as the worst one, and what that one has."""
        document = self._obj.document
        count, worst = len(alike(document, report, report.severity)), report.joints[0]
        kind = "error" if report.severity == Severity.ERROR else "warning"
        title = joint_title(document, worst.child)
        return f"{count} {kind}{'s'[: count != 1]}. {title}: {worst.message}"

    def _retry_acceptance(self) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, None
        if waiting is not None:
            waiting.report_ended()

    def withdraw(self) -> bool:
        """Withdraw the waiting request; whether there was one that wasn't decided yet."""
        with self._lock:  # the report may arrive just now
            waiting, self._waiting = self._waiting, None
        return waiting is not None

    def known_problems(self) -> tuple[str, ...]:
        """Return the warnings and errors that an acceptance is recorded with."""
        report = self.report
        if report is None:
            return (f"the joints were not validated: {self.problem}",) if self.problem else ()
        joints = (j for j in report.joints if j.severity != Severity.OK)
        return tuple(f"{j.joint or j.child}: {j.message}" for j in joints)

    def fix(self, joint: str, kind: str) -> Fix:
        """Return the fix of that kind for a joint.

        Raises:
            CommandError: where the joints changed meanwhile.
        """
        report = self.report
        found = None if report is None else report.of(joint)
        for fix in () if found is None else found.fixes:
            if fix.kind == kind:
                return fix
        raise CommandError("the joints changed meanwhile and are being validated again")


def alike(
    document: Document, report: ValidationReport, severity: Severity
) -> list[tuple[JointReport, ...]]:
    """Return the joints of a severity, worst first; parts of one name with the same kind of finding
    and no fix to choose are one group, so that six knobs are one warning."""
    names = {p.link: p.name for p in document.parts}
    groups: dict[Hashable, tuple[JointReport, ...]] = {}
    for joint in report.joints_with(severity):
        name = names.get(joint.child)
        single = name is None or joint.worst is None or joint.fixes
        key = joint.joint if single or joint.worst is None else (name, joint.worst.kind)
        groups[key] = (*groups.get(key, ()), joint)
    return list(groups.values())


def unknown_names(
    document: Document, settings: ProjectSettings
) -> tuple[dict[str, str], str | None]:
    """Return link → name of the parts whose name a strict project doesn't have, and the category
    where it hasn't that either, else None."""
    category = document.category
    parts = {
        p.link: p.name
        for p in document.parts
        if p.name and p.id and not settings.knows_part(p.name, category)
    }
    known = category is None or settings.knows_category(category)
    return parts, None if known else category


def required_problem(
    document: Document, report: ValidationReport, required: Collection[str]
) -> str:
    """Return what a project's required checks found, which nobody can override, or ""."""
    for joint in report.joints:
        for finding in joint.findings:
            if finding.severity != Severity.OK and finding.kind in required:
                title = joint_title(document, joint.child)
                return f"The project requires this check. {title}: {finding.message}"
    return ""


def collisions_of(report: ValidationReport) -> list[JointCollision]:
    """Return the collisions of a report as the views mark them."""
    return [
        JointCollision(j.joint, f.q.get(j.joint, 0.0), f.depth, f.where, f.other)
        for j in report.joints
        for f in j.findings
        if f.kind in ("collision", "jammed") and f.severity != Severity.OK and f.where is not None
    ]
