"""Joints and links in words, a scene's joints as rows, and the kinematic tree: a click chooses a
joint, a part dropped on another one hangs on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any, Final

import viser

from app.server.names import display_text, holds_part, joint_title, moved_part, part_title
from app.server.scene_state import Work
from app.server.validating import JointCollision
from app.viewer.panels.widgets import Presses, button, icon, put
from app.viewer.picture import palette
from app.viewer.tab import Tab, plain
from app.viewer.words import joints as words
from app.viewer.words import scene as scene_words
from app.viewer.words.common import warning
from model.core.errors import CommandError
from model.core.joint import Joint, value_text
from model.core.tree import KinematicTree, moving_chain
from sessions import commands as cmd
from sessions.document import Document

_NEARLY: Final = 0.97
"""Least cosine between an axis and the one that it is called after."""


def shown(joint: Joint, q: float) -> float:
    """Degrees or millimetres."""
    return math.degrees(q) if joint.rotates else 1000 * q


def range_text(joint: Joint) -> str:
    """The range of a joint with its unit."""
    if joint.type == "continuous":
        return words.UNLIMITED
    if not joint.limited:
        return ""
    assert joint.lower is not None and joint.upper is not None
    lower = value_text(joint.lower, joint.rotates).rstrip("° m")
    return words.span(lower, value_text(joint.upper, joint.rotates))


def confidence_text(doc: Document, child: str) -> str:
    """Confidence of a joint's prediction, or that a user edited the joint."""
    if child in doc.edited_joints:
        return words.EDITED
    if any(joint.child == child for joint in doc.new_joints):
        return words.NEW
    share = confidence_of(doc, child)
    return "" if share is None else words.confidence(share)


def confidence_of(doc: Document, child: str) -> float | None:
    """Confidence of a joint's prediction, 0..1; None where nothing was predicted."""
    known = {} if doc.prediction is None else doc.prediction.confidence
    # All joints of a part are one prediction.
    part = child if doc.tree is None else moved_part(doc.tree, child)
    return known.get(child, known.get(part))


def axis_name(joint: Joint) -> str:
    """The axis as "X" or "-Z"; "" for another direction, or a joint that doesn't move."""
    largest = max(range(3), key=lambda k: abs(joint.axis[k]))
    if not joint.moves or abs(joint.axis[largest]) < _NEARLY:
        return ""
    return f"{'-' if joint.axis[largest] < 0 else ''}{'XYZ'[largest]}"


def range_warnings(joint: Joint) -> list[str]:
    """Warnings about the range of a joint."""
    if not joint.limited:
        return []
    assert joint.lower is not None and joint.upper is not None
    out = []
    if joint.rotates and max(abs(joint.lower), abs(joint.upper)) > 2 * math.pi + 1e-6:
        out.append(words.BEYOND_A_TURN)
    if joint.lower > 1e-6 or joint.upper < -1e-6:
        out.append(words.SCAN_OUTSIDE)
    return out


def joint_note(joint: Joint, doc: Document, checks: list[JointCollision]) -> str:
    """Explanation of the joint's values, and the collisions of its sweep."""
    lines = []
    if doc.prediction is not None:
        note = doc.prediction.notes.get(joint.child)
        text = f"*{plain(display_text(doc, note), 300)}*" if note else ""
        if joint != doc.prediction.joint(joint.child):
            text = words.edited(plain(doc.joints_file or ""), text)
        lines += [text] if text else []
    lines += [warning(text) for text in range_warnings(joint)]
    for check in checks:
        if check.joint == joint.name:
            at = value_text(check.q, joint.rotates)
            other = plain(part_title(doc, check.other)) if check.other else ""
            lines.append(words.collision(other, at, 1000 * check.depth))
    return "\n\n".join(lines) or words.SET_MANUALLY


class JointRows:
    """The tree of an object of the scene; a click plays a joint alone."""

    def __init__(self, tab: Tab, presses: Presses, play: Callable[[str], None]) -> None:
        """Make the folder; ``play`` gets the name of the joint that was clicked."""
        self._play, self._tree = play, None
        self._folder = tab.client.gui.add_folder(scene_words.JOINTS, visible=False)
        with self._folder:
            self._rows = tab.client.gui.add_html("")
        presses.on("play joint", self._clicked)

    def _clicked(self, link: str) -> None:
        joint = None if self._tree is None else self._tree.joint_of.get(link)
        if joint is not None and joint.moves:
            self._play(joint.name)

    def draw(self, work: Work | None) -> None:
        """Bring the rows up to date; nothing is sent where nothing changed."""
        self._tree = None if work is None else work.document.tree
        put(self._folder, visible=self._tree is not None)
        if work is not None and self._tree is not None:
            html = tree_html(self._tree, work.document, [], None, action="play joint")
            put(self._rows, content=html)


class JointTree:
    """The rows of one tab.

    Args:
        asking: whether the next part that is chosen becomes the parent of the selected one.
        ask: lets the next click choose it, or no longer.
    """

    def __init__(
        self, tab: Tab, presses: Presses, asking: Callable[[], bool], ask: Callable[[], None]
    ) -> None:
        self._tab, self._asking, self._ask = tab, asking, ask
        self._rows: Any = tab.client.gui.add_html("")
        presses.on("joint", self._clicked)
        presses.on("joint parent", lambda _: ask())
        presses.on("joint move", lambda links: self.hang(*links.split(">", 1)))

    def _clicked(self, link: str) -> None:
        selection = self._tab.selection
        tree = selection.need_object().document.tree
        if self._asking() and selection.child is not None:
            self._ask()  # it is answered
            self.hang(selection.child, link)
        elif tree is not None and link in tree.joint_of:
            selection.choose_joint(link)

    def hang(self, child: str, parent: str) -> None:
        """Hang the part that the joint of ``child`` moves, with all its joints, on another link.

        Raises:
            CommandError: where the part carries that link, or one of them is gone.
        """
        doc = self._tab.selection.need_object().document
        tree = doc.tree
        if tree is None or child not in tree.joint_of or parent not in tree.links:
            raise CommandError(words.gone(part_title(doc, child)))
        first = moving_chain(tree, child, holds_part)[0]
        if parent == first or parent in tree.descendants(first):
            raise CommandError(
                words.carries(part_title(doc, moved_part(tree, child)), part_title(doc, parent))
            )
        if tree.joint_of[first].parent != parent:
            self._tab.do(cmd.SetJoint(replace(tree.joint_of[first], parent=parent)))

    def draw(self, doc: Document, checks: list[JointCollision]) -> None:
        """Bring the rows up to date; nothing is there without joints."""
        tree = doc.tree
        put(self._rows, visible=tree is not None)
        if tree is not None:
            chosen = self._tab.selection.child
            html = tree_html(tree, doc, checks, chosen, asking=self._asking())
            put(self._rows, content=html)


def tree_html(
    tree: KinematicTree,
    doc: Document,
    checks: list[JointCollision],
    chosen: str | None,
    *,
    asking: bool = False,
    action: str = "joint",
) -> str:
    """The tree as rows that can be clicked and, where that chooses a joint, dragged."""
    hits = {c.joint for c in checks}
    fixed = doc.review.state == "accepted" or action != "joint"
    depth = {tree.root: 0}
    rows = []
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is None:
            title, said = part_title(doc, link), ""
        else:
            depth[link] = depth[joint.parent] + 1
            kind = f"{joint.type} {range_text(joint)}" if joint.limited else joint.type
            if joint.mimic is not None:
                leader = joint_title(doc, tree.by_name[joint.mimic.joint].child)
                kind = f"{words.follows(leader)} · {kind}"
            title = joint_title(doc, link)
            said = words.tree_line(
                kind,
                confidence_text(doc, link),
                link in doc.locked,
                bool(range_warnings(joint)),
                joint.name in hits,
            )
        movable = joint is not None and not fixed
        row = _row(tree, link, action, title, said, link == chosen, movable, asking)
        drag = ' draggable="true"' if movable else ""
        about = f'data-link="{escape(link)}" style="--depth:{depth[link]}"{drag}'
        rows.append(f'<div class="aw-node" {about}>{row}</div>')
    return f'<div class="aw-tree">{"".join(rows)}</div>'


def _row(
    tree: KinematicTree,
    link: str,
    action: str,
    title: str,
    said: str,
    chosen: bool,
    movable: bool,
    asking: bool,
) -> str:
    color = palette.link_color(moved_part(tree, link) if link in tree.joint_of else link)
    content = (
        f'<i style="background:rgb{color}"></i>'
        f"<span><b>{escape(title[:60])}</b> <small>{escape(said)}</small></span>"
    )
    row = button(action, link, f"{title} {said}".strip(), content=content, pressed=chosen)
    if chosen and movable:
        row += button(
            "joint parent",
            "",
            words.SET_PARENT,
            content=icon(viser.Icon.HIERARCHY_2),
            style="aw-icon",
            pressed=asking,
        )
    return row
