"""The parts: a row for each, its name with buttons for common ones, suggested categories, and the
prompts as a list for people.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from typing import Any, Final

import viser

from app.server import part_tasks
from app.server.job import JobFailed
from app.server.jobs import EDITS
from app.server.tool_tasks import NEXT_MASK
from app.viewer.input.pointing import Pointing
from app.viewer.panels.widgets import Choice, Presses, button, icon, offered, put
from app.viewer.picture import palette
from app.viewer.picture.palette import CATEGORIES
from app.viewer.tab import Tab, percent, worked_on
from app.viewer.words import annotate as words
from model.core.motion_lexicon import CATEGORY_ALIASES
from model.scenes.articulable_finders import read_lexicon
from model.segmentation.prompts import BASE, Click
from sessions import commands as cmd
from sessions.database import ObjectRecord
from sessions.document import Document, RegionRef
from sessions.project_settings import Project

_LISTED: Final = {c.lower(): c for c in CATEGORIES}
_KINDS: Final = {
    "chest of drawers": "StorageFurniture",
    "nightstand": "StorageFurniture",
    "shelf": "StorageFurniture",
    "toaster oven": "Oven",
    "dryer": "WashingMachine",
    "computer mouse": "Mouse",
    "usb stick": "USB",
}
"""Kinds of the lexicon → categories of another name."""
_FOLDERS = 2
"""Folders above the file whose names may hold the category: "Oven/101773/object.obj"."""
_ROW, _FRAME = 41, 5
"""Letters that fit the panel side by side, and for how many a button's frame and gap take room."""
_MARK = "?"


def category_guesses(
    record: ObjectRecord, queue: Sequence[ObjectRecord], who: str = ""
) -> tuple[str, ...]:
    """Categories that an object without one may have, likeliest first; few enough for one row.

    From the name of its file or of a folder that holds it; without a match, the latest
    categories of objects of similar names ("scan_3", "scan_4"), by ``who`` before others.
    """
    path = record.path
    texts = (path.stem, *reversed(path.parent.parts[1:][-_FOLDERS:]))
    declared = next(filter(None, map(category_in, texts)), None)
    if declared is not None:
        return (declared,)
    last: dict[str, tuple[bool, str]] = {}
    for other in queue:
        category = _LISTED.get((other.category or "").replace(" ", "").lower())
        if category is not None and other.id != record.id and _alike(record, other):
            last[category] = max(last.get(category, (False, "")), (other.who == who, other.updated))
    found = sorted(last, key=lambda c: last[c])[::-1]
    out: list[str] = []
    for category in found:
        if out and sum(len(c) + _FRAME for c in (*out, category)) > _ROW:
            break
        out.append(category)
    return tuple(out)


def _alike(one: ObjectRecord, other: ObjectRecord) -> bool:
    """True if two objects have the same name but for numbers, as those of one series; numbers
    alone are names of many series."""
    a, b = (re.sub(r"\d+", "", r.path.stem).lower() for r in (one, other))
    return a == b and any(map(str.isalpha, a))


@lru_cache(maxsize=4096)
def category_in(text: str) -> str | None:
    """The category in the name of a file or folder: "office_chair_02" is a Chair.

    As in English the thing comes last, "table_with_lamp" is a table, and words that say nothing
    are passed over: "oven_scan_3".
    """
    words_of = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower())
    if "with" in words_of[1:]:
        words_of = words_of[: words_of.index("with", 1)]
    for end in range(len(words_of), 0, -1):
        for count in (3, 2, 1):
            if count <= end and (found := _meant(words_of[end - count : end])) is not None:
                return found
    return None


def _meant(phrase: Sequence[str]) -> str | None:
    for plural in ("", "s", "es"):
        words = " ".join(phrase).removesuffix(plural)
        kind = _kinds().get(words, words)
        plain = kind.replace(" ", "")
        for meant in (words.replace(" ", ""), _KINDS.get(kind), CATEGORY_ALIASES.get(plain), plain):
            if meant is not None and meant.lower() in _LISTED:
                return _LISTED[meant.lower()]
    return None


@lru_cache(maxsize=1)
def _kinds() -> dict[str, str]:
    """Word for a kind in the lexicon of scenes → the kind's name."""
    return {word: kind.name for kind in reversed(read_lexicon().kinds) for word in kind.words}


class CategoryGuess:
    """A row of suggested categories."""

    def __init__(
        self,
        tab: Tab,
        records: Callable[[], Sequence[ObjectRecord]],
        words_of: Callable[[str], None],
        project: Project,
    ) -> None:
        """Put the row where the panel is.

        Args:
            records: the queue.
            words_of: gets the category.
            project: whose labels count where it is strict.
        """
        self._tab, self._records, self._chosen = tab, records, words_of
        self._project = project
        self._shown: tuple[str, ...] = ()
        self._row = tab.client.gui.add_button_group(
            words.SUGGESTIONS,
            (_MARK,),
            hint=words.SUGGESTIONS_HINT,
            visible=False,
        )
        self._row.on_click(lambda e: tab.act(lambda: words_of(e.target.value.removesuffix(_MARK))))

    @property
    def first(self) -> str | None:
        """The likeliest of the suggestions."""
        return next(iter(self._shown), None)

    def show(self, wanted: bool) -> None:
        """Show suggestions for the open object, or hide the row."""
        record = self._tab.selection.need_object().record if wanted else None
        self._shown = (
            () if record is None else category_guesses(record, self._records(), self._tab.user)
        )
        self._shown = tuple(filter(self._project.settings.knows_category, self._shown))
        if self._shown:
            put(self._row, options=tuple(g + _MARK for g in self._shown))
        put(self._row, visible=bool(self._shown))

    def take_first(self) -> str | None:
        """Take the likeliest category; None where none is suggested."""
        category = self.first
        if category is not None:
            self._chosen(category)
        return category


SHOWN = 6
"""Names with a button."""
USUAL: Final[tuple[str, ...]] = ("door", "drawer", "lid", "knob", "button", "wheel")
"""Names of most parts; the list beside them has the rest."""


@lru_cache(maxsize=256)
def names_for(category: str | None) -> tuple[str, ...]:
    """The names with a button, in the order of their digits from 1: the usual ones, or for a
    category whose parts are others those first."""
    kinds = read_lexicon().kinds if category else ()
    parts = next((k.parts for k in kinds if category_in(k.name) == category), ())
    if set(parts) <= set(USUAL):
        return USUAL
    return tuple(dict.fromkeys((*parts, *USUAL)))[:SHOWN]


class NameStrip:
    """Names with a button and a key each."""

    def __init__(
        self, tab: Tab, presses: Presses, action: str, taken: Callable[[str], None]
    ) -> None:
        """Put the strip where the panel is; ``taken`` gets the name of an ``action``."""
        self._names, self._action = USUAL, action
        self._strip = tab.client.gui.add_html("")
        presses.on(action, taken)

    def name(self, number: int) -> str | None:
        """The name of a digit, None where it has none."""
        return self._names[number - 1] if 1 <= number <= len(self._names) else None

    def show(
        self,
        visible: bool,
        category: str | None,
        chosen: str | None = None,
        names: tuple[str, ...] = (),
    ) -> None:
        """Show or hide those of a category, or a project's ``names``; the chosen one is marked."""
        self._names = names[:SHOWN] or names_for(category)
        chips = "".join(
            button(
                self._action,
                name,
                name,
                content=f"{escape(name)}<kbd>⇧{number}</kbd>",
                style="aw-small",
                pressed=name == chosen,
            )
            for number, name in enumerate(self._names, 1)
        )
        put(self._strip, content=f'<div class="aw-names">{chips}</div>', visible=visible)


PARTS_SHOWN = 200
ALIKE = 0.3
"""Difference of two equal parts' areas, in one of them: scans show more of one than of another."""
NAME_SECONDS = 4.0
"""So long a name waits for the comparison."""


class PartList:
    """Chooses, names, hides and deletes parts."""

    def __init__(self, tab: Tab, pointing: Pointing, presses: Presses, project: Project) -> None:
        self._tab, self._pointing, self._project = tab, pointing, project
        gui = tab.client.gui
        with gui.add_folder(words.PARTS):
            self._strip = NameStrip(tab, presses, "label", self.take_name)
            self._rows = gui.add_html("")
            self._name = Choice(
                tab, words.PART_NAME, palette.PART_NAMES, self._chosen_name, self.rename
            )
        presses.on("part", lambda part: self._clicked(int(part)))
        presses.on("part add", lambda _: tab.selection.choose_part(self._document().next_part))
        presses.on("part hide", lambda _: self.toggle_hidden())
        presses.on("part delete", lambda _: self.delete())

    def _document(self) -> Document:
        return self._tab.selection.need_object().document

    def _chosen_name(self) -> str | None:
        return self._document().part_names.get(self._tab.selection.part)

    def rename(self, name: str | None) -> None:
        """Name the selected part; parts of the same shape get the name too."""
        part = self._tab.selection.part
        if name == self._chosen_name():
            return
        if part and part not in {p.id for p in self._document().parts}:
            self._tab.do(cmd.AddPart(part, name))
            return
        name_part(self._tab, part, name)

    def take_name(self, name: str) -> None:
        """Name the selected part where it has no name; else the next click makes one with it."""
        known = self._document().part(self._tab.selection.part)
        if known is not None and known.id and known.name is None:
            self.rename(name)
            self._tab.say(words.name_set(known.id, name))
        else:
            if self._pointing.armed:
                self._pointing.disarm()
            self._pointing.tools.pick_label(name)

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
        selection.hidden = selection.hidden ^ {worked_on(selection)}
        self._pointing.hover.forget()
        self._tab.invalidate()

    def take_number(self, number: int) -> None:
        """Take the name of a digit, if it has one."""
        if name := self._strip.name(number):
            self.take_name(name)

    def draw(self, doc: Document, shares: dict[int, float], category: str | None) -> None:
        """Bring the list up to date.

        Args:
            shares: of the surface by part, 0..1.
            category: what the object is, or may be.
        """
        selection, label = self._tab.selection, self._pointing.tools.label
        rows = []
        for part in parts_listed((p.id for p in doc.parts), selection.part):
            name = doc.part_names.get(part) or (part == selection.part and label) or None
            if name in (None, f"link_{part}"):  # as read from a folder of parts: no name at all
                name = words.UNNAMED if part else words.BASE
            share = percent(shares[part]) if part in shares else ""
            rows.append(self._row(part, name, share))
        add = button("part add", "", words.ADD_PART, style="aw-small")
        put(self._rows, content=f'<div class="aw-parts">{"".join(rows)}{add}</div>')
        name, picking = doc.part_names.get(selection.part), selection.picking
        settings = self._project.settings
        own = settings.part_names(doc.category)
        self._name.offer(offered(own, palette.PART_NAMES, settings.strict))
        self._name.show(name, not picking)
        self._strip.show(not picking, category, label or name, own)

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


def name_part(tab: Tab, part: int, name: str | None) -> None:
    """Name a part; unnamed parts of the same shape get the name too."""
    obj = tab.selection.need_object()
    doc, shares = obj.document, obj.segmenting.shares
    known, mine, others = doc.part(part), shares.get(part, 0.0), ()
    if name and known is not None and known.name is None and doc.segmentation_current:
        free = (p.id for p in doc.parts if p.id not in (BASE, part) and p.name is None)
        others = tuple(k for k in free if 1 - ALIKE < shares.get(k, 0.0) / (mine or 1) < 1 + ALIKE)
    if others:  # some are as large
        task = part_tasks.equal_parts
        job = obj.lane.geometry.submit(task, obj.source(), part, others, priority=EDITS)
        try:
            others = job.result(NAME_SECONDS)
        except (TimeoutError, JobFailed):
            others = ()
            tab.say(words.NOT_COMPARED)
    tab.do(cmd.NamePart(part, name, others))
    more = len(obj.document.part_names) - len(doc.part_names) - 1
    if name and more > 0:
        tab.notify(*words.named_too(name, more), "green")


def parts_listed(parts: Iterable[int], chosen: int) -> list[int]:
    """The parts that have a button: the first ``PARTS_SHOWN``, always with the selected one."""
    ids = sorted({BASE, chosen, *parts})
    return ids if len(ids) <= PARTS_SHOWN else sorted({*ids[: PARTS_SHOWN - 1], chosen})


PROMPTS_SHOWN = 12
Prompt = Click | RegionRef


@dataclass(frozen=True)
class PromptEntry:
    """One line of the list.

    Attributes:
        part: its part.
        index: of its first prompt among all.
        count: prompts that it stands for.
        label: its text.
    """

    part: int
    index: int
    count: int
    label: str


class PromptList:
    """The newest prompts of the selected part; a click removes one."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        gui = tab.client.gui
        with gui.add_folder(words.PROMPTS):
            self._note = gui.add_markdown("")
            actions = gui.add_button_group(
                words.PROMPTS_REMOVE, words.PROMPT_ACTIONS, visible=False
            )
            self._box = gui.add_folder(words.PROMPT_LIST, expand_by_default=False, visible=False)
            self._actions = actions
            self._buttons: list[tuple[Any, PromptEntry]] = []
        actions.on_click(lambda e: tab.act(lambda: self.remove(e.target.value)))

    def remove(self, which: str) -> None:
        """Remove prompts of the selected part, or all; ``which`` is a button."""
        last, _, every = words.PROMPT_ACTIONS
        tab, part = self._tab, self._tab.selection.part
        prompts = tab.selection.need_object().document.prompts
        mine = [entry for entry in prompt_entries(prompts) if entry.part == part]
        if which == every and prompts:
            tab.do(cmd.ClearPrompts())
        elif not mine:
            text = words.NONE_ON_PART if prompts else words.NO_PROMPTS
            tab.notify(words.PROMPTS_REMOVE, text, "gray")
        elif which == last:  # of those that are listed
            tab.do(cmd.RemovePrompt(mine[-1].index, mine[-1].count))
        else:
            tab.do(cmd.ClearPrompts(part))

    def draw(self, doc: Document, elements: str) -> None:
        """Bring the list up to date.

        Args:
            elements: what one element of the object is, "face" or "point".
        """
        tab = self._tab
        entries = prompt_entries(doc.prompts, elements)
        mine = [entry for entry in entries if entry.part == tab.selection.part]
        note = words.prompt_count(len(mine), len(entries))
        put(self._note, content=note if doc.prompts else words.NO_PROMPTS)
        wanted = mine[-PROMPTS_SHOWN:]
        put(self._actions, visible=bool(doc.prompts))
        put(self._box, visible=bool(wanted))
        if [entry for _, entry in self._buttons] == wanted:
            return
        for handle, _ in self._buttons:
            handle.remove()
        self._buttons = []
        for entry in wanted:
            with self._box:
                handle = tab.client.gui.add_button(entry.label, icon=viser.Icon.X, color="gray")
            remove = cmd.RemovePrompt(entry.index, entry.count)
            handle.on_click(lambda _, remove=remove: tab.act(lambda: tab.do(remove)))
            self._buttons.append((handle, entry))


def prompt_entries(prompts: Sequence[Prompt], elements: str = "face") -> list[PromptEntry]:
    """The lines of the list, in order.

    Args:
        elements: what one element of the object is, "face" or "point".
    """
    out: list[PromptEntry] = []
    for index, prompt in enumerate(prompts):
        before = prompts[index - 1] if index else None
        if _is_mask(prompt) and before is not None and before.part == prompt.part:
            if isinstance(before, Click):
                clicked = out.pop()
                label = f"{clicked.label}, {words.OTHER_MASK}"
                out.append(PromptEntry(clicked.part, clicked.index, 2, label))
                continue
            if _is_mask(before):
                one = out.pop()
                out.append(PromptEntry(one.part, one.index, one.count + 1, one.label))
                continue
        out.append(PromptEntry(prompt.part, index, 1, _label(prompt, elements)))
    return out


def _is_mask(prompt: Prompt) -> bool:
    return isinstance(prompt, RegionRef) and prompt.tool == NEXT_MASK


def _label(prompt: Prompt, elements: str) -> str:
    sign = "+" if prompt.positive else "−"
    if isinstance(prompt, Click):
        return words.prompt_click(sign, prompt.position)
    if prompt.tool == NEXT_MASK:
        return words.OTHER_MASK
    return words.prompt_region(sign, prompt.tool, prompt.count, elements)
