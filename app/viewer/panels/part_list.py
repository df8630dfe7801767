"""The parts: a row for each, and the name of the selected one."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import viser

from app.viewer.input.pointing import Pointing
from app.viewer.panels.choice import Choice, offered
from app.viewer.panels.markup import Presses, button, icon
from app.viewer.panels.quick_names import QuickNames
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.text import percent
from app.viewer.words import annotate as words
from model.segmentation.prompts import BASE
from sessions import commands as cmd
from sessions.document import Document
from sessions.project_settings import Project

PARTS_SHOWN = 200


class PartList:
    """Chooses, names, hides and deletes parts."""

    def __init__(self, tab: Tab, pointing: Pointing, presses: Presses, project: Project) -> None:
        self._tab, self._pointing, self._project = tab, pointing, project
        gui = tab.client.gui
        with gui.add_folder(words.PARTS):
            self._rows = gui.add_html("")
            self._name = Choice(
                tab, words.PART_NAME, palette.PART_NAMES, self._chosen_name, self.rename
            )
            self._quick = QuickNames(tab, self.rename)
        presses.on("part", lambda part: self._clicked(int(part)))
        presses.on("part add", lambda _: tab.selection.choose_part(self._document().next_part))
        presses.on("part hide", lambda _: self.toggle_hidden())
        presses.on("part delete", lambda _: self.delete())

    def _document(self) -> Document:
        return self._tab.selection.need_object().document

    def _chosen_name(self) -> str | None:
        return _part_name(self._document(), self._tab.selection.part)

    def rename(self, name: str | None) -> None:
        """Name the selected part; parts of the same shape get the name too."""
        part = self._tab.selection.part
        if name == self._chosen_name():
            return
        if part and part not in {p.id for p in self._document().parts}:
            self._tab.do(cmd.AddPart(part, name))
            return
        before = len(self._document().part_names)
        self._tab.do(cmd.NamePart(part, name))
        more = len(self._document().part_names) - before - 1
        if name and more > 0:
            self._tab.notify(*words.named_too(name, more), "green")

    def _clicked(self, part: int) -> None:
        if self._pointing.armed == "merge":
            self._pointing.merge(part)
        else:
            self._tab.selection.choose_part(part)

    def delete(self) -> None:
        """Delete the selected part with all its prompts, and choose another one."""
        tab, selection = self._tab, self._tab.selection
        if selection.step != "Annotate":
            tab.notify(words.DELETE, words.DELETE_ELSEWHERE, "gray")
            return
        if not selection.part:
            tab.notify(words.DELETE, words.DELETE_BASE, "gray")
            return
        if self._document().part(selection.part) is not None:
            tab.do(cmd.DeletePart(selection.part))
        selection.choose_part(min((p.id for p in self._document().parts if p.id), default=1))

    def toggle_hidden(self) -> None:
        """Hide the selected part (its joint's part in the other steps), or show it again."""
        selection = self._tab.selection
        selection.hidden = selection.hidden ^ {selection.worked_on}
        self._pointing.hover.forget()
        self._tab.invalidate()

    def quick_name(self, number: int) -> str | None:
        """The name that a digit gives the selected part, None where it gives none."""
        return self._quick.name(number)

    def draw(self, doc: Document, shares: dict[int, float], category: str | None) -> None:
        """Bring the list up to date.

        Args:
            shares: of the surface by part, 0..1.
            category: what the object is, or may be.
        """
        selection = self._tab.selection
        rows = []
        for part in parts_listed((p.id for p in doc.parts), selection.part):
            name = _part_name(doc, part)
            if name in (None, f"link_{part}"):  # as read from a folder of parts: no name at all
                name = words.UNNAMED if part else words.BASE
            share = percent(shares[part]) if part in shares else ""
            rows.append(self._row(part, name, share))
        add = button("part add", "", words.ADD_PART, style="aw-small")
        put(self._rows, "content", f'<div class="aw-parts">{"".join(rows)}{add}</div>')
        name, picking = _part_name(doc, selection.part), selection.picking
        settings = self._project.settings
        own = settings.part_names(doc.category)
        self._name.offer(offered(own, palette.PART_NAMES, settings.strict))
        self._name.show(name, not picking)
        self._quick.show(selection.part != BASE and not picking, category, name, own)

    def _row(self, part: int, name: str, share: str) -> str:
        """A part with its color; the selected one with what can be done to it."""
        selection = self._tab.selection
        hidden, chosen = part in selection.hidden, part == selection.part
        label = words.part_button(part, name, share, hidden)
        content = (
            f'<i style="background:rgb{palette.part_color(part)}"></i><b>{part}</b>'
            f"<span>{escape(name[:24])}</span><small>{share}</small>"
        )
        row = button("part", str(part), label, content=content, pressed=chosen)
        if not chosen:
            return f'<div class="aw-part{" aw-off" if hidden else ""}">{row}</div>'
        eye = icon(viser.Icon.EYE_OFF if hidden else viser.Icon.EYE)
        row += button("part hide", "", words.part_hide(hidden), content=eye, style="aw-icon")
        if part:
            trash = icon(viser.Icon.TRASH)
            row += button("part delete", "", words.DELETE_THIS, content=trash, style="aw-icon")
        return f'<div class="aw-part">{row}</div>'


def parts_listed(parts: Iterable[int], chosen: int) -> list[int]:
    """The parts that have a button: the first ``PARTS_SHOWN``, always with the selected one."""
    ids = sorted({BASE, chosen, *parts})
    return ids if len(ids) <= PARTS_SHOWN else sorted({*ids[: PARTS_SHOWN - 1], chosen})


def _part_name(doc: Document, part: int) -> str | None:
    return next((p.name for p in doc.parts if p.id == part), None)
