"""The newest decisions about the open object."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from app.server.display_names import display_text, part_title
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.text import plain
from app.viewer.words import review as words
from app.viewer.words.annotate import tool_label
from sessions import commands as cmd
from sessions.describe import describe
from sessions.document import Document
from sessions.tool_commands import ApplyTool

SHOWN = 12


class History:
    """A closed folder with a line for each decision."""

    def __init__(self, tab: Tab) -> None:
        self._drawn: Any = None
        with tab.client.gui.add_folder(words.HISTORY, expand_by_default=False):
            self._lines = tab.client.gui.add_markdown("")

    def draw(self, obj: OpenObject) -> None:
        """Bring the lines up to date; they are read only where something was decided."""
        now = obj.record.id, obj.state.seq, obj.document.tree
        if now == self._drawn:
            return
        self._drawn = now
        entries = obj.services.store.history(obj.record.id)[-SHOWN:]
        lines = [
            f"- {plain(e.at[11:19])} {plain(e.who, 24)}: "
            f"{plain(what_happened(obj.document, e.command), 80)}"
            for e in reversed(entries)
        ]
        put(self._lines, "content", "\n".join(lines) or words.HISTORY_EMPTY)


def what_happened(doc: Document, command: cmd.Command) -> str:
    """One line of the history, in the words of the screens."""
    if isinstance(command, cmd.SetJoint):
        return words.joint_changed(part_title(doc, command.joint.child))
    if isinstance(command, ApplyTool):
        command = replace(command, tool=tool_label(command.tool).lower())
    return display_text(doc, describe(command))
