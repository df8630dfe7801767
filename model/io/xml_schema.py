"""Content of a format that its XML reader knows, so that all else in a file gets a remark."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_LISTED = 5
"""Kinds that a remark names; it counts the others."""


@dataclass(frozen=True)
class XmlSchema:
    """The elements and attributes that a reader reads or answers for.

    Attributes:
        elements: element → the elements and attributes that it may have; None where somebody else
            judges them. What stands in an element that has no entry isn't looked at.
        passed_over: elements that say nothing of shapes and motion, wherever they stand.
        repeated: elements of which several may stand in one; None for all.
        choices: elements that hold one of their elements.
    """

    elements: dict[str, tuple[frozenset[str] | None, frozenset[str] | None]]
    passed_over: frozenset[str]
    repeated: frozenset[str] | None
    choices: frozenset[str]

    @classmethod
    def of(
        cls, rows: tuple[tuple[str, str | None, str | None], ...], passed_over: str,
        repeated: str | None = None, choices: str = "",
    ) -> XmlSchema:  # fmt: skip
        """A schema from (element, its elements, its attributes), names with blanks between."""
        return cls(
            {tag: (_names(below), _names(said)) for tag, below, said in rows},
            frozenset(passed_over.split()), _names(repeated), frozenset(choices.split()),
        )  # fmt: skip

    def unread(self, root: Element) -> list[str]:
        """A remark that counts the elements and attributes that aren't known; else nothing."""
        found: Counter[str] = Counter()
        stack = [root]
        while stack:
            element = stack.pop()
            below, said = self.elements.get(element.tag, (None, None))
            if said is not None:
                found.update(
                    f"attribute {key!r} of <{element.tag}>" for key in element.attrib
                    if key not in said and "}" not in key
                )  # fmt: skip
            seen = set[str]()
            for child in element:
                if not isinstance(child.tag, str) or child.tag in self.passed_over:
                    continue
                if below is not None and child.tag not in below:
                    found[f"<{child.tag}> in <{element.tag}>"] += 1
                elif seen and self._is_further(element.tag, child.tag, seen):
                    found[f"a further <{child.tag}> in <{element.tag}>"] += 1
                elif child.tag in self.elements:
                    stack.append(child)
                seen.add(child.tag)
        if not found:
            return []
        listed = ", ".join(f"{what} ({n})" for what, n in found.most_common(_LISTED))
        rest = f" and {len(found) - _LISTED} kinds more" if len(found) > _LISTED else ""
        return [f"not read: {listed}{rest}"]

    def _is_further(self, tag: str, child: str, seen: set[str]) -> bool:
        """True if a reader took another element in its place."""
        if tag in self.choices:
            return True
        return child in seen and self.repeated is not None and child not in self.repeated


def _names(text: str | None) -> frozenset[str] | None:
    return None if text is None else frozenset(text.split())
