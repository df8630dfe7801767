"""The project's instructions, beside the picture."""

from __future__ import annotations

import viser

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.text import markdown_html
from app.viewer.words import annotate as words
from sessions.project_settings import Project


class Instructions:
    """A button, and below it the text that it unfolds."""

    def __init__(self, tab: Tab, project: Project) -> None:
        self._tab, self._project = tab, project
        self._open, self._read = False, ""
        gui = tab.client.gui
        self._button = gui.add_button(
            words.INSTRUCTIONS, icon=viser.Icon.NOTEBOOK, color="blue", visible=False
        )
        self._text = gui.add_html("", visible=False)
        self._button.on_click(lambda _: tab.act(self.toggle))

    def toggle(self) -> None:
        """Show or fold the text, in the step that has it."""
        text = self._project.settings.instructions
        if not text:
            self._tab.say(words.NO_INSTRUCTIONS)
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
        put(self._button, "visible", bool(text))
        put(self._button, "color", "gray" if self._read == text else "blue")
        put(self._text, "visible", bool(text) and self._open)
        if self._open:
            html = f'<div class="aw-instructions">{markdown_html(text)}</div>'
            put(self._text, "content", html)
