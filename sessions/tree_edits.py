"""Edits of a kinematic tree that keep it a tree."""

from __future__ import annotations

from dataclasses import replace

from model.core.errors import KinematicsError
from model.core.joint import Joint
from model.core.tree import KinematicTree


def replace_joint(tree: KinematicTree, joint: Joint) -> KinematicTree:
    """The tree with the joint of ``joint.child`` replaced.

    A new name goes into the joints that mimic it. Where the new parent hangs below the child, it
    is lifted first to where the child hung: base → door → handle becomes base → handle → door.

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


def _renamed(follower: Joint, old: Joint, new: Joint) -> Joint:
    if follower.mimic is None or follower.mimic.joint != old.name:
        return follower
    return replace(follower, mimic=replace(follower.mimic, joint=new.name))


def reroot(tree: KinematicTree, link: str) -> KinematicTree:
    """The same mechanism with ``link`` as its root.

    The joints on the way turn round; at the same q all links stand in the same poses relative to
    each other.

    Raises:
        KinematicsError: where there is no such link.
    """
    if link not in tree.links:
        raise KinematicsError([f"no link {link!r}; there are {', '.join(tree.links)}"])
    turned = path_to_root(tree, link)
    joints = tuple(_turned(j) if j.child in turned else j for j in tree.joints)
    return replace(tree, joints=joints)


def path_to_root(tree: KinematicTree, link: str) -> tuple[str, ...]:
    """``link`` and those above it, without the root."""
    out: list[str] = []
    while link in tree.joint_of:
        out.append(link)
        link = tree.joint_of[link].parent
    return tuple(out)


def without_link(tree: KinematicTree, link: str) -> KinematicTree | None:
    """The tree without ``link``; None where nothing is left.

    What hung on it hangs on its parent. Where it was the root, its first child takes its place.
    Joints that mimicked the removed one move on their own.
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


def _turned(joint: Joint) -> Joint:
    # The parent moves against the child by the inverse motion: the axis flips, q and limits stay.
    x, y, z = (-v if v else 0.0 for v in joint.axis)
    return replace(joint, parent=joint.child, child=joint.parent, axis=(x, y, z))


def _no_joint(tree: KinematicTree, child: str) -> str:
    if child == tree.root:
        return f"{child!r} is the root and has no joint; choose another root first"
    return f"no joint moves a link {child!r}; links with a joint: {', '.join(tree.joint_of)}"
