"""The joints of a scene's selected object: each in the color that its part has in the picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from app.server.display_names import joint_title, moved_part
from app.server.scene_rows import Work
from app.viewer.panels.joint_text import confidence_of, confidence_text, range_text
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from app.viewer.words.common import EDITED
from sessions.document import Document

SHOWN = 12
"""Joints with buttons, those of lowest confidence; the others are counted."""


JointLine = tuple[str, str, palette.Rgb]
"""Name, words and color of a joint."""


class JointRows:
    """A button for each moving joint; a click plays it alone."""

    def __init__(self, tab: Tab, play: Callable[[str], None]) -> None:
        """Make the folder; ``play`` gets the name of the joint that was clicked."""
        self._tab, self._play = tab, play
        self._key: Any = None
        self._rows: list[Any] = []
        self._folder = tab.client.gui.add_folder(words.JOINTS, visible=False)

    def draw(self, work: Work | None) -> None:
        """Bring the rows up to date; nothing is sent where nothing changed."""
        doc = None if work is None else work.document
        key = None if doc is None or work is None else (
            work.id, doc.tree, doc.prediction, tuple(doc.part_names.items()))  # fmt: skip
        if key == self._key:
            return
        self._key = key
        for row in self._rows:
            row.remove()
        self._rows = []
        lines = [] if doc is None else joint_lines(doc)
        put(self._folder, "visible", bool(lines))
        tab, gui = self._tab, self._tab.client.gui
        with self._folder:
            for name, line, color in [] if doc is None else least_confident(doc, lines):
                button = gui.add_button(line, color=color, hint=words.PLAY_JOINT)
                button.on_click(lambda _, name=name: tab.act(lambda: self._play(name)))
                self._rows.append(button)
            if len(lines) > SHOWN:
                self._rows.append(gui.add_markdown(words.more_joints(len(lines) - SHOWN)))


def least_confident(doc: Document, lines: Sequence[JointLine]) -> list[JointLine]:
    """The lines of lowest confidence, in the order of the joints."""
    joints = [j for j in (() if doc.tree is None else doc.tree.joints) if j.moves]
    sure = [
        1.0 if j.child in doc.edited_joints else confidence_of(doc, j.child) or 0.0 for j in joints
    ]  # fmt: skip
    kept = sorted(range(len(lines)), key=sure.__getitem__)[:SHOWN]
    return [lines[i] for i in sorted(kept)]


def joint_lines(doc: Document) -> list[JointLine]:
    """Name, words and color of every joint that moves; a part may have several."""
    out: list[JointLine] = []
    if doc.tree is None:
        return out
    for joint in (j for j in doc.tree.joints if j.moves):
        part = moved_part(doc.tree, joint.child)
        sure = confidence_text(doc, joint.child)
        edited = EDITED * (joint.child in doc.edited_joints)
        # "unlimited" implies the type, and a long line loses its end, the confidence.
        kind = "" if joint.type == "continuous" else joint.type
        texts = [joint_title(doc, joint.child)[:40] + edited, kind, range_text(joint), sure]
        number = part.removeprefix("link_")
        color = palette.part_color(int(number)) if number.isdigit() else palette.GHOST
        out.append((joint.name, " · ".join(t for t in texts if t), color))
    return out
