"""Panels of the review: rejecting with a reason (X, then a number), the findings of the checks,
worst first, and the dialog that exports accepted objects.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections import deque
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, cast

import numpy as np
import viser

from app.server.bulk import BulkWork
from app.server.export_tasks import ExportTask, zipped
from app.server.names import display_text, joint_title
from app.server.open_object import OpenObject
from app.server.validating import alike
from app.viewer.panels.widgets import Dialog, put
from app.viewer.picture import palette
from app.viewer.picture.motion import Motion
from app.viewer.tab import Tab, plain
from app.viewer.words import queue as queue_words
from app.viewer.words import review as words
from model.core.errors import CommandError
from model.io.export.registry import exporter_names, format_title, load_exporter
from model.io.export.simready import AboutPackage, remember, remembered
from model.physics.collision.build import CollisionSettings, Method
from model.physics.simulation_values import PhysicsSettings
from model.validation.report import FixKind, JointReport, Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import Document
from sessions.project_settings import Project
from sessions.review import RejectReason

_ROWS = (words.reason_buttons()[:4], words.reason_buttons()[4:])


class Rejecting:
    """The question for a reason in one tab.

    Args:
        about: what would be rejected now; a question about something else is off.
        reject: gets the reason.
    """

    def __init__(
        self, tab: Tab, about: Callable[[], Any], reject: Callable[[RejectReason], None]
    ) -> None:
        self._tab, self._about, self._reject = tab, about, reject
        self._asked: Any = None
        self._note: Any = None

    @property
    def asking(self) -> bool:
        """True while the next number is a reason."""
        self.end_elsewhere()
        return self._asked is not None

    def end_elsewhere(self) -> None:
        """End a question about something that isn't shown any more."""
        if self._asked is not None and self._asked != self._about():
            self.cancel()

    def ask(self, name: str) -> None:
        """Ask why the object of that name is rejected; a second call cancels."""
        if self.asking:
            self.cancel()
            return
        self._asked = self._about()
        self._note = self._tab.client.add_notification(
            words.ask_reason(name), words.reason_keys(), color="red"
        )
        self._tab.invalidate()

    def answer(self, number: int) -> None:
        """Reject for the reason with that number, from 1.

        Raises:
            CommandError: where no reason has that number.
        """
        if not 1 <= number <= len(words.REASONS):
            raise CommandError(words.bad_reason())
        self.cancel()
        self._reject(tuple(words.REASONS)[number - 1])

    def cancel(self) -> None:
        """Cancel the rejection."""
        note, self._note, self._asked = self._note, None, None
        if note is not None:
            note.remove()
            self._tab.invalidate()


class RejectButtons:
    """A button that asks for a reason, then one for each reason."""

    def __init__(self, tab: Tab, rejecting: Rejecting, clicked: Callable[[], None]) -> None:
        """Make the buttons; ``clicked`` toggles the question."""
        self._tab, self._rejecting = tab, rejecting
        gui = tab.client.gui
        self._reject = gui.add_button(words.REJECT, icon=viser.Icon.X, color="red")
        self._rows = [
            gui.add_button_group(words.REASON_LABEL if k == 0 else "", row, visible=False)
            for k, row in enumerate(_ROWS)
        ]
        self._reject.on_click(lambda _: clicked())
        for row in self._rows:
            row.on_click(lambda e: self._chosen(e.target.value))

    def _chosen(self, label: str) -> None:
        rejecting, number = self._rejecting, int(label.partition(" ")[0])
        self._tab.act(lambda: rejecting.answer(number) if rejecting.asking else None)

    def draw(self, visible: bool) -> None:
        """Bring them up to date; ``visible`` where there is something to reject."""
        asking = visible and self._rejecting.asking
        put(self._reject, visible=visible, label=words.CANCEL_REJECTION if asking else words.REJECT)
        for row in self._rows:
            put(row, visible=asking)


SHOWN = 8
"""Joints with buttons; the others are counted."""


class ValidationList:
    """Buttons for the joints with findings."""

    def __init__(self, tab: Tab, motion: Motion, drawn: Callable[[], bool]) -> None:
        """Make the headline; ``drawn`` says whether the open object's picture was sent."""
        self._tab, self._motion, self._drawn = tab, motion, drawn
        self._key: Any = None
        self._rows: list[Any] = []
        self._shown: tuple[Any, str] | None = None
        self._looked_at: deque[ValidationReport] = deque(maxlen=64)
        self._wanted: int | None = (
            None  # id of an object whose worst pose is shown once it is checked
        )
        self._headline = tab.client.gui.add_markdown("")
        # What was shown counts as long as the object stays open.
        tab.selection.on_open(self._looked_at.clear)

    def build_list(self) -> None:
        """Make the list, below the buttons so that its length doesn't move them."""
        self._folder = self._tab.client.gui.add_folder(words.FINDINGS, visible=False)

    # --- what the user does

    def looked_at(self, obj: OpenObject) -> ValidationReport | None:
        """The report on the present joints once this tab has shown a finding of it, else None."""
        report = obj.validation.report
        return next((r for r in self._looked_at if r is report), None)

    def show_worst(self) -> None:
        """Show the worst pose of the worst joint, once the checks are done."""
        obj = self._tab.selection.need_object()
        report = obj.validation.report
        self._wanted = obj.record.id if report is None else None
        if report is not None and report.severity != Severity.OK:
            self.show(report.joints[0].joint)

    def show_soon(self, obj: OpenObject) -> None:
        """Do so once the object is drawn."""
        self._wanted = obj.record.id

    def show(self, joint: str) -> None:
        """Show a joint's worst pose and mark the contact."""
        selection = self._tab.selection
        obj = selection.need_object()
        report = obj.validation.report
        verdict = None if report is None else report.of(joint)
        if verdict is None or report is None or obj.document.tree is None:
            raise CommandError(words.STILL_CHECKING)
        selection.choose_joint(verdict.child)
        self._shown = (report, joint)
        if verdict.severity != Severity.OK and self.looked_at(obj) is None:
            self._looked_at.append(report)
        worst = verdict.worst
        if worst is None:
            self._motion.show_moment(None, "")
            self._tab.notify(words.NO_POSE, verdict.message, "gray")
        else:
            self._motion.show_moment(worst, words.moment(worst.kind, worst.depth))

    def show_next(self) -> None:
        """Show the worst pose of the next joint with findings (Tab)."""
        report = self._tab.selection.need_object().validation.report
        if report is None:
            raise CommandError(words.STILL_CHECKING)
        found = [j.joint for j in report.joints if j.severity != Severity.OK]
        if not found:
            self._tab.notify(*words.ALL_OK, "gray")
            return
        before = self._shown[1] if self._shown is not None and self._shown[0] is report else None
        at = found.index(before) if before in found else -1
        self._tab.selection.set_step("Review")
        self.show(found[(at + 1) % len(found)])

    def _fix(self, joint: str, kind: FixKind) -> None:
        tab = self._tab
        obj = tab.selection.need_object()
        fix = obj.validation.fix(joint, kind)
        self._motion.reset()
        if fix.joint is not None:
            tab.do(cmd.SetJoint(fix.joint))
        else:
            obj.preparing.turn(np.diag([fix.scale] * 3 + [1.0]), fix.message, tab.user)
        tab.notify(words.FIXED, words.fixed(fix.message), "green")

    # --- drawing

    def draw(self, obj: OpenObject, doc: Document) -> None:
        """Bring the view up to date."""
        report = obj.validation.report
        there = report is not None and self._drawn()
        if self._wanted is not None and (there or self._wanted != obj.record.id):
            wanted, self._wanted = self._wanted, None
            if wanted == obj.record.id:
                self._tab.act(self.show_worst)
        line = headline(obj, doc, report)
        put(self._headline, content=line, visible=bool(line))
        if self._shown is not None and self._shown[0] is not report:
            # The joints have changed, and what was shown with them.
            self._shown = None
            self._motion.clear_moment()
        edited = doc.review.state != "accepted"
        key = None if report is None else (report, tuple(doc.part_names.items()), edited)
        if key == self._key:
            return
        self._key = key
        for row in self._rows:
            row.remove()
        self._rows = []
        found = _groups(doc, report)
        put(self._folder, visible=bool(found))
        with self._folder:
            for group in found[:SHOWN]:
                self._add_row(doc, group)
            if len(found) > SHOWN:
                more = self._tab.client.gui.add_markdown(words.more_findings(len(found) - SHOWN))
                self._rows.append(more)

    def _add_row(self, doc: Document, group: tuple[JointReport, ...]) -> None:
        tab, gui, report = self._tab, self._tab.client.gui, group[0]
        joint, following = report.joint, cycle([j.joint for j in group])
        titles = [joint_title(doc, j.child) for j in group]
        button = gui.add_button(
            words.finding(report.severity, titles),
            color=palette.SEVERITY_COLORS[report.severity],
            hint=words.SHOW_WORST,
        )
        button.on_click(lambda _: tab.act(lambda: self.show(next(following))))
        lines = [plain(f.message, 200) for f in report.findings[:3]]
        if len(group) > 2:
            lines.append(words.also(plain(", ".join(titles[2:]), 200)))
        self._rows += [button, gui.add_markdown("  \n".join(lines))]
        if report.fixes and doc.review.state != "accepted":
            kinds: dict[str, FixKind] = {
                f"{words.FIXES[f.kind]} {f.value}".strip(): f.kind for f in report.fixes
            }
            hint = " ".join(f.message for f in report.fixes)
            fixes = gui.add_button_group(words.FIX, tuple(kinds), hint=hint)
            fixes.on_click(lambda e: tab.act(lambda: self._fix(joint, kinds[e.target.value])))
            self._rows.append(fixes)


def _of(
    doc: Document, report: ValidationReport, severity: Severity
) -> Sequence[tuple[JointReport, ...]]:
    """The groups of a severity that are counted and listed; joints that are OK one by one."""
    if severity == Severity.OK:
        return [(j,) for j in report.joints_with(severity)]
    return alike(doc, report, severity)


def _groups(doc: Document, report: ValidationReport | None) -> list[tuple[JointReport, ...]]:
    if report is None:
        return []
    groups = [g for s in reversed(Severity) for g in _of(doc, report, s)]
    return [g for g in groups if g[0].findings]


def headline(obj: OpenObject, doc: Document, report: ValidationReport | None) -> str:
    """The result of the checks in one line."""
    if doc.tree is None:
        return ""
    if report is None:
        if obj.validation.problem:
            return words.checks_failed(plain(display_text(doc, obj.validation.problem), 200))
        fraction, message = obj.busy.get("check", (0.0, ""))
        return words.checking(fraction, plain(display_text(doc, message)))
    line = words.checks({s: len(_of(doc, report, s)) for s in reversed(Severity)})
    if report.physics is not None and not report.physics.ran:
        line += f"  \n{words.no_physics(plain(report.physics.problem, 160))}"
    return line


class Exporting(Dialog):
    """Asks how to export, and has it done.

    Args:
        workspace: gets the exported files, in its folder ``exports``.
        project: whose settings the dialog begins with.
    """

    def __init__(self, tab: Tab, bulk: BulkWork, workspace: Path, project: Project) -> None:
        super().__init__(tab)
        self._bulk, self._project, self._workspace = bulk, project, workspace
        self._exports, self._store = workspace / "exports", workspace / "collision"

    def ask(self, ids: Sequence[int]) -> None:
        """Show the dialog for objects."""
        if not ids:
            raise CommandError(queue_words.NOTHING_TO_EXPORT)
        gui, tab = self._tab.client.gui, self._tab
        author, license = remembered(self._workspace)
        settings = self._project.settings
        author, license = settings.author or author, settings.license or license
        collision = next(k for k, v in queue_words.COLLISIONS.items() if v == settings.collision)
        with self._open(queue_words.title(len(ids))):
            self._formats = {
                name: gui.add_checkbox(
                    format_title(name),
                    name in settings.formats,
                    hint=load_exporter(name).description,
                )
                for name in exporter_names()
            }
            self._collision = gui.add_dropdown(
                queue_words.COLLISION, tuple(queue_words.COLLISIONS), initial_value=collision
            )
            self._check = gui.add_checkbox(queue_words.CHECK, True, hint=queue_words.CHECK_HINT)
            self._package = gui.add_checkbox(
                queue_words.PACKAGE, False, hint=queue_words.PACKAGE_HINT
            )
            self._author = gui.add_text(queue_words.AUTHOR, author or tab.user, visible=False)
            self._license = gui.add_text(
                queue_words.LICENSE, license, visible=False, hint=queue_words.LICENSE_HINT
            )
            self._folder = gui.add_text(queue_words.FOLDER, "", hint=queue_words.FOLDER_HINT)
            begin = gui.add_button(queue_words.BEGIN, icon=viser.Icon.DOWNLOAD, color="blue")
            self._add_close(queue_words.CLOSE)
        tab.on_update(self._package, self._package_chosen)
        begin.on_click(lambda _: tab.act(lambda: self._begin(list(ids))))

    def _package_chosen(self) -> None:
        self._author.visible = self._license.visible = self._package.value

    def _begin(self, ids: list[int]) -> None:
        formats = [name for name, box in self._formats.items() if box.value]
        package = None
        if self._package.value:
            if not (self._author.value.strip() and self._license.value.strip()):
                raise CommandError(queue_words.NEED_PACKAGE)
            package = AboutPackage(self._author.value.strip(), self._license.value.strip())
            remember(self._workspace, package)
            formats = list(dict.fromkeys([*formats, "usd"]))
        if not formats:
            raise CommandError(queue_words.NO_FORMAT)
        physics = physics_settings(queue_words.COLLISIONS[self._collision.value])
        name = self._folder.value.strip()
        out = self._exports / (name or f".{secrets.token_hex(8)}")
        if name and not re.fullmatch(r"\w[\w.-]{0,99}", name):
            raise CommandError(queue_words.BAD_NAME)
        try:
            out.mkdir(parents=True)  # at once, so that nobody else takes it
        except FileExistsError:
            raise CommandError(queue_words.TAKEN) from None
        check, store = self._check.value, self._store

        def task_of(asset: Path) -> ExportTask:
            base = out if len(ids) == 1 else out / asset.name
            folders = tuple((f, base / f if len(formats) > 1 else base) for f in formats)
            return ExportTask(asset, folders, physics, store, check, package=package)

        def done() -> None:
            if name:
                self._tab.notify(
                    queue_words.EXPORT, queue_words.written(str(out)), "green", elsewhere=True
                )
                return
            try:
                send_folder(self._tab, out, f"artiworld_{'_'.join(formats)}")
            finally:
                shutil.rmtree(out, ignore_errors=True)

        self._bulk.export(ids, task_of, self._notify, done)
        self.close()

    def _notify(self, title: str, text: str, color: str) -> None:
        self._tab.notify(title, text, color, elsewhere=True)


def physics_settings(collision: str) -> PhysicsSettings:
    """Settings with a method of collision: "" for the default, "none" for no shapes."""
    if collision == "none":
        return PhysicsSettings(collision=None)
    if not collision:
        return PhysicsSettings()
    method = cast("Method", collision)
    return PhysicsSettings(collision=CollisionSettings(method=method), declared_shapes=False)


def send_folder(tab: Tab, folder: Path, name: str) -> None:
    """Send a folder as a zip, in which it has that name.

    Raises:
        CommandError: where it is too large.
    """
    with zipped(folder, name) as file:
        tab.client.send_file_download(f"{name}.zip", file.read(), save_immediately=True)
