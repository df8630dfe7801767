"""Words of people about the open object: the project's instructions, the newest decisions, and the
comments of reviewers with their markers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import viser

from app.server.names import display_text, joint_title, part_title
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import Presses, button, icon, put
from app.viewer.picture.marks import CommentMark, CommentMarks, Point
from app.viewer.picture.stage import aim
from app.viewer.tab import Tab, markdown_html, plain
from app.viewer.words import annotate as annotate_words
from app.viewer.words import review as words
from app.viewer.words.annotate import tool_label
from sessions import commands as cmd
from sessions.document import CommentRecord, Document
from sessions.project_settings import Project
from sessions.tool_commands import ApplyTool


class Instructions:
    """A button, and below it the text that it unfolds."""

    def __init__(self, tab: Tab, project: Project) -> None:
        self._tab, self._project = tab, project
        self._open, self._read = False, ""
        gui = tab.client.gui
        self._button = gui.add_button(
            annotate_words.INSTRUCTIONS, icon=viser.Icon.NOTEBOOK, color="blue", visible=False
        )
        self._text = gui.add_html("", visible=False)
        self._button.on_click(lambda _: tab.act(self.toggle))

    def toggle(self) -> None:
        """Show or fold the text, in the step that has it."""
        text = self._project.settings.instructions
        if not text:
            self._tab.say(annotate_words.NO_INSTRUCTIONS)
            return
        if self._tab.selection.step != "Annotate":
            self._tab.selection.set_step("Annotate")
            self._open = False
        self._open = not self._open
        self._read = text
        self.draw()

    def draw(self) -> None:
        """Bring them up to date; what the person hasn't read yet is marked."""
        text = self._project.settings.instructions
        put(self._button, visible=bool(text), color="gray" if self._read == text else "blue")
        put(self._text, visible=bool(text) and self._open)
        if self._open:
            html = f'<div class="aw-instructions">{markdown_html(text)}</div>'
            put(self._text, content=html)


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
        put(self._lines, content="\n".join(lines) or words.HISTORY_EMPTY)


def what_happened(doc: Document, command: cmd.Command) -> str:
    """One line of the history, in the words of the screens."""
    if isinstance(command, cmd.SetJoint):
        return words.joint_changed(part_title(doc, command.joint.child))
    if isinstance(command, ApplyTool):
        command = replace(command, tool=tool_label(command.tool).lower())
    return display_text(doc, command.describe())


class Comments:
    """Steps through the comments of the open object and marks them as done.

    Args:
        marks: gives the markers of the picture that is shown now.
    """

    def __init__(self, tab: Tab, presses: Presses, marks: Callable[[], CommentMarks]) -> None:
        self._tab, self._marks = tab, marks
        self._chosen: int | None = None
        self._list = tab.client.gui.add_html("", visible=False)
        presses.on("comment", lambda number: self.choose(int(number)))
        presses.on("comment done", lambda number: self._toggle(int(number)))
        presses.on("comment next", lambda _: self.next())
        tab.selection.on_open(self._forget)

    def _forget(self) -> None:
        self._chosen = None

    def next(self) -> None:
        """Choose the next comment that is open (Shift+C)."""
        comments = self._tab.selection.need_object().document.comments
        open_ones = [c.number for c in comments if not c.done]
        if not open_ones:
            self._tab.say(words.NO_COMMENTS)
            return
        later = [n for n in open_ones if self._chosen is None or n > self._chosen]
        self.choose((later or open_ones)[0])

    def choose(self, number: int) -> None:
        """Show a comment: its text beside its marker, which comes to the middle."""
        selection = self._tab.selection
        doc = selection.need_object().document
        comment = next((c for c in doc.comments if c.number == number), None)
        if comment is None:
            return
        self._chosen = number
        if comment.joint and doc.tree is not None and comment.joint in doc.tree.joint_of:
            selection.choose_joint(comment.joint)
        place = place_of(doc, comment)
        if place is not None:
            camera = self._tab.client.camera
            at = np.asarray(place, np.float64)
            aim(self._tab.client, at + (camera.position - camera.look_at), at, least_near=1e-4)
        self._tab.invalidate()

    def click(self, origin: Point, direction: Point) -> bool:
        """Choose the comment whose marker a ray hits; False where it hits none."""
        number = self._marks().hit(origin, direction)
        if number is not None:
            self.choose(number)
        return number is not None

    def _toggle(self, number: int) -> None:
        comments = self._tab.selection.need_object().document.comments
        if not 1 <= number <= len(comments):
            return
        done = not comments[number - 1].done
        self._tab.do(cmd.ResolveComment(number, done))
        if done and any(not c.done for c in self._tab.selection.need_object().document.comments):
            self.next()

    def draw(self, obj: OpenObject) -> None:
        """Bring list and markers up to date."""
        doc = obj.document
        put(self._list, visible=bool(doc.comments))
        rows = "".join(self._row(doc, c) for c in doc.comments)
        left = sum(not c.done for c in doc.comments)
        head = f"<b>{words.comments_left(left, len(doc.comments))}</b>"
        head += button("comment next", "", words.NEXT_COMMENT, style="aw-small")
        html = f'<div class="aw-comments"><header>{head}</header><ul>{rows}</ul></div>'
        put(self._list, content=html if doc.comments else "")
        self._marks().show(self._wanted(doc))

    def _wanted(self, doc: Document) -> list[CommentMark]:
        marks = []
        for comment in doc.comments:
            place, chosen = place_of(doc, comment), comment.number == self._chosen
            if place is not None and (chosen or not comment.done):
                text = f"{comment.number}: {comment.text[:80]}" if chosen else f"{comment.number}"
                marks.append(CommentMark(comment.number, place, text, chosen))
        return marks

    def _row(self, doc: Document, comment: CommentRecord) -> str:
        about = escape(joint_title(doc, comment.joint)) if comment.joint else ""
        small = " · ".join(filter(None, (about, escape(comment.by))))
        text = escape(comment.text).replace("\n", "<br>")
        content = f"<b>{comment.number}</b><span>{text}<small>{small}</small></span>"
        chosen = comment.number == self._chosen
        label = words.comment_button(comment.number, comment.text[:200])
        row = button(
            "comment",
            str(comment.number),
            label,
            content=content,
            pressed=chosen,
            style="aw-off" if comment.done else "",
        )
        check: Any = viser.Icon.ARROW_BACK_UP if comment.done else viser.Icon.CHECK
        row += button(
            "comment done",
            str(comment.number),
            words.done_button(comment.number, comment.done),
            content=icon(check),
            style="aw-icon",
        )
        return f"<li>{row}</li>"


def place_of(doc: Document, comment: CommentRecord) -> Point | None:
    """(3,) where a comment is shown, at rest: its place, or that of its joint."""
    if comment.place is not None:
        return comment.place
    joint = None if doc.tree is None else doc.tree.joint_of.get(comment.joint)
    return None if joint is None else joint.origin
