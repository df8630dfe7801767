"""The validation runner: every joint over its range, alone, with others, and in simulation.

Some collisions happen only when several joints move.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.core.names import display_name
from model.core.progress import Progress, no_progress
from model.kinematics.sweep import diagonal_of, surfaces_of, sweep_path, sweep_tolerance, tree_poses
from model.physics.simulation_values import physics_of
from model.validation import messages
from model.validation.engines import ENGINES, MUJOCO
from model.validation.examine import Scene, between, examine
from model.validation.fixes import find_fixes, unlike_findings
from model.validation.messages import length, value
from model.validation.physics import run_physics
from model.validation.report import (
    Finding,
    JointReport,
    PhysicsReport,
    Severity,
    Stop,
    ValidationReport,
    worst_first,
)
from model.validation.support import loose_parts

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
            messages.COMBINATION,
            first=scene.display_name(a),
            second=scene.display_name(b),
            depth=messages.length(worst.depth),
        )
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


TOUCHING = 0.01
"""Largest gap that counts as touching, in the object's diagonal."""
AFLOAT = 0.04
"""Gap above which a part that touches nothing is an error, in the object's diagonal; scans and CAD
leave smaller ones."""
STOPPED = 0.5
"""Share of its range from which a joint that stops short in simulation is an error."""
MANY = 10
"""Moving joints from which each is sampled more coarsely."""

Findings = dict[str, list[Finding]]
"""Joint name → its findings."""


def validate(
    obj: ArticulatedObject,
    *,
    seed: int = 0,
    physics: bool = True,
    shapes: bool = True,
    store: Path | None = None,
    fixes: bool = True,
    engines: Sequence[str] = (MUJOCO,),
    progress: Progress = no_progress,
) -> ValidationReport:
    """Check every joint of ``obj``.

    Args:
        seed: random seed of the poses in which several joints move.
        physics: whether to drive the joints in ``engines``, where they are installed.
        shapes: whether the parts collide there with the shapes that are exported. An object with
            errors is driven without: it will be changed, and making shapes takes seconds.
        store: folder that keeps collision shapes between runs; None keeps none.
        fixes: whether to search for fixes.
        engines: names of :data:`model.validation.engines.ENGINES`; the first one's result is the
            report's ``physics``.
        progress: called for each step; may raise to stop.

    Returns:
        A report on each moving joint, worst first; on fixed joints only where they have findings.
    """
    start = time.perf_counter()
    scene, unusable = scene_of(obj)
    found: Findings = {j.name: [] for j in obj.tree.joints if j.moves}
    for link, why in unusable.items():
        _assign(obj, found, link, Finding("geometry", Severity.ERROR, why))
    if scene is not None:
        _check_motion(scene, found, seed, progress)
    runs: list[PhysicsReport] = []
    if physics and not unusable:
        errors = any(f.severity == Severity.ERROR for each in found.values() for f in each)
        runs = _simulate(obj, shapes and not errors, store, engines, progress)
    for run in runs:
        _add_physics(obj, run, found)
    joints = []
    for k, (name, findings) in enumerate(found.items()):
        progress(0.9 + 0.1 * k / max(len(found), 1), messages.SEARCHING_FIXES)
        joint = obj.tree.by_name[name]
        ordered = worst_first(findings)
        offered = find_fixes(scene, joint, ordered) if fixes and scene is not None else ()
        joints.append(JointReport(name, joint.child, ordered, offered))
    joints.sort(key=lambda j: j.sort_key)
    diagonal = scene.diagonal if scene is not None else 0.0
    seconds = time.perf_counter() - start
    first = runs[0] if runs else None
    return ValidationReport(tuple(joints), diagonal, first, seconds, tuple(runs[1:]))


def _check_motion(scene: Scene, found: Findings, seed: int, progress: Progress) -> None:
    """Run all checks but the simulation."""
    obj = scene.obj
    _check_support(scene, found)
    moving = [j for j in obj.tree.joints if j.moves]
    for k, joint in enumerate(moving):
        name = display_name(obj, joint.child)
        progress(0.55 * k / max(len(moving), 1), messages.SWEEPING.format(part=name))
        found[joint.name] += examine(scene, joint)
    for name, finding in unlike_findings(scene, found).items():
        found.setdefault(name, []).append(finding)
    known = frozenset(
        frozenset((link, f.other))
        for joint in moving
        for f in found[joint.name]
        if f.kind in ("collision", "jammed") and f.other is not None
        for link in obj.tree.descendants(joint.child)
    )
    together = combination_findings(
        scene, known, seed, lambda fraction, message: progress(0.55 + 0.15 * fraction, message)
    )
    for name, finding in together.items():
        found[name].append(finding)


def scene_of(obj: ArticulatedObject) -> tuple[Scene | None, dict[str, str]]:
    """Surfaces and scale of the object, None where no part is usable; link → why one isn't."""
    unusable = {p.link: why for p in obj.parts if (why := _unusable(p))}
    usable = _without_geometry(obj, unusable) if unusable else obj
    moving = sum(j.moves for j in obj.tree.joints)
    points, samples = (2048, 25) if moving < MANY else (1024, 13)
    surfaces = surfaces_of(usable, points)
    if not surfaces:
        return None, unusable
    scale = diagonal_of(surfaces), sweep_tolerance(surfaces)
    return Scene(usable, surfaces, *scale, samples, points), unusable


def _without_geometry(obj: ArticulatedObject, unusable: dict[str, str]) -> ArticulatedObject:
    """The object with empty meshes in place of its unusable parts: their links stay."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    parts = tuple(
        Part(p.link, nothing, None, p.name) if p.link in unusable else p for p in obj.parts
    )
    return replace(obj, parts=parts)


def _unusable(part: Part) -> str:
    """Why a part can't be measured, or "". (Parts with NaN are refused before.)"""
    mesh, cloud = part.mesh, part.cloud
    at = mesh.vertices if mesh is not None and len(mesh.faces) else None
    at = cloud.points if at is None and cloud is not None and len(cloud) else at
    if at is None:
        return messages.NO_GEOMETRY
    return "" if np.ptp(at, axis=0).any() else messages.SINGLE_POINT


def _assign(obj: ArticulatedObject, found: Findings, link: str, finding: Finding) -> None:
    """Add a finding about a part to the joint that moves it, of the root to its children's."""
    joint = obj.tree.joint_of.get(link)
    if joint is not None:
        found.setdefault(joint.name, []).append(finding)
        return
    message = messages.sentence(
        messages.OF_PART, part=display_name(obj, link), message=finding.message
    )
    for child in obj.tree.children(link):
        name = obj.tree.joint_of[child].name
        found.setdefault(name, []).append(replace(finding, message=message))


def _check_support(scene: Scene, found: Findings) -> None:
    touching = max(TOUCHING * scene.diagonal, 1.5 * scene.tolerance)
    for link, (gap, other) in loose_parts(scene.obj.tree, scene.surfaces, touching).items():
        message = messages.FLOATING
        if other is not None:
            nearest = scene.display_name(other)
            message = messages.FLOATING_NEAR.format(gap=length(gap), nearest=nearest)
        severity = Severity.ERROR if gap > AFLOAT * scene.diagonal else Severity.WARNING
        center = scene.surfaces[link].bounds.mean(axis=0)
        at = (float(center[0]), float(center[1]), float(center[2]))
        finding = Finding("floating", severity, message, gap, {}, at, other)
        _assign(scene.obj, found, link, finding)


def _simulate(
    obj: ArticulatedObject,
    shapes: bool,
    store: Path | None,
    engines: Sequence[str],
    progress: Progress,
) -> list[PhysicsReport]:
    """Drive the joints with the exported physics, or with masses and joints alone."""

    def from_share(start: float, share: float = 0.1) -> Progress:
        return lambda fraction, message: progress(start + share * fraction, message)

    made = None
    if shapes and any(ENGINES[engine].installed for engine in engines):
        made = physics_of(obj, store=store, progress=from_share(0.7))
    share = 0.1 / max(len(engines), 1)
    return [
        run_physics(obj, made, engine=engine, progress=from_share(0.8 + k * share, share))
        for k, engine in enumerate(engines)
    ]


def _add_physics(obj: ArticulatedObject, report: PhysicsReport, found: Findings) -> None:
    """Add the findings of the simulation."""
    for name, how in report.exploded.items():
        if name in found:
            stop = report.stops.get(name, Stop({}))
            message = messages.EXPLODED.format(engine=report.engine, how=how)
            # Without the other link: shrinking the shapes of this joint's motion is no fix.
            found[name].append(
                Finding(
                    "physics",
                    Severity.ERROR,
                    message,
                    0.0,
                    stop.q,
                    stop.where,
                    engine=report.engine,
                )
            )
    for name, share in report.drifted.items():
        if name in found and name not in report.exploded:
            message = messages.DRIFTS.format(engine=report.engine, percent=f"{100 * share:.0f}")
            found[name].append(Finding("physics", Severity.WARNING, message, engine=report.engine))
    for name, share in report.missed.items():
        if name in found and name not in report.exploded:
            found[name].append(_stopped(obj, report, name, share, found[name]))


def _stopped(
    obj: ArticulatedObject, report: PhysicsReport, name: str, share: float, known: list[Finding]
) -> Finding:
    """A joint that stops short of its limit in simulation."""
    stop, cause = report.stops[name], ""
    if stop.other is not None:
        at = value(obj.tree.by_name[name], stop.q[name])
        cause = messages.CAUSE_BLOCKED.format(at=at, other=display_name(obj, stop.other))
    message = messages.STOPS_SHORT.format(
        engine=report.engine, percent=f"{100 * share:.0f}", cause=cause
    )
    severity = Severity.ERROR if share > STOPPED else Severity.WARNING
    if any(f.kind == "collision" and f.severity == Severity.OK for f in known):
        severity = Severity.OK  # free once another part is out of the way
    return Finding("physics", severity, message, 0.0, stop.q, stop.where, stop.other, report.engine)
