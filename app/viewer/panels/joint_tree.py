"""The kinematic tree: a click chooses a joint, a part dropped on another one hangs on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import viser

from app.server.display_names import holds_part, joint_title, moved_part, part_title
from app.server.validating import JointCollision
from app.viewer.panels.joint_text import confidence_text, range_text, range_warnings
from app.viewer.panels.markup import Presses, button, icon
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.words import joints as words
from model.core.errors import CommandError
from model.core.tree import KinematicTree, moving_chain
from sessions import commands as cmd
from sessions.document import Document


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
        put(self._rows, "visible", tree is not None)
        if tree is not None:
            chosen = self._tab.selection.child
            html = tree_html(tree, doc, checks, chosen, asking=self._asking())
            put(self._rows, "content", html)


def tree_html(
    tree: KinematicTree,
    doc: Document,
    checks: list[JointCollision],
    chosen: str | None,
    *,
    asking: bool = False,
) -> str:
    """The tree as rows that can be clicked and dragged."""
    hits = {c.joint for c in checks}
    accepted = doc.review.state == "accepted"
    depth = {tree.root: 0}
    rows = []
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is None:
            title, said = part_title(doc, link), ""
        else:
            depth[link] = depth[joint.parent] + 1
            kind = f"{joint.type} {range_text(joint)}" if joint.limited else joint.type
            title = joint_title(doc, link)
            said = words.tree_line(
                kind, confidence_text(doc, link), link in doc.locked,
                bool(range_warnings(joint)), joint.name in hits,
            )  # fmt: skip
        movable = joint is not None and not accepted
        rows.append(_row(tree, link, title, said, depth[link], link == chosen, movable, asking))
    return f'<div class="aw-tree">{"".join(rows)}</div>'


def _row(
    tree: KinematicTree, link: str, title: str, said: str, depth: int, chosen: bool,
    movable: bool, asking: bool,
) -> str:  # fmt: skip
    part = (moved_part(tree, link) if link in tree.joint_of else link).removeprefix("link_")
    color = palette.part_color(int(part)) if part.isdigit() else palette.GHOST
    content = (
        f'<i style="background:rgb{color}"></i>'
        f"<span><b>{escape(title[:60])}</b> <small>{escape(said)}</small></span>"
    )
    row = button("joint", link, f"{title} {said}".strip(), content=content, pressed=chosen)
    if chosen and movable:
        row += button(
            "joint parent", "", words.SET_PARENT, content=icon(viser.Icon.HIERARCHY_2),
            style="aw-icon", pressed=asking,
        )  # fmt: skip
    drag = ' draggable="true"' if movable else ""
    return (
        f'<div class="aw-node" data-link="{escape(link)}" style="--depth:{depth}"{drag}>{row}</div>'
    )
