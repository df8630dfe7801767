"""Names as people see them: of a document's parts and joints, and of objects in the queue."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from model.core.names import joint_display_name, link_display_name
from model.core.tree import KinematicTree, holds_part, moving_chain
from sessions.database import ObjectRecord
from sessions.document import Document

_LINK = re.compile(r"(?<![\w/])(?:link|helper)_\d+(?!\.?\w)")
"""A link in a sentence; neither a file name nor a part of a longer one."""


def part_title(doc: Document, link: str) -> str:
    """Return a link's display name: "door 2", or of a helper of that door "door 2, first joint"."""
    if doc.tree is None or holds_part(link) or link not in doc.tree.joint_of:
        return _part(doc, link)
    return joint_title(doc, link)


def joint_title(doc: Document, child: str) -> str:
    """Return the display name of a joint: the part that it moves, and which joint of a chain."""
    if doc.tree is None or child not in doc.tree.joint_of:
        return _part(doc, child)
    return joint_display_name(doc.tree, child, holds_part, lambda link: _part(doc, link))


def _part(doc: Document, link: str) -> str:
    name = next((p.name for p in doc.parts if p.link == link), None)
    return link_display_name(link, name, root=doc.tree is None or link == doc.tree.root)


def display_text(doc: Document, text: str) -> str:
    """Return the text with its links replaced by display names."""
    return _LINK.sub(lambda found: part_title(doc, found[0]), text)


def moved_part(tree: KinematicTree, link: str) -> str:
    """Return the link of the part that the joint of ``link`` moves."""
    return moving_chain(tree, link, holds_part)[-1]


def queue_names(records: Sequence[ObjectRecord]) -> dict[int, str]:
    """Id → name; the suffix or the folders distinguish equal names."""
    same: dict[str, list[ObjectRecord]] = defaultdict(list)
    for record in records:
        same[record.name].append(record)
    out: dict[int, str] = {}
    for name, group in same.items():
        names = [name] * len(group)
        if len(group) > 1:
            names = _distinct_names(name, group)
        out.update(zip((r.id for r in group), names, strict=True))
    return out


def _distinct_names(name: str, group: list[ObjectRecord]) -> list[str]:
    deepest = max(len(r.path.parts) for r in group)
    names = [f"{name}{r.path.suffix}" for r in group]
    for depth in range(1, deepest):
        if len(set(names)) == len(names):
            break
        folders = ["/".join(r.path.parts[-1 - depth : -1]) for r in group]
        names = [f"{folder}/{name}" for folder in folders]
        if len(set(names)) < len(names):
            names = [f"{n}{r.path.suffix}" for n, r in zip(names, group, strict=True)]
    return names


def clipped(text: str, limit: int) -> str:
    """``text`` in at most ``limit`` characters; the middle goes, as names often begin alike."""
    if len(text) <= limit:
        return text
    head = (limit - 1) // 3
    return f"{text[:head]}…{text[len(text) - (limit - 1 - head) :]}"
