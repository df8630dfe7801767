"""The :class:`KinematicTree` and the poses it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from model.core.errors import KinematicsError
from model.core.joint import Joint, motion


@dataclass(frozen=True)
class KinematicTree:
    """Links and the joints between them: one root, no cycle.

    Attributes:
        links: link names, unique. Links without a part are helpers; their names never begin with
            ``link_``.
        joints: one for each link but the root.

    Raises:
        KinematicsError: with all the violations.
    """

    links: tuple[str, ...]
    joints: tuple[Joint, ...] = ()

    def __post_init__(self) -> None:
        problems = tree_problems(self.links, self.joints)
        if problems:
            raise KinematicsError(problems)

    @cached_property
    def root(self) -> str:
        """The root link."""
        children = {j.child for j in self.joints}
        return next(link for link in self.links if link not in children)

    @cached_property
    def joint_of(self) -> Mapping[str, Joint]:
        """Child link → its joint."""
        return {j.child: j for j in self.joints}

    @cached_property
    def by_name(self) -> Mapping[str, Joint]:
        """Joint name → joint."""
        return {j.name: j for j in self.joints}

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Links with every parent before its children."""
        kids: dict[str, list[str]] = {}
        for j in self.joints:
            kids.setdefault(j.parent, []).append(j.child)
        out: list[str] = []
        stack = [self.root]
        while stack:
            link = stack.pop()
            out.append(link)
            stack.extend(reversed(kids.get(link, [])))
        return tuple(out)

    def children(self, link: str) -> tuple[str, ...]:
        """Child links of ``link`` in the joints' order."""
        return tuple(j.child for j in self.joints if j.parent == link)

    def descendants(self, link: str) -> frozenset[str]:
        """``link`` and all that moves with it."""
        out: set[str] = set()
        stack = [link]
        while stack:
            current = stack.pop()
            out.add(current)
            stack.extend(self.children(current))
        return frozenset(out)

    def with_joint(self, joint: Joint) -> KinematicTree:
        """The tree with the joint of ``joint.child`` replaced."""
        if joint.child not in self.joint_of:
            raise KinematicsError([f"link {joint.child!r} has no joint to replace"])
        joints = tuple(joint if j.child == joint.child else j for j in self.joints)
        return replace(self, joints=joints)

    def path_to_root(self, link: str) -> tuple[str, ...]:
        """``link`` and its ancestors, without the root."""
        out: list[str] = []
        while link in self.joint_of:
            out.append(link)
            link = self.joint_of[link].parent
        return tuple(out)

    def rerooted(self, link: str) -> KinematicTree:
        """The same mechanism with ``link`` as its root.

        The joints on the path to it are reversed; at the same q all links keep their relative
        poses.

        Raises:
            KinematicsError: where there is no such link.
        """
        if link not in self.links:
            raise KinematicsError([f"no link {link!r}; there are {', '.join(self.links)}"])
        turned = self.path_to_root(link)
        joints = tuple(_reversed(j) if j.child in turned else j for j in self.joints)
        return replace(self, joints=joints)

    def renamed(self, names: Mapping[str, str]) -> KinematicTree:
        """The tree with its links renamed, old → new; links that aren't named stay."""
        joints = tuple(
            replace(j, parent=names.get(j.parent, j.parent), child=names.get(j.child, j.child))
            for j in self.joints
        )
        return KinematicTree(tuple(names.get(x, x) for x in self.links), joints)

    def moved(self, matrix: npt.NDArray[np.float64]) -> KinematicTree:
        """The same mechanism after (4, 4) ``matrix`` has moved the object: any affine map.

        Slides are stretched as their axis is. In a mirror a turn goes the other way round; where
        the map stretches across its axis it is none any more, and the axis goes along.
        """
        if (matrix == np.eye(4)).all():
            return self
        along = {j.name: matrix[:3, :3] @ np.asarray(j.axis) for j in self.joints}
        scale = {
            j.name: float(f"{np.linalg.norm(along[j.name]):.12g}") if j.slides else 1.0
            for j in self.joints
        }
        way = float(np.sign(np.linalg.det(matrix[:3, :3])))
        joints = tuple(_moved(j, matrix, along[j.name], scale, way) for j in self.joints)
        return replace(self, joints=joints)

    def joint_values(self, q: Mapping[str, float]) -> dict[str, float]:
        """Value of each moving joint by name: missing ones are 0, mimics follow.

        Raises:
            KinematicsError: where ``q`` names a joint that isn't there.
        """
        known = ", ".join(self.by_name) or "none"
        unknown = sorted(set(q) - set(self.by_name))
        if unknown:
            raise KinematicsError([f"no joint {n!r}; there are {known}" for n in unknown])
        out: dict[str, float] = {}

        def value(joint: Joint) -> float:
            if joint.name not in out:
                if joint.mimic is None:
                    out[joint.name] = float(q.get(joint.name, 0.0))
                else:
                    leader = value(self.by_name[joint.mimic.joint])
                    out[joint.name] = joint.mimic.multiplier * leader + joint.mimic.offset
            return out[joint.name]

        for joint in self.joints:
            if joint.moves:
                value(joint)
        return out

    def pose(self, q: Mapping[str, float]) -> dict[str, npt.NDArray[np.float64]]:
        """Pose of every link.

        Args:
            q: joint name → radians or metres; missing joints are at 0. Limits are not applied.

        Returns:
            link → (4, 4) ``posed_from_rest``: moves the link's rest-frame geometry to its pose, in
            the object frame. All are the identity at q = 0, but for links behind a joint that
            mimics another one with an offset. See CONVENTIONS.md, "Link poses".
        """
        values = self.joint_values(q)
        out = {self.root: np.eye(4)}
        for link in self.order[1:]:
            joint = self.joint_of[link]
            out[link] = out[joint.parent] @ motion(joint, values.get(joint.name, 0.0))
        return out


def driven(tree: KinematicTree, joint: Joint) -> Joint:
    """``joint``; a follower has the range over which its leader takes it, not its own."""
    if joint.mimic is None or joint.mimic.joint not in tree.by_name:
        return joint
    ends = driven(tree, tree.by_name[joint.mimic.joint]).motion_range
    low, high = sorted(joint.mimic.multiplier * q + joint.mimic.offset for q in ends)
    kind = "revolute" if joint.rotates else joint.type
    return replace(joint, type=kind, lower=low, upper=high)


def moving_chain(tree: KinematicTree, link: str, holds: Callable[[str], bool]) -> tuple[str, ...]:
    """Links from below the next part above a part down to the part's own link.

    A part with several joints has helper links between them, which hold no part.

    Args:
        tree: the joints. link: of the part, or one of its helpers.
        holds: whether a link holds a part.

    Returns:
        Links from top to bottom. The last one holds the part, unless ``link`` is a helper that
        carries several parts.
    """
    while not holds(link) and len(below := tree.children(link)) == 1:
        link = below[0]
    chain = [link]
    while (joint := tree.joint_of.get(chain[0])) is not None and joint.parent != tree.root:
        if holds(joint.parent) or len(tree.children(joint.parent)) > 1:
            break
        chain.insert(0, joint.parent)
    return tuple(chain)


def moved_joint(joint: Joint, matrix: npt.NDArray[np.float64]) -> Joint:
    """A joint on its own after (4, 4) ``matrix`` has moved the object; it follows no other."""
    alone = replace(joint, mimic=None)
    return KinematicTree((joint.parent, joint.child), (alone,)).moved(matrix).joints[0]


def _moved(
    joint: Joint,
    matrix: npt.NDArray[np.float64],
    along: npt.NDArray[np.float64],
    scale: Mapping[str, float],
    way: float,
) -> Joint:
    own, length = scale[joint.name], float(np.linalg.norm(along))
    unit = along / length if joint.slides else way * along / (length or 1.0)
    mimic, dynamics = joint.mimic, joint.dynamics
    if mimic is not None:
        multiplier = mimic.multiplier * own / scale[mimic.joint]
        mimic = replace(mimic, multiplier=multiplier, offset=mimic.offset * own)
    if dynamics is not None:  # newtons stay newtons, whatever the unit of length
        slow, fast = dynamics.damping, dynamics.velocity
        dynamics = replace(
            dynamics,
            damping=None if slow is None else slow / own,
            velocity=None if fast is None else fast * own,
        )
    return replace(
        joint,
        axis=tuple((unit + 0.0).tolist()),
        origin=tuple((matrix[:3, :3] @ np.asarray(joint.origin) + matrix[:3, 3]).tolist()),
        lower=None if joint.lower is None else joint.lower * own,
        upper=None if joint.upper is None else joint.upper * own,
        mimic=mimic,
        dynamics=dynamics,
    )


def _reversed(joint: Joint) -> Joint:
    # The parent moves against the child by the inverse motion: the axis flips, q and limits stay.
    x, y, z = (-v if v else 0.0 for v in joint.axis)
    return replace(joint, parent=joint.child, child=joint.parent, axis=(x, y, z))


def tree_problems(links: tuple[str, ...], joints: tuple[Joint, ...]) -> list[str]:
    """Every way in which links and joints fail to be a tree; empty where they are one."""
    out: list[str] = []
    known = set(links)
    if not links:
        out.append("a kinematic tree needs at least one link")
    for name in sorted({n for n in links if links.count(n) > 1}):
        out.append(f"link {name!r} is there twice")
    names = [j.name for j in joints]
    for name in sorted({n for n in names if names.count(n) > 1}):
        out.append(f"joint {name!r} is there twice")
    parent_of: dict[str, str] = {}
    for j in joints:
        for end, link in (("parent", j.parent), ("child", j.child)):
            if link not in known:
                out.append(f"joint {j.name!r}: {end} link {link!r} doesn't exist")
        if j.child in parent_of:
            out.append(f"link {j.child!r} has two parents: {parent_of[j.child]!r} and {j.parent!r}")
        else:
            parent_of[j.child] = j.parent
    roots = [link for link in dict.fromkeys(links) if link not in parent_of]
    if links and not roots:
        out.append("no root: every link is some joint's child")
    if len(roots) > 1:
        out.append(f"{len(roots)} roots instead of one: {', '.join(map(repr, roots))}")
    out.extend(_cycles(parent_of))
    out.extend(_mimic_problems(joints))
    return out


def _cycles(parent_of: Mapping[str, str]) -> list[str]:
    out: list[str] = []
    done: set[str] = set()
    for start in parent_of:
        path: list[str] = []
        link = start
        while link in parent_of and link not in done and link not in path:
            path.append(link)
            link = parent_of[link]
        if link in path:
            out.append("cycle: " + " → ".join([*path[path.index(link) :], link]))
        done.update(path)
    return out


def _mimic_problems(joints: tuple[Joint, ...]) -> list[str]:
    out: list[str] = []
    by_name = {j.name: j for j in joints}
    for j in joints:
        if j.mimic is None:
            continue
        leader = by_name.get(j.mimic.joint)
        if leader is None or not leader.moves:
            out.append(f"joint {j.name!r} mimics {j.mimic.joint!r}, which is no moving joint")
            continue
        seen = {j.name}
        while leader is not None and leader.mimic is not None and leader.name not in seen:
            seen.add(leader.name)
            leader = by_name.get(leader.mimic.joint)
        if leader is not None and leader.name in seen:
            out.append(f"joint {j.name!r} mimics itself through {', '.join(sorted(seen))}")
    return out


def replace_joint(tree: KinematicTree, joint: Joint) -> KinematicTree:
    """Return the tree with the joint of ``joint.child`` replaced.

    Joints that mimic it follow a new name. A new parent below the child first takes the child's
    place: base → door → handle becomes base → handle → door.

    Raises:
        KinematicsError: naming everything that is wrong.
    """
    old = tree.joint_of.get(joint.child)
    if old is None:
        raise KinematicsError([_no_joint(tree, joint.child)])
    lifted = None
    if joint.parent != old.parent and joint.parent in tree.descendants(joint.child):
        lifted = joint.parent
    joints = [joint if j.child == joint.child else _renamed(j, old, joint) for j in tree.joints]
    joints = [replace(j, parent=old.parent) if j.child == lifted else j for j in joints]
    return replace(tree, joints=tuple(joints))


def with_chain_of(tree: KinematicTree, other: KinematicTree, child: str) -> KinematicTree:
    """Return the tree where ``child`` hangs on the helper links that it has in ``other``.

    Where they are the same, or ``child`` has no joint in one of them, nothing changes.
    """
    if child not in tree.joint_of or child not in other.joint_of:
        return tree
    now, then = moving_chain(tree, child, holds_part), moving_chain(other, child, holds_part)
    if now == then:
        return tree
    above = tree.joint_of[now[0]].parent
    added = [other.joint_of[link] for link in then]
    added[0] = replace(added[0], parent=above)
    gone = {tree.joint_of[link].name for link in now} - {j.name for j in added}
    kept = [
        replace(j, mimic=None) if j.mimic is not None and j.mimic.joint in gone else j
        for j in tree.joints
        if j.child not in now
    ]
    links = (*(x for x in tree.links if x not in now[:-1]), *then[:-1])
    return KinematicTree(links, (*kept, *added))


def holds_part(link: str) -> bool:
    """True if a session's link holds a part; the others are helpers."""
    return link.startswith("link_")


def _renamed(follower: Joint, old: Joint, new: Joint) -> Joint:
    if follower.mimic is None or follower.mimic.joint != old.name:
        return follower
    return replace(follower, mimic=replace(follower.mimic, joint=new.name))


def with_fixed(tree: KinematicTree, link: str) -> KinematicTree:
    """Return the tree with one more ``link``, fixed to the root."""
    name = f"fixed_{link}"
    while name in tree.by_name:
        name += "_"
    joint = Joint(name, "fixed", tree.root, link)
    return KinematicTree((*tree.links, link), (*tree.joints, joint))


def without_link(tree: KinematicTree, link: str) -> KinematicTree | None:
    """Return the tree without ``link``; None where it was the only one.

    Its children go to its parent; a root is replaced by its first child. Joints that mimicked the
    removed one become independent.
    """
    if link not in tree.links:
        return tree
    if len(tree.links) == 1:
        return None
    own = tree.joint_of.get(link)
    kids = tree.children(link)
    heir = kids[0] if own is None else own.parent
    gone = {link} if own is not None else {heir}
    names_gone = {tree.joint_of[child].name for child in gone}
    joints = [j for j in tree.joints if j.child not in gone]
    joints = [replace(j, parent=heir) if j.parent == link else j for j in joints]
    joints = [
        replace(j, mimic=None) if j.mimic is not None and j.mimic.joint in names_gone else j
        for j in joints
    ]
    return KinematicTree(tuple(n for n in tree.links if n != link), tuple(joints))


def _no_joint(tree: KinematicTree, child: str) -> str:
    if child == tree.root:
        return f"{child!r} is the root and has no joint; choose another root first"
    return f"no joint moves a link {child!r}; links with a joint: {', '.join(tree.joint_of)}"
