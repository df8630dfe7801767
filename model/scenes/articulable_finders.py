"""Finders of articulable objects by name, and the offline one: a lexicon of articulable kinds.

Built-ins and plug-ins load the same way. The lexicon is matched against descriptions. The head of a
description decides: "cabinet with a lamp on it" is a cabinet, "oven mitt" is a mitt. Words that are
near a known one (spelling mistakes) count as that one.
"""

from __future__ import annotations

import difflib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.packages import Registry
from model.core.progress import Progress, no_progress
from model.scenes.scene import ArticulableFinder, Decision, ObjectDescription


@dataclass(frozen=True)
class FinderOptions:
    """For finders that ask a language model.

    Attributes:
        url: of the server, None for its environment variable or OpenAI's.
        batch: objects a question.
        timeout: seconds without an answer.
        retries: after the first try.
        cache: folder of answers; None keeps none.
        asks: whether it will be asked at all: one whose questions are only counted needs no key.
    """

    url: str | None = None
    batch: int = 20
    timeout: float = 120.0
    retries: int = 5
    cache: Path | None = None
    asks: bool = True


LEXICON = Path(__file__).resolve().parents[2] / "static_assets" / "scenes" / "articulable.json"
NEAR = 0.84
"""Likeness from which a word passes for a known one: two slips in eleven letters."""
SHORTEST = 5
"""Letters below which no likeness counts: "pan" is not "fan"."""
_HEAD_ENDS = re.compile(
    # Not inside of "built-in", nor in "side by side" and "floor to ceiling".
    r"(?<![\w-])(with|on|in|at|near|next|beside|under|behind|above|below|from|of|for|holding|"
    r"containing|that|which|made|and|against|inside|between|leading|(?<!side )by|"
    r"(?<!floor )(?<!wall )(?<!ready )to)(?![\w-])|[,.;:(\[{<]"
)
_SIZE = re.compile(
    r"\b\d+([.,]\d+)?(\s*(x|×|by)\s*\d+([.,]\d+)?)*\s*"
    r"(m|cm|mm|metres?|meters?|in|inch|inches|ft|foot|feet)\b(\s+(tall|high|wide|deep|long|thick)\b)?"
)
"""A measure says nothing about the kind, wherever it stands."""

_COUNTED = re.compile(r"\b(pair|set|stack|row|kind|type) of\b")


@dataclass(frozen=True)
class Kind:
    """One kind of articulable object.

    Attributes:
        name: of the kind.
        words: its synonyms, lower case, each one or more words.
        parts: moving parts to expect.
        base: ``fixed`` or ``free``.
        needs: words of which the description must hold one, for kinds that only sometimes move.
    """

    name: str
    words: tuple[str, ...]
    parts: tuple[str, ...]
    base: str
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Lexicon:
    """Kinds, and words that say nothing about the kind.

    Attributes:
        qualifiers: words that may stand behind the head without changing it ("oven 2 lower").
    """

    kinds: tuple[Kind, ...]
    qualifiers: frozenset[str]


def read_lexicon(path: Path = LEXICON) -> Lexicon:
    """Read a lexicon file.

    Raises:
        InputFileError: naming what is wrong in it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        kinds = tuple(_kind(k) for k in data["kinds"])
        return Lexicon(kinds, frozenset(data["qualifiers"]))
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputFileError(path, f"is no lexicon ({type(error).__name__}: {error})") from error


def _kind(entry: dict[str, Any]) -> Kind:
    if entry["base"] not in ("fixed", "free"):
        raise ValueError(f"{entry['name']}: base {entry['base']!r} is neither fixed nor free")
    words = (entry["name"], *entry.get("synonyms", ()))
    return Kind(
        entry["name"],
        tuple(_plain(w) for w in words),
        tuple(entry["parts"]),
        entry["base"],
        tuple(entry.get("needs", ())),
    )


class LexiconFinder:
    """Decides by :data:`LEXICON`, offline and at once."""

    name = "lexicon"

    def __init__(self, lexicon: Lexicon | None = None) -> None:
        self._lexicon = lexicon or read_lexicon()
        self._kind_of = {w: k for k in reversed(self._lexicon.kinds) for w in k.words}
        self._single = tuple(w for w in self._kind_of if " " not in w)
        self._near = lru_cache(maxsize=4096)(self._nearest)

    def find(self, objects: Sequence[ObjectDescription]) -> list[Decision]:
        """See :class:`~model.scenes.scene.ArticulableFinder`."""
        return [self._decide(o) for o in objects]

    def _decide(self, obj: ObjectDescription) -> Decision:
        said = _plain(f"{obj.category or ''} {obj.description}")
        for source, text in (("category", obj.category), ("description", obj.description)):
            found = self._match(text) if text else None
            if found is None:
                continue
            kind, word, likeness = found
            article = "an" if kind.name[0] in "aeiou" else "a"
            taken = f'recognised as {article} {kind.name} from "{word}" in its {source} "{text}"'
            if kind.needs and not any(re.search(rf"\b{n}", said) for n in kind.needs):
                why = f"{taken}, which moves only with one of: {', '.join(kind.needs)}"
                return Decision(False, (), why, kind.name, kind.base, 0.6)
            return Decision(True, kind.parts, taken, kind.name, kind.base, likeness)
        shown = obj.description if obj.category is None else f"{obj.category}: {obj.description}"
        return Decision(False, (), f"no articulable kind fits {shown!r}", confidence=0.8)

    def _match(self, text: str) -> tuple[Kind, str, float] | None:
        """Kind of the head of ``text``, the word that matched it, and their similarity."""
        text = _SIZE.sub(" ", _COUNTED.sub("", _split_case(text)))
        head = _HEAD_ENDS.split(text, maxsplit=1)[0] or text
        if (whole := _plain(text)) in self._kind_of:  # "chest of drawers"
            return self._kind_of[whole], whole, 1.0
        words = _plain(head).split()
        while len(words) > 1 and words[-1] in self._lexicon.qualifiers:
            words.pop()
        for count in (3, 2, 1):
            if len(words) >= count:
                phrase = " ".join(words[-count:])
                for form in (phrase, _singular(phrase)):
                    if form in self._kind_of:
                        return self._kind_of[form], form, 1.0
        near = self._near(words[-1]) if words else None
        return None if near is None else (self._kind_of[near[0]], *near)

    def _nearest(self, word: str) -> tuple[str, float] | None:
        if len(word) < SHORTEST:
            return None
        known = [w for w in self._single if len(w) >= SHORTEST and w[0] == word[0]]
        found = difflib.get_close_matches(word, known, n=1, cutoff=NEAR)
        if not found:
            return None
        return found[0], difflib.SequenceMatcher(None, word, found[0]).ratio()


def _split_case(text: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower()


def _plain(text: str) -> str:
    return " ".join(re.findall(r"[a-z]+", _split_case(text)))


def _singular(phrase: str) -> str:
    if phrase.endswith("shelves"):
        return phrase[:-3] + "f"
    if phrase.endswith("es") and phrase[-3:-2] in ("s", "x", "h"):
        return phrase[:-2]
    return phrase[:-1] if phrase.endswith("s") and not phrase.endswith("ss") else phrase


DEFAULT = "lexicon"

FINDERS = Registry[ArticulableFinder](
    "finder",
    ArticulableFinder,
    "name and find",
    {DEFAULT: "model.scenes.articulable_finders:LexiconFinder"},
    group="artiworld.articulable_finders",
    parametrised={
        "openai": "model.scenes.engines:openai_finder",
        "qwen3": "model.scenes.engines:qwen_finder",
    },
    argument="MODEL",
)


def default_cache() -> Path:
    """The user's cache folder, by the XDG base directory specification."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "artiworld" / "finder"


def load_finder(
    name: str = DEFAULT, options: FinderOptions | None = None, progress: Progress = no_progress
) -> ArticulableFinder:
    """The finder called ``name``: ``lexicon``, ``openai:MODEL``, ``qwen3:FOLDER``, or a plug-in's.

    Raises:
        ConfigurationError: where there is none, or it lacks a package or a key.
    """
    if ":" in name:
        return FINDERS.load(name, options or FinderOptions(), progress)
    return FINDERS.load(name)
