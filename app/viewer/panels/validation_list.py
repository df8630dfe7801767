"""The gate in the review step: joint by joint, worst first; a click shows the worst moment."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from app.server.display_names import in_words, joint_title
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.picture.motion import Motion
from app.viewer.tab import Tab
from app.viewer.text import plain
from model.core.errors import CommandError
from model.validation.report import FixKind, JointReport, Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import Document

SHOWN = 8
"""Joints with buttons; the others are counted."""
SIGNS: dict[Severity, str] = {Severity.OK: "✓", Severity.WARNING: "▲", Severity.ERROR: "✖"}
WORDS: dict[Severity, str] = {
    Severity.OK: "fine", Severity.WARNING: "to look at", Severity.ERROR: "broken",
}  # fmt: skip
MENDS: dict[FixKind, str] = {
    "flip": "Flip", "shift": "Shift axis", "limits": "Fit limits", "shrink": "Shrink colliders",
}  # fmt: skip
MEND_KEYS: dict[str, FixKind] = {word: kind for kind, word in MENDS.items()}


class ValidationList:
    """Buttons for the joints that the gate doubts, and what they show."""

    def __init__(self, tab: Tab, motion: Motion, drawn: Callable[[], bool]) -> None:
        """Make the headline; ``drawn`` says whether the open object's picture was sent."""
        self._tab, self._motion, self._drawn = tab, motion, drawn
        self._key: Any = None
        self._rows: list[Any] = []
        self._shown: tuple[Any, str] | None = None
        self._looked_at: deque[ValidationReport] = deque(maxlen=64)
        self._wanted: int | None = None  # an object whose worst moment is shown once it is judged
        self._headline = tab.client.gui.add_markdown("")

    def build_list(self) -> None:
        """Make the list, below what decides: its length is not to move that."""
        self._folder = self._tab.client.gui.add_folder("Joints, worst first", visible=False)

    # --- what a person does

    def looked_at(self, obj: OpenObject) -> ValidationReport | None:
        """The gate's answer on the present joints, where this tab has shown what it doubts."""
        report = obj.judging.report
        return next((r for r in self._looked_at if r is report), None)

    def show_worst(self) -> None:
        """The worst moment of the worst joint, as soon as the joints are judged."""
        obj = self._tab.selection.need_object()
        report = obj.judging.report
        self._wanted = obj.record.id if report is None else None
        if report is not None and report.severity != Severity.OK:
            self.show(report.joints[0].joint)

    def show_soon(self, obj: OpenObject) -> None:
        """The same once the object is drawn."""
        self._wanted = obj.record.id

    def show(self, joint: str) -> None:
        """Pose the object at a joint's worst moment and mark the contact."""
        selection = self._tab.selection
        obj = selection.need_object()
        report = obj.judging.report
        verdict = None if report is None else report.of(joint)
        if verdict is None or report is None or obj.document.tree is None:
            raise CommandError("the joints are still being judged")
        selection.choose_joint(verdict.child)
        self._shown = (report, joint)
        if verdict.severity != Severity.OK and self.looked_at(obj) is None:
            self._looked_at.append(report)
        worst = verdict.worst
        if worst is None:
            self._motion.show_moment(None, "")
            self._tab.notify("Nothing to see", verdict.message, "gray")
        else:
            self._motion.show_moment(worst, moment_text(worst.kind, worst.depth))

    def show_next(self) -> None:
        """The worst moment of the next joint that isn't fine (Tab)."""
        report = self._tab.selection.need_object().judging.report
        if report is None:
            raise CommandError("the joints are still being judged")
        doubted = [j.joint for j in report.joints if j.severity != Severity.OK]
        if not doubted:
            self._tab.notify("Every joint is fine", "Accept with Y", "gray")
            return
        before = self._shown[1] if self._shown is not None and self._shown[0] is report else None
        at = doubted.index(before) if before in doubted else -1
        self._tab.selection.set_step("Review")
        self.show(doubted[(at + 1) % len(doubted)])

    def _mend(self, joint: str, word: str) -> None:
        tab = self._tab
        mend = tab.selection.need_object().judging.mend(joint, MEND_KEYS[word])
        self._motion.reset()
        tab.do(cmd.SetJoint(mend.joint))
        tab.notify("Mended", f"{mend.message} Undo with Ctrl+Z.", "green")

    # --- drawing

    def draw(self, obj: OpenObject, doc: Document) -> None:
        """Bring the view up to date."""
        report = obj.judging.report
        there = report is not None and self._drawn()
        if self._wanted is not None and (there or self._wanted != obj.record.id):
            wanted, self._wanted = self._wanted, None
            if wanted == obj.record.id:
                self._tab.act(self.show_worst)
        line = headline(obj, doc, report)
        put(self._headline, "content", line)
        put(self._headline, "visible", bool(line))
        if self._shown is not None and self._shown[0] is not report:
            # Other joints, another answer: what was shown is no longer so.
            self._shown = None
            self._motion.clear_moment()
        key = None if report is None else (report, tuple(doc.part_names.items()))
        if key == self._key:
            return
        self._key = key
        for row in self._rows:
            row.remove()
        self._rows = []
        doubted = [] if report is None else [j for j in report.joints if j.findings]
        put(self._folder, "visible", bool(doubted))
        with self._folder:
            for verdict in doubted[:SHOWN]:
                self._add_row(doc, verdict)
            if len(doubted) > SHOWN:
                more = self._tab.client.gui.add_markdown(
                    f"… and {len(doubted) - SHOWN} more (Tab)."
                )
                self._rows.append(more)

    def _add_row(self, doc: Document, verdict: JointReport) -> None:
        tab, gui, joint = self._tab, self._tab.client.gui, verdict.joint
        title = joint_title(doc, verdict.child)
        button = gui.add_button(
            f"{SIGNS[verdict.severity]} {title}: {WORDS[verdict.severity]}"[:60],
            color=palette.VERDICT_COLORS[verdict.severity],
            hint="Show the worst moment (Tab: the next one)",
        )
        button.on_click(lambda _: tab.act(lambda: self.show(joint)))
        lines = [plain(f.message, 200) for f in verdict.findings[:3]]
        self._rows += [button, gui.add_markdown("  \n".join(lines))]
        if verdict.fixes:
            words = tuple(MENDS[m.kind] for m in verdict.fixes)
            hint = " ".join(m.message for m in verdict.fixes)
            mends = gui.add_button_group("Mend", words, hint=hint)
            mends.on_click(lambda e: tab.act(lambda: self._mend(joint, e.target.value)))
            self._rows.append(mends)


def headline(obj: OpenObject, doc: Document, report: ValidationReport | None) -> str:
    """The verdict in one line."""
    if doc.tree is None:
        return ""
    if report is None:
        if obj.judging.problem:
            return f"⚠ **The joints couldn't be judged:** {plain(obj.judging.problem, 200)}"
        fraction, message = obj.busy.get("check", (0.0, ""))
        message = plain(in_words(doc, message))
        return f"*Judging the joints… {100 * fraction:.0f} % {message}".rstrip() + "*"
    counts = {v: len(report.joints_with(v)) for v in reversed(Severity)}
    parts = [f"{SIGNS[v]} {n} {WORDS[v]}" for v, n in counts.items() if n]  # type: ignore[index]
    line = f"**Gate: {' · '.join(parts) or 'no joint moves'}**"
    if report.physics is not None and not report.physics.ran:
        line += f"  \n*Physics: {plain(report.physics.problem, 160)}*"
    return line


def moment_text(kind: str, metres: float) -> str:
    """For the label at the contact."""
    amount = f"{1000 * metres:.0f} mm"
    return {"detached": f"{amount} off", "floating": f"{amount} to the next part"}.get(
        kind, f"{amount} deep"
    )
