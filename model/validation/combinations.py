"""Collisions that happen only when several joints move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.kinematics.joint_path import tree_poses
from model.kinematics.sweep import sweep_path
from model.validation import messages
from model.validation.examine import Scene, between
from model.validation.report import Finding, Severity

POSES = 12
STEPS = 10
POINTS = 768
OFTEN = 0.5
"""Share of the poses from which a collision is a warning: a door and the drawer beside it may block
each other, but not nearly always."""

FloatArray = npt.NDArray[np.float64]


def combination_findings(
    scene: Scene,
    known: frozenset[frozenset[str]],
    seed: int,
    progress: Progress = no_progress,
) -> dict[str, Finding]:
    """Find the deepest such collision of each joint, by joint name.

    Args:
        known: pairs of links that collide when one joint moves alone; they are left out.
        seed: random seed of the poses (of low discrepancy).
    """
    tree = scene.obj.tree
    joints = [j for j in tree.joints if j.moves and j.mimic is None]
    pairs = _pairs(scene) - known
    if len(joints) < 2 or not pairs:
        return {}
    found: dict[frozenset[str], list[Finding]] = {}
    for k, pose in enumerate(_poses(joints, seed)):
        progress(k / POSES, messages.COMBINING)
        path = [{n: v * t for n, v in pose.items()} for t in np.linspace(0, 1, STEPS)]
        near = pairs & _near(scene, path)
        if not near:
            continue
        sweep = sweep_path(scene.obj, path, pairs=near, tolerance=scene.tolerance, points=POINTS)
        worst = int(np.argmax(sweep.depth))
        pair, depth = sweep.pairs[worst], float(sweep.depth[worst])
        if pair is None or depth <= scene.tolerance:
            continue
        at = tuple(float(v) for v in sweep.where[worst])
        one = Finding("combination", Severity.OK, "", depth, path[worst], at, pair[1])  # type: ignore[arg-type]
        found.setdefault(frozenset(pair), []).append(one)
    return _by_joint(scene, found)


def _by_joint(scene: Scene, found: dict[frozenset[str], list[Finding]]) -> dict[str, Finding]:
    out: dict[str, Finding] = {}
    for pair, findings in found.items():
        worst = max(findings, key=lambda f: f.depth)
        a, b = sorted(pair)
        severity = Severity.WARNING if len(findings) >= OFTEN * POSES else Severity.OK
        message = messages.sentence(
            messages.COMBINATION, first=scene.display_name(a), second=scene.display_name(b),
            depth=messages.length(worst.depth),
        )  # fmt: skip
        for joint in between(scene.obj.tree, a, b):
            other = b if a in scene.obj.tree.descendants(joint.child) else a
            mine = Finding(
                "combination", severity, message, worst.depth, worst.q, worst.where, other
            )
            before = out.get(joint.name)
            if before is None or before.depth < mine.depth:
                out[joint.name] = mine
    return out


def _poses(joints: list[Joint], seed: int) -> Iterator[dict[str, float]]:
    # Additive recurrence of low discrepancy (M. Roberts, 2018), shifted at random.
    low, high = np.array([j.motion_range for j in joints]).T
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (len(joints) + 1))
    alpha = root ** -np.arange(1.0, len(joints) + 1)
    shift = np.random.default_rng(seed).random(len(joints))
    unit = (shift + np.outer(np.arange(1, POSES + 1), alpha)) % 1.0
    for row in low + unit * (high - low):
        yield {j.name: float(v) for j, v in zip(joints, row, strict=True)}


def _pairs(scene: Scene) -> frozenset[frozenset[str]]:
    """Pairs of links with two or more moving joints between them."""
    links = [k for k in scene.obj.tree.order if k in scene.surfaces]
    return frozenset(
        frozenset((a, b))
        for i, a in enumerate(links)
        for b in links[i + 1 :]
        if len(between(scene.obj.tree, a, b)) >= 2
    )


def _near(scene: Scene, path: list[dict[str, float]]) -> frozenset[frozenset[str]]:
    """Pairs of links whose boxes overlap somewhere along the path."""
    links = list(scene.surfaces)
    poses = tree_poses(scene.obj.tree, path)
    still = np.broadcast_to(np.eye(4), (len(path), 4, 4))
    corners = np.stack(
        [np.array(np.meshgrid(*scene.surfaces[k].bounds.T)).reshape(3, -1).T for k in links]
    )
    stacked = np.stack([poses.get(k, still) for k in links])  # (L, K, 4, 4)
    at = np.einsum("lkij,lcj->lkci", stacked[:, :, :3, :3], corners)
    at = at + stacked[:, :, None, :3, 3]
    # Boxes may pass each other between two steps: grow them by what one step moves them.
    step = np.abs(np.diff(at, axis=1)).max(axis=(1, 2, 3), initial=0.0)
    margin = (step[:, None] + step[None])[:, :, None, None] + scene.tolerance
    low, high = at.min(axis=2), at.max(axis=2)  # (L, K, 3)
    apart = (low[:, None] > high[None] + margin) | (low[None] > high[:, None] + margin)
    meets = ~apart.any(axis=3).all(axis=2)
    return frozenset(frozenset((links[i], links[j])) for i, j in np.argwhere(np.triu(meets, 1)))
