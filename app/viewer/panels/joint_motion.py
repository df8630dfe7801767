"""Fields of the selected part's motion: screw, ball and others, and what its joint follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from app.server.names import joint_title, moved_part
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import joints as words
from app.viewer.words.common import NONE
from model.core.composite_joints import Composite, composite_of
from model.core.errors import CommandError
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from sessions import commands as cmd
from sessions.tree_edits import holds_part


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
        pitch = self._pitch.value / 1000 if kind == "screw" else 0.0
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
        titles = {kind: title for title, kind in words.MOTIONS.items()}
        put(self._kind, "value", titles[now.kind])
        put(self._pitch, "visible", now.kind == "screw")
        if now.kind == "screw":
            put(self._pitch, "value", round(now.pitch * 1000, 3))
        others = [j for j in tree.joints if j.moves and j.name != joint.name]
        put(self._leader, "options", (NONE, *(joint_title(doc, j.child) for j in others)))
        mimic = joint.mimic
        led = NONE if mimic is None else joint_title(doc, tree.by_name[mimic.joint].child)
        put(self._leader, "value", led)
        if mimic is not None and abs(self._ratio.value - mimic.multiplier) > 5e-4:
            put(self._ratio, "value", round(mimic.multiplier, 4))
        accepted = doc.review.state == "accepted"
        put(self._leader, "visible", joint.moves)
        put(self._ratio, "visible", joint.moves and mimic is not None)
        for widget in (self._kind, self._pitch, self._leader, self._ratio):
            put(widget, "disabled", accepted)
