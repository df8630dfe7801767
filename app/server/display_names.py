"""What people call the parts and joints of a document, the same on every screen."""

from __future__ import annotations

import re

from model.core.display_names import joint_display_name, link_display_name
from model.core.tree import KinematicTree, moving_chain
from sessions.document import Document

_LINK = re.compile(r"(?<![\w/])(?:link|helper)_\d+(?!\.?\w)")
"""A link in a sentence; neither a file's name nor a part of a longer one."""


def holds_part(link: str) -> bool:
    """Whether a link is a part's; the others are helpers between the joints of one."""
    return link.startswith("link_")


def part_title(doc: Document, link: str) -> str:
    """What people call a link: "door 2", and a helper of that door "door 2, first joint"."""
    if doc.tree is None or holds_part(link) or link not in doc.tree.joint_of:
        return _part(doc, link)
    return joint_title(doc, link)


def joint_title(doc: Document, child: str) -> str:
    """What people call the joint of ``child``: as the part that it moves, with its place where
    that has several."""
    if doc.tree is None or child not in doc.tree.joint_of:
        return _part(doc, child)
    return joint_display_name(doc.tree, child, holds_part, lambda link: _part(doc, link))


def _part(doc: Document, link: str) -> str:
    name = next((p.name for p in doc.parts if p.link == link), None)
    return link_display_name(link, name, root=doc.tree is None or link == doc.tree.root)


def in_words(doc: Document, text: str) -> str:
    """A sentence in which links are called what people call them."""
    return _LINK.sub(lambda found: part_title(doc, found[0]), text)


def moved_part(tree: KinematicTree, link: str) -> str:
    """The link that holds the part which the joint of ``link`` moves."""
    return moving_chain(tree, link, holds_part)[-1]
