"""The gate: every joint over its range, alone, together with others, and in physics."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject, Part
from model.core.progress import Progress, no_progress
from model.kinematics.sweep import diagonal_of, surfaces_of, sweep_tolerance
from model.physics.simulation_values import physics_of
from model.validation.combinations import combination_findings
from model.validation.examine import Scene, examine
from model.validation.fixes import mends_for
from model.validation.phrases import length, title, value
from model.validation.physics import run_physics, simulator_installed
from model.validation.physics_report import PhysicsReport, Stop
from model.validation.report import Finding, GateReport, JointVerdict, Verdict, worst_first
from model.validation.support import loose_parts

TOUCHING = 0.01
"""Gap that still counts as touching, in the object's diagonal."""
AFLOAT = 0.04
"""Gap above which a part that touches nothing is broken, in the object's diagonal; scans and CAD
leave smaller ones."""
STOPPED = 0.5
"""Share of its range that a joint may fall short of in the simulator to be worth a look only."""
MANY = 10
"""Moving joints from which on each gets fewer samples."""


def run_gate(
    obj: ArticulatedObject,
    *,
    seed: int = 0,
    physics: bool = True,
    shapes: bool = True,
    store: Path | None = None,
    mends: bool = True,
    progress: Progress = no_progress,
) -> GateReport:
    """Judge every joint of ``obj``.

    Args:
        seed: of the poses in which joints stand together.
        physics: whether to drive the joints in MuJoCo too, where it is installed.
        shapes: whether the parts collide there with the shapes that are exported. What is broken
            already is driven without: it will be changed, and making them takes seconds.
        store: where collision shapes are kept between runs; None keeps none.
        mends: whether to look for mends of what is wrong.
        progress: told of each step; may stop it.

    Returns:
        A verdict on each joint, worst first; fixed joints only where something is wrong with them.
    """
    start = time.perf_counter()
    unusable = {p.link: why for p in obj.parts if (why := _unusable(p))}
    scene = _scene(obj, unusable)
    found: dict[str, list[Finding]] = {j.name: [] for j in obj.tree.joints if j.moves}
    for link, why in unusable.items():
        _blame(obj, found, link, Finding("geometry", "broken", why))
    if scene is not None:
        _look(scene, found, seed, progress)
    said = None
    if physics and not unusable:
        broken = any(f.verdict == "broken" for each in found.values() for f in each)
        said = _simulate(obj, shapes and not broken, store, progress)
        _take_physics(obj, said, found)
    joints = []
    for k, (name, findings) in enumerate(found.items()):
        progress(0.9 + 0.1 * k / max(len(found), 1), "Looking for mends")
        joint = obj.tree.by_name[name]
        ordered = worst_first(findings)
        offered = mends_for(scene, joint, ordered) if mends and scene is not None else ()
        joints.append(JointVerdict(name, joint.child, ordered, offered))
    joints.sort(key=lambda j: j.place)
    diagonal = scene.diagonal if scene is not None else 0.0
    return GateReport(tuple(joints), diagonal, said, time.perf_counter() - start)


def _look(scene: Scene, found: dict[str, list[Finding]], seed: int, progress: Progress) -> None:
    """Everything but physics."""
    obj = scene.obj
    _floating(scene, found)
    moving = [j for j in obj.tree.joints if j.moves]
    for k, joint in enumerate(moving):
        progress(0.55 * k / max(len(moving), 1), f"Sweeping {title(obj, joint.child)}")
        found[joint.name] += examine(scene, joint)
    known = frozenset(
        frozenset((link, f.other))
        for joint in moving
        for f in found[joint.name]
        if f.kind in ("collision", "jammed") and f.other is not None
        for link in obj.tree.descendants(joint.child)
    )

    def tell(fraction: float, message: str) -> None:
        progress(0.55 + 0.15 * fraction, message)

    together = combination_findings(scene, known, seed, tell)
    for name, finding in together.items():
        found[name].append(finding)


def _scene(obj: ArticulatedObject, unusable: dict[str, str]) -> Scene | None:
    """What is measured once; None where no part can be used."""
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
    """The object whose unusable parts are empty: their links stay."""
    from model.core.mesh import Mesh

    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    parts = tuple(
        Part(p.link, nothing, None, p.name) if p.link in unusable else p for p in obj.parts
    )
    return replace(obj, parts=parts)


def _unusable(part: Part) -> str:
    """Why nothing can be measured of a part, or "". (No part holds NaN: it is refused before.)"""
    mesh, cloud = part.mesh, part.cloud
    at = mesh.vertices if mesh is not None and len(mesh.faces) else None
    at = cloud.points if at is None and cloud is not None and len(cloud) else at
    if at is None:
        return "The part has no face and no point."
    if not np.ptp(at, axis=0).any():
        return "The part is a single point."
    return ""


def _blame(
    obj: ArticulatedObject, found: dict[str, list[Finding]], link: str, finding: Finding
) -> None:
    """Put a finding about a part to the joint that moves it; of the root's to its children's."""
    joint = obj.tree.joint_of.get(link)
    named = (
        [joint] if joint is not None else [obj.tree.joint_of[c] for c in obj.tree.children(link)]
    )
    for one in named:
        said = finding
        if joint is None:
            said = replace(finding, sentence=f"Of {title(obj, link)}: {finding.sentence}")
        found.setdefault(one.name, []).append(said)


def _floating(scene: Scene, found: dict[str, list[Finding]]) -> None:
    touching = max(TOUCHING * scene.diagonal, 1.5 * scene.tolerance)
    for link, (gap, other) in loose_parts(scene.obj.tree, scene.surfaces, touching).items():
        near = "" if other is None else f"; {scene.titled(other)} is {length(gap)} away"
        said = f"Touches nothing that holds it{near}."
        verdict = "broken" if gap > AFLOAT * scene.diagonal else "look"
        center = scene.surfaces[link].bounds.mean(axis=0)
        at = (float(center[0]), float(center[1]), float(center[2]))
        _blame(scene.obj, found, link, Finding("floating", verdict, said, gap, {}, at, other))


def _simulate(
    obj: ArticulatedObject, shapes: bool, store: Path | None, progress: Progress
) -> PhysicsReport:
    """Drive the joints with what exporters write, or with masses and joints alone."""

    def tell(start: float) -> Progress:
        return lambda fraction, message: progress(start + 0.1 * fraction, message)

    made = None
    if shapes and simulator_installed():
        made = physics_of(obj, store=store, progress=tell(0.7))
    return run_physics(obj, made, progress=tell(0.8))


def _take_physics(
    obj: ArticulatedObject, said: PhysicsReport, found: dict[str, list[Finding]]
) -> None:
    for name, what in said.exploded.items():
        if name in found:
            stop = said.stops.get(name, Stop({}))
            sentence = f"In MuJoCo it {what}."
            # What pushes it stays unnamed here: smaller shapes for its own motion are no cure.
            found[name].append(Finding("physics", "broken", sentence, 0.0, stop.q, stop.where))
    for name, share in said.drifted.items():
        if name in found and name not in said.exploded:
            text = f"In MuJoCo it drifts by {100 * share:.0f} % of its range while others move."
            found[name].append(Finding("physics", "look", text))
    for name, share in said.missed.items():
        if name in found and name not in said.exploded:
            found[name].append(_stopped(obj, said, name, share, found[name]))


def _stopped(
    obj: ArticulatedObject, said: PhysicsReport, name: str, share: float, known: list[Finding]
) -> Finding:
    """A joint that doesn't get to its limit in the simulator."""
    stop = said.stops[name]
    text = f"In MuJoCo it stops {100 * share:.0f} % of its range short of its limit"
    if stop.other is not None:
        at = value(obj.tree.by_name[name], stop.q[name])
        text += f", at {at}, where its collision shapes meet those of {title(obj, stop.other)}"
    verdict: Verdict = "broken" if share > STOPPED else "look"
    if any(f.kind == "collision" and f.verdict == "fine" for f in known):
        verdict = "fine"  # free once another part is moved out of the way
    return Finding("physics", verdict, f"{text}.", 0.0, stop.q, stop.where, stop.other)
