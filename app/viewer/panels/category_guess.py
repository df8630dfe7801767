"""Suggested categories; a key or a click takes one."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final

from app.viewer.panels.widgets import put
from app.viewer.picture.palette import CATEGORIES
from app.viewer.tab import Tab
from app.viewer.words import annotate as words
from model.core.motion_lexicon import CATEGORY_ALIASES
from model.scenes.articulable_finders import read_lexicon
from sessions.database import ObjectRecord
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
    """True if two objects have the same name but for numbers, as those of one series."""
    a, b = (re.sub(r"\d+", "", r.path.stem).lower() for r in (one, other))
    return a == b


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
            put(self._row, "options", tuple(g + _MARK for g in self._shown))
        put(self._row, "visible", bool(self._shown))

    def take_first(self) -> str | None:
        """Take the likeliest category; None where none is suggested."""
        category = self.first
        if category is not None:
            self._chosen(category)
        return category
