"""The predictor without a network: geometry, names and a motion sweep."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint, canonical_axis_sign
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.prediction.confidence import Evidence, doubt, log_odds, weighing_of
from model.prediction.geometric.assembly import TOUCHING, Scene, make_scene
from model.prediction.geometric.context import Assembly, PartContext
from model.prediction.geometric.edge_limits import from_zero
from model.prediction.geometric.evidence import part_evidence
from model.prediction.geometric.hypothesis import Hypothesis, confidence
from model.prediction.geometric.mechanisms import find_front, propose
from model.prediction.geometric.roles import guess_mechanisms
from model.prediction.geometric.tree import root_scores, spanning_parents

Array = npt.NDArray[np.float64]

BACKEND = "geometric 1"


class GeometricPredictor:
    """Joints from contact, boxes, symmetry, handles and names; deterministic, CPU only."""

    name = "geometric"

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.protocol.Predictor`."""
        return self.explained(segmented, locked=locked, seed=seed, progress=progress)[0]

    def explained(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> tuple[Prediction, dict[str, Evidence]]:
        """The prediction, and by child link what its confidences are made of."""
        start = time.perf_counter()
        progress(0.0, "sampling surfaces")
        scene = make_scene(segmented, seed)
        progress(0.3, "finding contacts")
        root, parent, problems = _tree(scene, locked)
        assembly = Assembly(scene, root, parent)
        mechanisms, reasons, sureness = guess_mechanisms(assembly)
        assembly.front, assembly.front_certainty = find_front(assembly, mechanisms)
        kept = {j.child: j for j in locked}
        joints: list[Joint] = []
        links = [s.link for s in scene.shapes]
        helpers: list[str] = []
        sure: dict[str, float] = {}
        known: dict[str, Evidence] = {}
        weighing = weighing_of(GeometricPredictor.name)
        notes: dict[str, str] = {}
        moving = [i for i in range(len(scene)) if i != root]
        for step, i in enumerate(moving):
            progress(0.4 + 0.6 * step / len(moving), f"joint of {links[i]}")
            if links[i] in kept:
                continue
            context = PartContext(assembly, i)
            found = propose(context, mechanisms[i])
            built = joints_of(scene, links, i, parent[i], from_zero(context, found[0]))
            joints += built
            helpers += [j.child for j in built[:-1]]
            share = confidence(_distinct(found))
            odds = {"type rules": log_odds(sureness[i]), "slot rules": log_odds(share)}
            known[links[i]] = odds | part_evidence(context, mechanisms[i])
            sure[links[i]] = weighing.of(known[links[i]])
            said = (reasons[i], found[0].note, doubt(known[links[i]]))
            notes[links[i]] = "; ".join(filter(None, said))
            problems += _problems(context)
        tree, trouble = assemble(tuple(links), tuple(helpers), joints, locked)
        sure.update({j.child: 1.0 for j in locked})
        notes.update({j.child: "settled by the person" for j in locked})
        progress(1.0, "done")
        made = Prediction(
            tree,
            tuple(problems + trouble),
            sure,
            BACKEND,
            seed,
            time.perf_counter() - start,
            notes=notes,
        )
        return made, known


def _tree(scene: Scene, locked: tuple[Joint, ...]) -> tuple[int, list[int], list[str]]:
    """Root and parents; what the person settled stays."""
    index = {s.link: i for i, s in enumerate(scene.shapes)}
    scores = root_scores(scene)
    children = {index[j.child] for j in locked if j.child in index}
    free = [i for i in range(len(scene)) if i not in children]
    problems = [
        f"locked joint {j.name!r} names a link that isn't there"
        for j in locked
        if j.child not in index
    ]
    candidates = free or list(range(len(scene)))
    root = max(candidates, key=lambda i: (scores[i], -i))
    parent = spanning_parents(scene, root)
    for j in locked:
        if j.child in index and j.parent in index:
            parent[index[j.child]] = index[j.parent]
    _break_cycles(parent, root, children)
    return root, parent, problems


def _break_cycles(parent: list[int], root: int, settled: set[int]) -> None:
    """Hang what no longer reaches the root (because of settled joints) on the root."""
    for i in range(len(parent)):
        seen: list[int] = []
        at = i
        while at != root and at >= 0 and at not in seen:
            seen.append(at)
            at = parent[at]
        if at != root:
            loose = next((k for k in seen if k not in settled), None)
            if loose is not None:
                parent[loose] = root


def joints_of(scene: Scene, links: list[str], i: int, parent: int, h: Hypothesis) -> list[Joint]:
    """The hypothesis as joints in the object's frame: one, or a helper's and the part's own."""
    frame = scene.frame
    axis = frame.direction_in_object(h.axis)
    origin = frame.point_in_object(h.origin)
    scale = 1.0 if h.type in ("revolute", "continuous") else frame.diagonal
    joint = Joint(
        f"joint_{links[i]}",
        h.type,
        links[parent],
        links[i],
        _three(axis),
        _three(origin),
        h.lower * scale,
        h.upper * scale,
    )
    if h.travel is None:
        return [canonical_axis_sign(joint)]
    helper = f"helper_{links[i].removeprefix('link_')}"
    slide = Joint(
        f"joint_{helper}",
        "prismatic",
        links[parent],
        helper,
        _three(axis),
        _three(origin),
        h.travel[0] * frame.diagonal,
        h.travel[1] * frame.diagonal,
    )
    return [canonical_axis_sign(slide), canonical_axis_sign(replace(joint, parent=helper))]


def _three(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _distinct(found: list[Hypothesis]) -> list[Hypothesis]:
    """Without those that mean the same motion as a better one."""
    kept: list[Hypothesis] = []
    for h in found:
        if not any(
            k.type == h.type
            and abs(float(k.axis @ h.axis)) > 0.99
            and (
                h.type == "prismatic"
                or np.linalg.norm(np.cross(k.axis, h.origin - k.origin)) < 0.02
            )
            for k in kept
        ):
            kept.append(h)
    return kept


def _problems(context: PartContext) -> list[str]:
    link, above = context.shape.link, context.base.link
    gap = float(context.scene.gap[context.part, context.parent])
    out = []
    if gap > 4 * TOUCHING:
        out.append(
            f"{link} doesn't touch {above}: the gap is {gap * context.scene.frame.diagonal:.3g} m"
        )
    if len(context.shape.points) < 20:
        out.append(f"{link} has only {len(context.shape.points)} points: its joint is a guess")
    return out


def assemble(
    links: tuple[str, ...], helpers: tuple[str, ...], joints: list[Joint], locked: tuple[Joint, ...]
) -> tuple[KinematicTree | None, list[str]]:
    """One tree of predicted and settled joints."""
    from model.core.errors import KinematicsError

    known = {*links, *helpers}
    extra = tuple(
        dict.fromkeys(end for j in locked for end in (j.parent, j.child) if end not in known)
    )
    taken = {j.name for j in locked}
    renamed = [replace(j, name=f"{j.name}_predicted") if j.name in taken else j for j in joints]
    try:
        return KinematicTree((*links, *helpers, *extra), (*renamed, *locked)), []
    except KinematicsError as error:
        return None, list(error.problems)
