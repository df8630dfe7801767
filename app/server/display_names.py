"""Display names of a document's parts and joints."""

from __future__ import annotations

import re

from model.core.names import joint_display_name, link_display_name
from model.core.tree import KinematicTree, moving_chain
from sessions.document import Document
from sessions.tree_edits import holds_part

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
