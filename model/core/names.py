"""Names of parts: how their words reach the motion lexicon, and how screens show them.

Every screen and message names links and joints so: "door 2", "seat 1: lift".
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.motion_lexicon import (
    BASE_WORDS,
    CATEGORY_ALIASES,
    CATEGORY_WORDS,
    OTHER_CATEGORIES,
    PRESS_PREFIX,
    SLIDE_PREFIX,
    SLIDING,
    SYNONYMS,
    TURN_PREFIX,
    TURNING,
    WORDS,
    Mechanism,
)
from model.core.tree import KinematicTree, moving_chain


def words(name: str | None) -> tuple[str, ...]:
    """Lower-case words of a name: ``"Rotation_Door-2"`` → ("rotation", "door")."""
    if not name:
        return ()
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    found: list[str] = re.findall(r"[a-z]+", spaced.lower())
    return tuple(SYNONYMS.get(w, w) for w in found)


_CATEGORIES = (*CATEGORY_WORDS, *OTHER_CATEGORIES, *CATEGORY_ALIASES)
_SAME, _ALIKE = 0.85, 0.72
"""Likeness from which a category is taken for a known one, and from which one is asked for."""


@lru_cache(maxsize=4096)
def known_word(word: str, vocabulary: tuple[str, ...]) -> str | None:
    """The word of the vocabulary that ``word`` means: itself, its singular, or a near spelling."""
    for candidate in (word, word.removesuffix("s"), word.removesuffix("es")):
        if candidate in vocabulary:
            return candidate
    if len(word) >= 4:
        close = difflib.get_close_matches(word, vocabulary, n=1, cutoff=0.84)
        if close:
            return close[0]
    return None


def category_key(category: str | None) -> str:
    """``"Kitchen Pot"`` → ``"kitchenpot"``; the nearest known category, "" where none is near."""
    plain = re.sub(r"[^a-z]", "", (category or "").lower())
    found = plain if plain in _CATEGORIES else _nearest(plain, _SAME)
    return CATEGORY_ALIASES.get(found, found)


def category_remark(category: str | None) -> str | None:
    """Suggestion for a misspelt category; None if it is known, or similar to none."""
    plain = re.sub(r"[^a-z]", "", (category or "").lower())
    near = "" if plain in _CATEGORIES else _nearest(plain, _ALIKE)
    if not near:
        return None
    if near == _nearest(plain, _SAME):
        return f"category {category!r} is taken for {near!r}"
    return f"category {category!r} is none that is known; did you mean {near!r}?"


def _nearest(word: str, cutoff: float) -> str:
    close = difflib.get_close_matches(word, _CATEGORIES, n=1, cutoff=cutoff)
    return close[0] if close else ""


def mechanism_of(name: str | None, category: str | None) -> tuple[Mechanism | None, str]:
    """The mechanism that a part's name implies, and the word that implies it.

    Returns:
        (None, "") where the name says nothing.
    """
    found = words(name)
    if not found:
        return None, ""
    # The last word is the noun: a "drawer handle" is a handle.
    mechanism, said = next(_mechanisms(found, category), (None, ""))
    pushed = next((w for w in found[:-1] if w in PRESS_PREFIX), None)
    if mechanism is None:
        return ("press", pushed) if pushed else (None, "")
    if any(w in TURN_PREFIX for w in found):
        mechanism = TURNING.get(mechanism, mechanism)
    if any(w in SLIDE_PREFIX for w in found):
        mechanism = SLIDING.get(mechanism, mechanism)
    if pushed:
        mechanism = "press"
    if "toggle" in found or "rocker" in found:
        mechanism = "toggle"
    return mechanism, said


def mechanisms_of(name: str | None, category: str | None) -> tuple[Mechanism, ...]:
    """The different mechanisms that the words of a name imply, the last word's first: those of a
    "drawer door" are of a door and of a drawer. Words such as "sliding" leave only one."""
    found = words(name)
    if any(w in TURN_PREFIX | SLIDE_PREFIX | PRESS_PREFIX | {"toggle", "rocker"} for w in found):
        only, _ = mechanism_of(name, category)
        return () if only is None else (only,)
    return tuple(dict.fromkeys(m for m, _ in _mechanisms(found, category)))


def _mechanisms(found: Sequence[str], category: str | None) -> Iterator[tuple[Mechanism, str]]:
    """The mechanism of each known word, and that word, the last one first."""
    special = CATEGORY_WORDS.get(category_key(category), {})
    for word in reversed(found):
        for table in (special, WORDS):
            if (hit := known_word(word, tuple(table))) is not None:
                yield table[hit], hit
                break


def base_score(name: str | None, category: str | None) -> float:
    """Evidence in a name for "this is the base"; negative for names of things that move."""
    found = words(name)
    if not found:
        return 0.0
    if any(w in TURN_PREFIX | SLIDE_PREFIX for w in found):
        return -3.0
    hit = known_word(found[-1], tuple(BASE_WORDS))
    score = BASE_WORDS.get(hit or "", 0.0)
    if score and hit != "leg":
        return score
    mechanism, _ = mechanism_of(name, category)
    if mechanism is None:
        return score
    return score if mechanism == "fixed" else score - 2.0


MOST_NAMED = 12
"""Meshes of one file that their names can make parts of; more are screws and panels."""


def named_parts(names: Sequence[str]) -> tuple[int, ...] | None:
    """Part numbers of the meshes of one file, where a name says that one of them moves.

    Without such a name they may be materials or boards.

    Args:
        names: of its meshes, in order.

    Returns:
        A number for each: 0 for the one that is most likely the base, unless all move, the others
        from 1 on in order. None where the names don't tell parts.
    """
    tells = {mechanism_of(name, None)[0] for name in names} - {None, "fixed"}
    if not tells or not 2 <= len(names) <= MOST_NAMED:
        return None
    scores = [base_score(name, None) for name in names]
    base = scores.index(max(scores)) if max(scores) >= 0 else None
    others = iter(range(1, len(names) + 1))
    return tuple(0 if i == base else next(others) for i in range(len(names)))


BASE = "base"
UPRIGHT = 0.9
"""Cosine to +z from which an axis counts as upright: about 25 degrees, a choice."""


def link_display_name(link: str, name: str | None, *, root: bool) -> str:
    """Return "door 2", "part 2" without a part name, and other links unchanged.

    Args:
        name: of the link's part, or None.
        root: whether the link is the tree's root, which is the "base" if it is part 0 or no part.
    """
    number = link.removeprefix("link_") if link.startswith("link_") else ""
    named = bool(name) and name != link
    if not number.isdigit():
        return BASE if root and not named else link
    if named:
        return BASE if (name, number) == (BASE, "0") else f"{name} {number}"
    return BASE if root and number == "0" else f"part {number}"


def joint_display_name(
    tree: KinematicTree, child: str, has_part: Callable[[str], bool], part: Callable[[str], str]
) -> str:
    """Return the moved part's name, with the motion where the part has several joints.

    Args:
        child: link that the joint moves.
        has_part: whether a link has a part; helper links between the joints of one part have none.
        part: display name of a part's link.
    """
    chain = moving_chain(tree, child, has_part)
    if len(chain) == 1 or not has_part(chain[-1]):
        return part(child)
    place = chain.index(child)
    words = [_motion_name(tree.joint_of[link]) for link in chain[: place + 1]]
    count = words.count(words[-1])
    return f"{part(chain[-1])}: {words[-1]}" + (f" {count}" if count > 1 else "")


def _motion_name(joint: Joint) -> str:
    upright = abs(joint.axis[2]) >= UPRIGHT
    if not joint.moves:
        return "fixed"
    if not joint.rotates:
        return "lift" if upright else "slide"
    if upright:
        return "swivel"
    return "spin" if joint.type == "continuous" else "tilt"


def display_name(obj: ArticulatedObject, link: str) -> str:
    """Return the display name of a link, or of the joint that moves a helper link."""
    names = {p.link: p.name for p in obj.parts}

    def part(of: str) -> str:
        return link_display_name(of, names.get(of), root=of == obj.tree.root)

    if link in names or link == obj.tree.root:
        return part(link)
    return joint_display_name(obj.tree, link, names.__contains__, part)
