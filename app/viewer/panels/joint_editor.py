"""The editor of the selected joint: type, parent, axis, origin and limits, by hand or snapped;
screw, ball and other motions, and what the joint follows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser

from app.server import part_tasks
from app.server.jobs import EDITS, WorkerProcess
from app.server.names import joint_title, moved_part, part_title
from app.server.open_object import OpenObject
from app.viewer.panels.joint_tree import axis_name, joint_note, shown
from app.viewer.panels.widgets import differs, put
from app.viewer.picture.motion import Motion
from app.viewer.tab import Tab
from app.viewer.words import joints as words
from app.viewer.words.common import CHOSEN, NONE
from model.core.composite_joints import COMPOSITES, Composite, composite_of
from model.core.errors import CommandError
from model.core.joint import JOINT_TYPES, Joint, Mimic, same_motion
from model.core.tree import KinematicTree, holds_part
from model.io.file_names import FileNames
from sessions import commands as cmd
from sessions.document import Document


class JointMotion:
    """The widgets; edits become ``SetComposite`` and ``SetJoint``."""

    def __init__(self, tab: Tab, on_edit: Callable[[object, Callable[[], None]], None]) -> None:
        """Make the widgets.

        Args:
            on_edit: wires a field to its edit.
        """
        self._tab = tab
        gui = tab.client.gui
        self._kind = gui.add_dropdown(words.MOTION, tuple(words.MOTIONS), hint=words.MOTION_HINT)
        self._pitch = gui.add_number(words.PITCH, words.PITCH_START, step=0.1)
        self._leader = gui.add_dropdown(words.FOLLOWS, (NONE,), hint=words.FOLLOWS_HINT)
        self._ratio = gui.add_number(words.RATIO, 1.0, step=0.01, hint=words.RATIO_HINT)
        on_edit(self._kind, self._set_kind)
        on_edit(self._pitch, self._set_kind)
        on_edit(self._leader, self._follow)
        on_edit(self._ratio, self._follow)

    def _selected(self) -> tuple[KinematicTree, Joint]:
        tree, joint = self._tab.selection.need_object().document.tree, self._tab.selection.joint
        if tree is None or joint is None:
            raise CommandError(words.NEED_JOINT)
        return tree, joint

    def _set_kind(self) -> None:
        tree, joint = self._selected()
        kind = words.MOTIONS[self._kind.value]
        pitch = self._pitch.value / 1000 if COMPOSITES[kind].pitched else 0.0
        self._tab.do(cmd.SetComposite(moved_part(tree, joint.child), Composite(kind, pitch)))  # type: ignore[arg-type]

    def _follow(self) -> None:
        tree, joint = self._selected()
        doc = self._tab.selection.need_object().document
        leader = next(
            (j for j in tree.joints if joint_title(doc, j.child) == self._leader.value), None
        )
        offset = 0.0 if joint.mimic is None else joint.mimic.offset
        mimic = None if leader is None else Mimic(leader.name, self._ratio.value, offset)
        if mimic != joint.mimic:
            self._tab.do(cmd.SetJoint(replace(joint, mimic=mimic)))

    def draw(self, obj: OpenObject, tree: KinematicTree, joint: Joint) -> None:
        """Bring it up to date with the selected joint."""
        doc = obj.document
        part = moved_part(tree, joint.child)
        now = composite_of(tree, part, holds_part)
        put(self._kind, value=COMPOSITES[now.kind].title)
        put(self._pitch, visible=now.pitch != 0)
        if now.pitch:
            put(self._pitch, value=round(now.pitch * 1000, 3))
        others = [j for j in tree.joints if j.moves and j.name != joint.name]
        put(self._leader, options=(NONE, *(joint_title(doc, j.child) for j in others)))
        mimic = joint.mimic
        led = NONE if mimic is None else joint_title(doc, tree.by_name[mimic.joint].child)
        put(self._leader, value=led)
        if mimic is not None and abs(self._ratio.value - mimic.multiplier) > 5e-4:
            put(self._ratio, value=round(mimic.multiplier, 4))
        accepted = doc.review.state == "accepted"
        put(self._leader, visible=joint.moves)
        put(self._ratio, visible=joint.moves and mimic is not None)
        for widget in (self._kind, self._pitch, self._leader, self._ratio):
            put(widget, disabled=accepted)


SNAP_SECONDS = 30.0
AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


class JointEditor:
    """The widgets for one joint.

    Attributes:
        pose_box: the place for the slider that moves it.
        several: its fields for motions of several joints, and what it follows.
    """

    def __init__(
        self, tab: Tab, motion: Motion, worker: WorkerProcess, forget: Callable[[], None]
    ) -> None:
        """Make the widgets.

        Args:
            worker: snaps joints to the geometry.
            forget: lets the step draw its fields again, as they may hold what was refused.
        """
        self._tab, self._motion, self._worker, self._forget = tab, motion, worker, forget
        gui = tab.client.gui
        self._child = gui.add_dropdown(words.JOINT, (NONE,))
        self.pose_box = gui.add_folder(None)
        self._note = gui.add_markdown("")
        self._likely = gui.add_button_group(words.LIKELY, (NONE,), hint=words.LIKELY_HINT)
        self._type = gui.add_dropdown(words.TYPE, JOINT_TYPES)
        self.several = JointMotion(tab, self._on_edit)
        self._parent = gui.add_dropdown(words.PARENT, (NONE,))
        self._axis = gui.add_vector3(words.AXIS, (0.0, 0.0, 1.0), step=0.001)
        self._axis_to = gui.add_button_group(words.SET_AXIS, words.SET_AXIS_ACTIONS)
        self._axis_box = gui.add_button_group(
            words.ALIGN_AXIS, tuple(words.ALIGN_AXIS_ACTIONS), hint=words.ALIGN_AXIS_HINT
        )
        self._origin = gui.add_vector3(words.ORIGIN, (0.0, 0.0, 0.0), step=0.1)
        self._origin_to = gui.add_button_group(words.SNAP_ORIGIN, tuple(words.SNAP_ORIGIN_ACTIONS))
        self._lower = gui.add_number(words.limit("lower", "°"), 0.0, step=0.1)
        self._upper = gui.add_number(words.limit("upper", "°"), 0.0, step=0.1)
        self._free = gui.add_button_group(
            words.LIMITS, (words.FREE_RANGE, words.CLOSED), hint=words.LIMITS_HINT
        )
        self._gizmo = gui.add_button(words.HANDLES, icon=viser.Icon.AXIS_X, color="gray")
        self._copy = gui.add_button(
            words.COPY, icon=viser.Icon.COPY, color="gray", hint=words.COPY_HINT
        )
        self._name = gui.add_text(words.FILE_NAME, "", hint=words.FILE_NAME_HINT)
        self._locked = gui.add_checkbox(words.LOCK, False, hint=words.LOCK_HINT)
        self._reset = gui.add_button(words.reset_to(False), color="gray")
        numbers = (self._axis, self._origin, self._lower, self._upper)
        others = (self._gizmo, self._copy, self._name, self._locked, self._reset)
        self._edits = (self._type, self._parent, *numbers, *others)
        self._wire()

    def _wire(self) -> None:
        tab, motion = self._tab, self._motion
        choose = tab.selection.choose_joint
        tab.on_update(self._child, lambda: choose(self._link(self._child.value, joint_title)))
        self._on_edit(self._name, lambda: self._change(name=self._name.value.strip()))
        self._on_edit(self._type, lambda: self.set_type(self._type.value))
        self._on_edit(self._parent, lambda: self._change(parent=self._link(self._parent.value)))
        self._on_edit(self._axis, lambda: self._change(axis=tuple(self._axis.value)))
        self._on_edit(
            self._origin, lambda: self._change(origin=tuple(v / 1000 for v in self._origin.value))
        )
        self._on_edit(self._lower, lambda: self._limit("lower", self._lower.value))
        self._on_edit(self._upper, lambda: self._limit("upper", self._upper.value))
        tab.on_update(self._locked, self._lock)
        self._likely.on_click(lambda e: tab.act(lambda: self._take_likely(e.target.value)))
        self._axis_to.on_click(lambda e: tab.act(lambda: self._preset(e.target.value)))
        self._axis_box.on_click(
            lambda e: tab.act(lambda: self._snap(words.ALIGN_AXIS_ACTIONS[e.target.value]))
        )
        self._origin_to.on_click(
            lambda e: tab.act(lambda: self._snap(words.SNAP_ORIGIN_ACTIONS[e.target.value]))
        )
        self._free.on_click(lambda e: tab.act(lambda: self._limits(e.target.value)))
        self._gizmo.on_click(lambda _: tab.act(motion.toggle_handles))
        self._copy.on_click(lambda _: tab.act(self.copy_to_equal))
        self._reset.on_click(
            lambda _: tab.act(lambda: tab.do(cmd.ResetJoint(self._need_joint().child)))
        )

    # --- what the user does

    def _on_edit(self, field: Any, edit: Callable[[], None]) -> None:
        """After an edit the field shows what the joint has, even where the edit was refused."""

        def edited() -> None:
            try:
                edit()
            finally:
                self._forget()

        self._tab.on_update(field, edited)

    def _need_joint(self) -> Joint:
        joint = self._tab.selection.joint
        if joint is None:
            raise CommandError(words.NEED_JOINT)
        return joint

    def _set(self, joint: Joint) -> None:
        self._tab.do(cmd.SetJoint(joint))

    def _link(self, title: str, called: Callable[[Document, str], str] = part_title) -> str:
        """The link that, or whose joint, people call so."""
        doc = self._tab.selection.need_object().document
        for link in () if doc.tree is None else doc.tree.links:
            if called(doc, link) == title:
                return link
        raise CommandError(words.gone(title))

    def _change(self, **changes: Any) -> None:
        joint = self._need_joint()
        if any(_differs(getattr(joint, k), v) for k, v in changes.items()):
            self._set(replace(joint, **changes))

    def set_type(self, kind: Any) -> None:
        """Give the selected joint another type, with the axis, origin and limits that it then has:
        as predicted where the prediction was of that type, else as the geometry says."""
        obj, joint = self._tab.selection.need_object(), self._need_joint()
        doc = obj.document
        if kind == joint.type:
            return
        predicted = None if doc.prediction is None else doc.prediction.joint(joint.child)
        if predicted is not None and (predicted.type, predicted.parent) == (kind, joint.parent):
            self._set(replace(predicted, name=joint.name))
            return
        assert doc.tree is not None
        job = self._worker.submit(
            part_tasks.change_type, obj.source(), doc.tree, joint.child, kind, priority=EDITS
        )
        self._set(job.result(SNAP_SECONDS))

    def next_type(self) -> None:
        """The next type in the list (T)."""
        at = JOINT_TYPES.index(self._need_joint().type)
        self.set_type(JOINT_TYPES[(at + 1) % len(JOINT_TYPES)])

    def next_likely(self) -> None:
        """The next of the motions that the prediction finds likely (M)."""
        joint, found = self._need_joint(), self._likely_joints()
        if len(found) < 2:
            raise CommandError(words.ONE_LIKELY)
        at = next((k for k, j in enumerate(found) if _same(j, joint)), -1)
        self._set(replace(found[(at + 1) % len(found)], name=joint.name))

    def _take_likely(self, label: str) -> None:
        joint = self._need_joint()
        number = int(label.removeprefix(CHOSEN).split()[0])
        self._set(replace(self._likely_joints()[number - 1], name=joint.name))

    def _likely_joints(self) -> tuple[Joint, ...]:
        return self._tab.selection.need_object().document.likely_joints(self._need_joint())

    def copy_to_equal(self) -> None:
        """Give the parts of the same shape the selected joint, as one step."""
        obj, joint = self._tab.selection.need_object(), self._need_joint()
        doc = obj.document
        assert doc.tree is not None
        job = self._worker.submit(
            part_tasks.joints_like, obj.source(), doc.tree, joint.child, doc.locked, priority=EDITS
        )
        found: tuple[Joint, ...] = job.result(SNAP_SECONDS)
        if not found:
            self._tab.notify(words.UNCHANGED, words.NONE_EQUAL, "gray")
            return
        self._tab.do(cmd.SetJoint(joint, found))
        titles = ", ".join(joint_title(doc, j.child) for j in found)
        self._tab.notify(words.COPIED, words.copied(titles), "green")

    def flip(self) -> None:
        """Turn the axis round; the limits stay, so the part opens to the other side (F)."""
        joint = self._need_joint()
        axis = tuple(-v if v else 0.0 for v in joint.axis)
        self._set(replace(joint, axis=axis))

    def _preset(self, which: str) -> None:
        if which == words.SET_AXIS_ACTIONS[3]:
            self.flip()
        else:
            self._change(axis=AXES[which])

    def _snap(self, to: str) -> None:
        obj = self._tab.selection.need_object()
        joint, tree = self._need_joint(), obj.document.tree
        assert tree is not None
        job = self._worker.submit(
            part_tasks.snap_joint, obj.source(), tree, joint.child, to, priority=EDITS
        )
        snapped = job.result(SNAP_SECONDS)
        if snapped == joint:
            self._say_unchanged(to)
        else:
            self._set(snapped)

    def _say_unchanged(self, to: str) -> None:
        text = words.ALREADY_THERE.get(to, words.ALREADY_ALIGNED)
        self._tab.notify(words.UNCHANGED, text, "gray")

    def _limit(self, which: str, value: float) -> None:
        joint = self._need_joint()
        before = getattr(joint, which)
        if before is not None and value != round(shown(joint, before), 1):
            self._change(**{which: math.radians(value) if joint.rotates else value / 1000})

    def _limits(self, what: str) -> None:
        joint = self._need_joint()
        if not joint.limited:
            raise CommandError(words.no_limits(joint.type))
        assert joint.lower is not None and joint.upper is not None
        if what == words.FREE_RANGE:
            self._snap("free range")
        elif 0.0 in (joint.lower, joint.upper):
            self._say_unchanged("closed")
        elif abs(joint.lower) < abs(joint.upper):
            self._change(lower=0.0)
        else:
            self._change(upper=0.0)

    def _lock(self) -> None:
        joint = self._need_joint()
        doc = self._tab.selection.need_object().document
        if self._locked.value != (joint.child in doc.locked):
            self._tab.do(cmd.LockJoint(joint.child, self._locked.value))

    # --- drawing

    def draw(self, obj: OpenObject, tree: KinematicTree) -> None:
        """Bring it up to date."""
        doc = obj.document
        titles = tuple(joint_title(doc, j.child) for j in tree.joints) or (NONE,)
        put(self._child, options=titles)
        joint = self._tab.selection.joint
        if joint is None:
            put(self._note, content=words.NO_JOINT)
            return
        put(self._child, value=joint_title(doc, joint.child))
        called = {p.link: p.name for p in doc.parts}
        names = {link: called.get(link) for link in tree.links if holds_part(link)}
        files = FileNames.of_tree(tree, names, doc.category)
        put(self._name, value=files.joints.get(joint.name, joint.name))
        put(self._type, value=joint.type)
        found = doc.likely_joints(joint)
        put(self._likely, visible=len(found) > 1 and doc.review.state != "accepted")
        if len(found) > 1:
            labels = (words.likely(k, j.type, axis_name(j)) for k, j in enumerate(found, 1))
            marks = (CHOSEN * _same(j, joint) for j in found)
            put(self._likely, options=tuple(map("".join, zip(marks, labels, strict=True))))
        self.several.draw(obj, tree, joint)
        below = tree.descendants(joint.child)
        above = tuple(part_title(doc, k) for k in tree.links if k not in below)
        put(self._parent, options=above, value=part_title(doc, joint.parent))
        _put_vector(self._axis, joint.axis, 5e-4)
        _put_vector(self._origin, tuple(v * 1000 for v in joint.origin), 0.05)
        unit = "°" if joint.rotates else "mm"
        for box, word, value in (
            (self._lower, "lower", joint.lower),
            (self._upper, "upper", joint.upper),
        ):
            put(box, label=words.limit(word, unit), visible=joint.limited)
            if value is not None:
                put(box, value=round(shown(joint, value), 1))
        accepted = doc.review.state == "accepted"
        for widget in (self._axis, self._origin, self._gizmo):
            put(widget, visible=joint.moves)
        for row in (self._axis_to, self._axis_box, self._origin_to):  # they can't be disabled
            put(row, visible=joint.moves and not accepted)
        for widget in self._edits:
            put(widget, disabled=accepted)
        put(self._free, visible=joint.limited and not accepted)
        put(self._gizmo, color="pink" if self._motion.handles.on else "gray")
        put(self._locked, value=joint.child in doc.locked)
        put(self._reset, label=words.reset_to(doc.joints_file is not None))
        put(self._reset, visible=joint.child in doc.edited_joints)
        put(self._note, content=joint_note(joint, doc, obj.checks))


def _same(a: Joint, b: Joint) -> bool:
    return (a.type, a.parent) == (b.type, b.parent) and same_motion(a, b, 1e-3, 1e-3)


def _differs(a: Any, b: Any) -> bool:
    if isinstance(a, tuple):
        return differs(a, b, 1e-7)
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) > 1e-9
    return a != b


def _put_vector(box: Any, value: tuple[float, ...], tolerance: float) -> None:
    if differs(tuple(box.value), value, tolerance):
        # A trace of the other side would be shown as "-0.000".
        box.value = tuple(0.0 if abs(v) < tolerance else round(v, 4) for v in value)
