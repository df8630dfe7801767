"""Names of links and joints in files: screens say "door 2", files ``door_2``.

Inside the app part *i* is ``link_i`` whatever it is called, so that decisions survive a new name.
Where an asset is written, these links, the helpers between them and the joints that were predicted
take the parts' names; all other names are a source's own and stay. The rule depends on a part's
own name and number alone, so that naming one part leaves the others' names:

=================================  ==========================================================
part 2, named "Drawer Door"        ``drawer_door_2``; its joint ``drawer_door_2_hinge``
part 2, no name in Latin letters   ``link_2``; ``link_2_hinge``
the root, part 0 without a name    ``base``
first link of a part's two joints  ``helper_seat_1``; ``seat_1_lift``, ``seat_1_swivel``
=================================  ==========================================================

A joint ends in what it does: ``hinge``, ``turn`` (knobs, levers), ``spin`` (continuous),
``slide``, ``fixed``; one of several of a part as on the screen. Names that are taken get the next
free number.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from model.core.articulated_object import ArticulatedObject
from model.core.files import free_name
from model.core.joint import JOINT_KINDS, Joint
from model.core.motion_lexicon import MECHANISM_TABLE
from model.core.names import BASE, joint_display_name, mechanism_of
from model.core.tree import KinematicTree, moving_chain
from model.physics.simulation_values import Physics

V = TypeVar("V")

_PART = re.compile(r"link_(\d+)")
_LONGEST = 60
"""Letters of a part's name in a file's; file systems take 255 bytes with suffix and number."""
_OWN_JOINT = re.compile(
    r"joint_(link|helper)_\d+|(base|.+_\d+)_(hinge|turn|spin|slide|fixed|lift|swivel|tilt)(_\d+)?"
)
"""Joints that predictors or this file named."""


@dataclass(frozen=True)
class FileNames:
    """Link → its name in files, and joint → its name in files; absent ones stay."""

    links: Mapping[str, str]
    joints: Mapping[str, str]

    @classmethod
    def of(cls, obj: ArticulatedObject) -> FileNames:
        """The names that the files of an object use."""
        return cls.of_tree(obj.tree, {p.link: p.name for p in obj.parts}, obj.category)

    @classmethod
    def of_tree(
        cls, tree: KinematicTree, names: Mapping[str, str | None], category: str | None
    ) -> FileNames:
        """The same of a tree; ``names`` holds the links of all parts."""
        links = _links(tree, names)
        return cls(links, _joints(tree, names, category, links))

    @classmethod
    def stored(cls, entry: Mapping[str, Any]) -> FileNames:
        """Names that :meth:`to_json` left in a saved asset; none in one of an earlier version."""
        kept = entry.get("names")
        found = kept if isinstance(kept, dict) else {}
        return cls(
            *(
                {str(own): str(name) for name, own in found.get(kind, {}).items()}
                for kind in ("links", "joints")
            )
        )

    def to_json(self) -> dict[str, dict[str, str]]:
        """Names in the files → names in the session, of those that differ."""
        both = {"links": self.links, "joints": self.joints}
        return {k: {new: old for old, new in n.items() if new != old} for k, n in both.items()}

    def by_link(self, values: Mapping[str, V]) -> dict[str, V]:
        """The values under their links' names in files."""
        return {self.links.get(link, link): value for link, value in values.items()}

    def tree(self, tree: KinematicTree) -> KinematicTree:
        """The tree with the names that files use."""

        def named(joint: Joint) -> Joint:
            mimic = joint.mimic
            if mimic is not None:
                mimic = replace(mimic, joint=self.joints.get(mimic.joint, mimic.joint))
            return replace(joint, name=self.joints.get(joint.name, joint.name), mimic=mimic)

        out = tree.renamed(self.links)
        return replace(out, joints=tuple(map(named, out.joints)))

    def object(self, obj: ArticulatedObject) -> ArticulatedObject:
        """The object with the names that files use."""
        links = self.links
        return replace(
            obj,
            parts=tuple(replace(p, link=self.links.get(p.link, p.link)) for p in obj.parts),
            tree=self.tree(obj.tree),
            inertials=self.by_link(obj.inertials),
            shapes=self.by_link(obj.shapes),
            affordances=tuple(
                replace(a, joint=self.joints.get(a.joint, a.joint), link=links.get(a.link, a.link))
                for a in obj.affordances
            ),
        )

    def physics(self, physics: Physics) -> Physics:
        """Its physics with the names that files use."""
        links = self.links
        return replace(
            physics,
            inertials=self.by_link(physics.inertials),
            collision=self.by_link(physics.collision),
            dynamics={self.joints.get(k, k): v for k, v in physics.dynamics.items()},
            overlapping=tuple((links.get(a, a), links.get(b, b)) for a, b in physics.overlapping),
            declared_shapes=tuple(links.get(k, k) for k in physics.declared_shapes),
        )


def _links(tree: KinematicTree, names: Mapping[str, str | None]) -> dict[str, str]:
    parts = {link: m[1] for link in names if (m := _PART.fullmatch(link))}
    helpers = [x for x in tree.links if x not in names and x.startswith("helper_")]
    taken = {link for link in tree.links if link not in parts and link not in helpers}
    out: dict[str, str] = {}
    for link, number in parts.items():
        plain = BASE if number == "0" and link == tree.root else link
        taken.add(free := free_name(_file_name(names[link], number) or plain, taken))
        out[link] = free
    for link in helpers:
        moved = moving_chain(tree, link, names.__contains__)[-1]
        name = f"helper_{out.get(moved, moved)}" if moved in names else link
        taken.add(free := free_name(name, taken))
        out[link] = free
    return out


def _joints(
    tree: KinematicTree,
    names: Mapping[str, str | None],
    category: str | None,
    links: Mapping[str, str],
) -> dict[str, str]:
    own = [tree.joint_of[link] for link in tree.order[1:]]
    taken = {j.name for j in own if not _OWN_JOINT.fullmatch(j.name)}
    out: dict[str, str] = {}
    for joint in (j for j in own if j.name not in taken):
        moved = moving_chain(tree, joint.child, names.__contains__)[-1]
        mechanism = mechanism_of(names.get(moved), category)[0]
        row = JOINT_KINDS[joint.type]
        if joint.type == "revolute" and mechanism is not None:
            row = MECHANISM_TABLE[mechanism]
        shown = joint_display_name(tree, joint.child, names.__contains__, lambda k: links.get(k, k))
        named = shown.replace(": ", "_").replace(" ", "_") if ": " in shown else ""
        named = named or f"{links.get(moved, moved)}_{row.noun}"
        out[joint.name] = free_name(named, {*taken, *out.values()})
    return out


def _file_name(name: str | None, number: str) -> str:
    """``drawer_door_2``; "" where the name holds no Latin letter and no digit."""
    plain = unicodedata.normalize("NFKD", (name or "").casefold()).encode("ascii", "ignore")
    slug = re.sub(r"[^a-z0-9]+", "_", plain.decode()).strip("_")[:_LONGEST].strip("_")
    if not slug:
        return ""
    if (slug, number) == (BASE, "0"):
        return BASE
    said = re.fullmatch(r"(.+)_(\d+)", slug)
    stem = said[1] if said and said[2] == number else slug
    return f"part_{stem}_{number}" if stem[0].isdigit() else f"{stem}_{number}"


def part_of_file_name(link: str, name: str | None) -> int | None:
    """The number of the part that ``link`` was written for, None for other names.

    Args:
        name: of the part, as in its file.
    """
    if link == BASE and name in (None, BASE):
        return 0
    number = link.rpartition("_")[2]
    if not number.isdecimal() or link not in (f"link_{number}", _file_name(name, number)):
        return None
    return int(number)


def part_name_in(link: str) -> str:
    """Part name in a link's file name: "drawer door" of ``drawer_door_2``; "" without one."""
    found = re.fullmatch(r"(.+)_\d+", link)
    return "" if found is None or found[1] == "link" else found[1].replace("_", " ")
