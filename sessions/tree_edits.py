"""Edits of a kinematic tree that keep it a tree."""

from __future__ import annotations

from dataclasses import replace

from model.core.errors import KinematicsError
from model.core.joint import Joint
from model.core.tree import KinematicTree, moving_chain


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
