"""The dialogs of a project's settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.viewer.tab import Tab
from app.viewer.words import project as words
from app.viewer.words import queue as export_words
from model.io.export.registry import exporter_names
from sessions.project_settings import Project, labels_from_text, labels_to_text


class ProjectDialogs:
    """Instructions and labels in one dialog, checks and export in the other.

    Args:
        changed: is called once settings changed, so that all screens are drawn.
    """

    def __init__(self, tab: Tab, project: Project, changed: Callable[[], None]) -> None:
        self._tab, self._project, self._changed = tab, project, changed
        self._modal: Any = None

    def show(self, which: str) -> None:
        """Show a dialog: "labels" or "checks"."""
        self.close()
        gui, tab = self._tab.client.gui, self._tab
        fill = self._checks if which == "checks" else self._labels
        self._modal = gui.add_modal({w: label for w, label, _ in words.DIALOGS}[which])
        with self._modal:
            fields = fill(gui)
            save = gui.add_button(words.SAVE, icon=viser.Icon.CHECK, color="blue")
            close = gui.add_button(words.CANCEL, color="gray")
        save.on_click(lambda _: tab.act(lambda: self._save(fields())))
        close.on_click(lambda _: self._close_clicked())

    def _labels(self, gui: Any) -> Callable[[], dict[str, Any]]:
        known = self._project.settings
        name = gui.add_text(words.NAME, known.name)
        text = gui.add_text(
            words.INSTRUCTIONS, known.instructions, multiline=True, hint=words.MARKDOWN
        )
        labels = gui.add_text(
            words.LABELS, labels_to_text(known.labels), multiline=True, hint=words.LABELS_HINT
        )
        gui.add_markdown(words.LABELS_HINT)
        strict = gui.add_checkbox(words.STRICT, known.strict, hint=words.STRICT_HINT)
        return lambda: {
            "name": name.value, "instructions": text.value,
            "labels": labels_from_text(labels.value), "strict": strict.value,
        }  # fmt: skip

    def _checks(self, gui: Any) -> Callable[[], dict[str, Any]]:
        known, collisions = self._project.settings, export_words.COLLISIONS
        gui.add_markdown(words.REQUIRED)
        kinds = {
            kind: gui.add_checkbox(label, kind in known.required)
            for kind, label in words.KINDS.items()
        }
        gui.add_markdown(words.EXPORT)
        formats = {n: gui.add_checkbox(n, n in known.formats) for n in exporter_names()}
        now = next(k for k, v in collisions.items() if v == known.collision)
        collision = gui.add_dropdown(export_words.COLLISION, tuple(collisions), initial_value=now)
        form = gui.add_dropdown(
            words.FORM, tuple(words.FORMS), initial_value=words.form_label(known.form)
        )
        license = gui.add_text(export_words.LICENSE, known.license, hint=export_words.LICENSE_HINT)
        author = gui.add_text(export_words.AUTHOR, known.author)
        return lambda: {
            "required": [k for k, box in kinds.items() if box.value],
            "formats": [n for n, box in formats.items() if box.value],
            "collision": collisions[collision.value], "form": words.FORMS[form.value],
            "license": license.value, "author": author.value,
        }  # fmt: skip

    def _save(self, fields: dict[str, Any]) -> None:
        self._project.change(fields, self._tab.user)
        self.close()
        self._tab.notify(words.TITLE, words.SAVED, "green", elsewhere=True)
        self._changed()

    def _close_clicked(self) -> None:
        self.close()

    def close(self) -> bool:
        """Close the dialog; whether it was there."""
        modal, self._modal = self._modal, None
        if modal is not None:
            modal.close()
        return modal is not None
