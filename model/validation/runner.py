"""The validation runner: every joint over its range, alone, with others, and in simulation."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject, Part
from model.core.display_names import display_name
from model.core.mesh import Mesh
from model.core.progress import Progress, no_progress
from model.kinematics.sweep import diagonal_of, surfaces_of, sweep_tolerance
from model.physics.simulation_values import physics_of
from model.validation import messages
from model.validation.combinations import combination_findings
from model.validation.engines import ENGINES, MUJOCO
from model.validation.examine import Scene, examine
from model.validation.fixes import find_fixes
from model.validation.messages import length, value
from model.validation.physics import run_physics
from model.validation.physics_report import PhysicsReport, Stop
from model.validation.report import (
    Finding,
    JointReport,
    Severity,
    ValidationReport,
    worst_first,
)
from model.validation.support import loose_parts

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
    unusable = {p.link: why for p in obj.parts if (why := _unusable(p))}
    scene = _scene(obj, unusable)
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


def _scene(obj: ArticulatedObject, unusable: dict[str, str]) -> Scene | None:
    """Surfaces and scale of the object; None where no part is usable."""
    usable = _without_geometry(obj, unusable) if unusable else obj
    moving = sum(j.moves for j in obj.tree.joints)
    points, samples = (2048, 25) if moving < MANY else (1024, 13)
    surfaces = surfaces_of(usable, points)
    if not surfaces:
        return None
    return Scene(
        usable, surfaces, diagonal_of(surfaces), sweep_tolerance(surfaces), samples, points
    )


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
    obj: ArticulatedObject, shapes: bool, store: Path | None, engines: Sequence[str],
    progress: Progress,
) -> list[PhysicsReport]:  # fmt: skip
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
                Finding("physics", Severity.ERROR, message, 0.0, stop.q, stop.where,
                        engine=report.engine)
            )  # fmt: skip
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
