"""The joint that a part would have if it moved another way than it was taken to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import SegmentedObject
from model.core.joint import Joint, JointType, canonical_axis_sign
from model.core.motion_lexicon import MECHANISMS, SLIDING, TURNING, Mechanism
from model.core.tree import KinematicTree, moving_chain
from model.prediction.geometric.assembly import Scene, make_scene
from model.prediction.geometric.context import Assembly, PartContext
from model.prediction.geometric.edge_hinges import edge_hypotheses
from model.prediction.geometric.edge_limits import from_zero
from model.prediction.geometric.hypothesis import Hypothesis
from model.prediction.geometric.mechanisms import find_front, propose
from model.prediction.geometric.part_features import look
from model.prediction.geometric.predictor import joints_of
from model.prediction.geometric.roles import guess_mechanisms, mechanism_scores, named_mechanism

Array = npt.NDArray[np.float64]

SLIDES: tuple[Mechanism, ...] = ("slide_out", "slide_along", "lift", "press")
SPINS: tuple[Mechanism, ...] = ("spin", "swivel", "screw")
TURNS: tuple[Mechanism, ...] = tuple(m for m in MECHANISMS if m not in (*SLIDES, *SPINS, "fixed"))
MECHANISMS_OF: dict[JointType, tuple[Mechanism, ...]] = {
    "prismatic": SLIDES,
    "revolute": (*TURNS, *SPINS),
    "continuous": SPINS,
}
"""What may move a part by a joint of that type."""
ROCKER = 0.6
"""Size over the object's from which nothing is a rocker: it is a front that opens."""
NAMED = 1.0
"""Score for the way in which a part of that name would slide, or turn, if it did."""
ALONG = 0.95
"""Cosine from which two directions are taken for one."""
FREE, HELD = 0.3, 0.5
"""How much of a drawer is covered at most in front, and at least on both sides and behind."""
DEEP = 0.5
"""Depth over its front's shorter side from which it is no front alone."""
TURN, SLIDE = math.pi / 2, 0.3
"""Range where nothing says more: radians, and the object's diagonals."""


def retyped(
    segmented: SegmentedObject, tree: KinematicTree, child: str, kind: JointType, seed: int = 0
) -> Joint:
    """The joint of ``child`` as one of another type, where the geometry says such a joint is.

    Axis, origin and limits are those of the likeliest motion of that type; name, parent and child
    stay. A joint that turns keeps its line where it only gets or loses its limits, and so does one
    that moves no part of its own.

    Args:
        segmented: parts, object frame, metres. tree: the joints as they are; they say what hangs
            on what.
        child: a part's link, or the helper link of a part with several joints.
        kind: the new type.
    """
    joint = tree.joint_of[child]
    if kind == joint.type:
        return joint
    usual = TURN if kind != "prismatic" else SLIDE * _diagonal(segmented)
    # The ratio to a joint that it follows means nothing to another type.
    bare = replace(joint, type=kind, lower=0.0, upper=usual, mimic=None, give_way=False)
    if joint.rotates != bare.rotates:  # nor do N s/m
        bare = replace(bare, dynamics=None)
    if kind == "fixed" or (joint.rotates and bare.rotates):
        return bare
    parts = {p.link for p in segmented.parts}
    moved = moving_chain(tree, child, parts.__contains__)[-1]
    if moved not in parts:
        return bare
    scene = make_scene(segmented, seed)
    assembly = _assembly(scene, tree)
    links = [s.link for s in scene.shapes]
    part = links.index(moved)
    if part == assembly.root:
        return bare
    context = PartContext(assembly, part)
    mechanisms, _, _ = guess_mechanisms(assembly)
    mechanisms[part] = _mechanism(context, kind)
    assembly.front, assembly.front_certainty = find_front(assembly, mechanisms)
    out = scene.frame.object_from_working.T @ np.asarray(joint.axis)
    best = _front_flap(context, out) if kind == "revolute" else None
    if best is None:
        best = from_zero(context, propose(context, mechanisms[part])[0])
    if best.type == "fixed":
        return bare
    [found] = joints_of(scene, links, part, context.parent, replace(best, travel=None))
    limits = found if found.type == kind else bare
    return canonical_axis_sign(
        replace(bare, axis=found.axis, origin=found.origin, lower=limits.lower, upper=limits.upper)
    )


def _front_flap(context: PartContext, out: Array) -> Hypothesis | None:
    """How a drawer opens that is made to turn, as its front is what one means: about the lower
    edge of a wide front, about a side of a tall one. None for what is no drawer.

    Args:
        out: (3,) unit, working frame, the way in which it slides.
    """
    box = context.shape.box
    deep = int(np.argmax(np.abs(out @ box.axes)))
    if abs(float(out @ box.axes[:, deep])) < ALONG or abs(float(out[2])) > 1 - ALONG:
        return None
    if _mechanism(context, "prismatic") != "slide_out":
        return None
    up = int(np.argmax(np.abs(box.axes[2])))
    wide = 3 - deep - up
    ahead = deep if float(out @ box.axes[:, deep]) > 0 else deep + 3
    covers = context.covers
    beside = min(covers[wide], covers[wide + 3])
    if covers[ahead] > FREE or beside < HELD or covers[ahead - 3] < HELD:
        return None  # it is in nothing, or comes out another way
    if box.half[deep] < DEEP * min(box.half[up], box.half[wide]):
        return None  # a front alone: what it looks like says how it opens
    flap = bool(box.half[up] <= box.half[wide])
    edge = wide if flap else up
    fitting = [
        h
        for h in edge_hypotheses(context, "drop" if flap else "hinge", front=out)
        if abs(float(h.axis @ box.axes[:, edge])) > ALONG
        and (not flap or h.origin[2] < box.center[2])
    ]
    return max(fitting, key=lambda h: h.score)


def _diagonal(segmented: SegmentedObject) -> float:
    return float(np.linalg.norm(np.ptp(segmented.bounds, axis=0)))


def _assembly(scene: Scene, tree: KinematicTree) -> Assembly:
    """What hangs on what as the tree has it; helper links are passed over."""
    index = {s.link: i for i, s in enumerate(scene.shapes)}
    parent = []
    for link in index:
        above = link
        while above in tree.joint_of:
            above = tree.joint_of[above].parent
            if above in index:
                break
        parent.append(index[above] if above in index and above != link else -1)
    root = index.get(tree.root, parent.index(-1))
    parent = [k if k >= 0 else root for k in parent]
    parent[root] = -1
    return Assembly(scene, root, parent)


def _mechanism(context: PartContext, kind: JointType) -> Mechanism:
    """The likeliest way in which the part moves by such a joint: by its name, else its looks."""
    fit = MECHANISMS_OF[kind]
    said = named_mechanism(context)
    if said in fit:
        return said
    others = [PartContext(context.assembly, i) for i in range(len(context.scene))]
    unnamed = {
        i: look(other)
        for i, other in enumerate(others)
        if i != context.assembly.root and (i == context.part or named_mechanism(other) is None)
    }
    scores = mechanism_scores(context, unnamed[context.part], unnamed)
    if said is not None:
        other = (SLIDING if kind == "prismatic" else TURNING).get(said)
        if other is not None:
            scores[other] = scores.get(other, 0.0) + NAMED
    if context.shape.size > ROCKER:
        scores["toggle"] = 0.0
    return max(fit, key=lambda m: scores.get(m, 0.0))
