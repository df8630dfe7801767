"""Distance of a predicted tree of parts from the true one."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from model.core.joint import Joint
from model.core.tree import KinematicTree


def chain(tree: KinematicTree, part: str, parts: Collection[str]) -> tuple[str, tuple[Joint, ...]]:
    """The next of ``parts`` above ``part``, "" at the root, and the moving joints down from it."""
    above, joints = path(tree, part, parts)
    return above, tuple(j for j in joints if j.moves)


def path(tree: KinematicTree, part: str, parts: Collection[str]) -> tuple[str, tuple[Joint, ...]]:
    """The same with the fixed joints among them."""
    joints: list[Joint] = []
    link = part
    while (joint := tree.joint_of.get(link)) is not None:
        joints.append(joint)
        link = joint.parent
        if link in parts:
            return link, tuple(reversed(joints))
    return "", tuple(reversed(joints))


def parents(tree: KinematicTree, parts: Collection[str]) -> dict[str, str]:
    """Part → the next part above it, "" at the root; helper links are passed over."""
    return {p: path(tree, p, parts)[0] for p in parts if p in tree.links}


def tree_edits(truth: Mapping[str, str], predicted: Mapping[str, str], *, extra: int = 0) -> int:
    """Tree edit distance: fewest edits that make the predicted tree the true one, no unit.

    Nodes are known apart (they were matched by geometry), so the distance for labelled trees
    (Zhang and Shasha, 1989, with re-attaching as one edit) is a count: one for each part that
    has the wrong parent, is missing, or is extra. 0 is the true tree.

    Args:
        truth, predicted: part → parent, "" at the root.
        extra: predicted parts that match no true one.
    """
    wrong = sum(p in predicted and predicted[p] != above for p, above in truth.items())
    missing = sum(p not in predicted for p in truth)
    return wrong + missing + extra
