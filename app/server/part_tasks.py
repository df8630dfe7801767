"""Jobs on the parts of a segmented asset: cutting them, prediction, validation, and writing the
asset; see :mod:`app.server.tasks`.

Reports of validation are cached on disk. All but the record of an asset is written as a draft while
the person still looks at the joints; accepting adds the record and moves it in place.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.tasks import arrays_of, asset_of
from model.core import codec
from model.core.articulated_object import (
    ArticulatedObject,
    Inertial,
    Part,
    Prediction,
    SegmentedObject,
)
from model.core.errors import ArtiworldError, CommandError, ConfigurationError, KinematicsError
from model.core.files import draft_of, static_assets, written_to
from model.core.joint import Joint, JointType
from model.core.memory import LruCache
from model.core.packages import installed_versions
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.shapes import Shape
from model.core.tree import KinematicTree, moving_chain
from model.geometry.completion import complete, completed_arrays, completed_with
from model.geometry.sampling import sample_surface
from model.geometry.splitting import split
from model.io.assets.asset_folder import write_draft
from model.io.assets.reader import load_object, reload_check
from model.kinematics.siblings import EXACT, SCANNED, carried, fitting, namesakes
from model.kinematics.snapping import (
    axis_along_box,
    box_of,
    on_barrels,
    origin_on_box_edge,
    origin_on_contact,
)
from model.kinematics.sweep import free_range
from model.physics.collision.build import prepare_bodies as prepare
from model.physics.collision.store import fingerprint, load_arrays, save_arrays
from model.physics.simulation_values import physics_of
from model.prediction.geometric.roles import change_joint_type
from model.prediction.registry import load_predictor
from model.segmentation.prompts import BASE
from model.validation.fixes import checked_ranges
from model.validation.report import ValidationReport
from model.validation.runner import scene_of, validate
from sessions.document import Document


@dataclass(frozen=True)
class PartSource:
    """Everything a worker needs to cut an asset into parts.

    Attributes:
        complete: whether scanned parts with joints are completed; None: they aren't.
    """

    folder: Path
    workspace: Path
    labels: str
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    title: str = "object"
    complete: bool | None = None


def source_of(doc: Document, folder: Path, workspace: Path, title: str) -> PartSource:
    """Return the parts of a document with labels; ``folder`` is that of the asset's arrays."""
    assert doc.segmentation is not None
    labels, names = doc.segmentation.labels, doc.part_names
    return PartSource(folder, workspace, labels, names, doc.category, title, doc.complete)


_cut: LruCache[Any, tuple[Part, ...]] = LruCache(2)


def parts_of(source: PartSource) -> tuple[Part, ...]:
    """Return the parts; the last ones are cached, with all that is cached on them."""

    def cut() -> tuple[Part, ...]:
        labels = arrays_of(source.workspace).get(source.labels)
        return split(asset_of(source.folder), labels, source.names)

    names = tuple(sorted(source.names.items()))
    return _cut.get((source.folder, source.labels, names), cut)


def named(part: Part) -> Part:
    """Name part 0 "base": in the app it is by definition, so the predictor need not guess it."""
    if part.link == "link_0" and part.name is None:
        return replace(part, name="base")
    return part


def segmented_object(source: PartSource) -> SegmentedObject:
    """Return the parts as a predictor takes them."""
    return SegmentedObject(source.title, tuple(map(named, parts_of(source))), source.category)


completed_objects: LruCache[Any, ArticulatedObject] = LruCache(2)


def articulated_object(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> ArticulatedObject:
    """Return the parts with joints, and the declared masses and shapes of unchanged parts.

    They are completed where that is asked for, which is cached for the other workers.
    """
    obj = _uncompleted(source, tree)
    if not source.complete:
        return obj
    names = tuple(sorted(source.names.items()))
    key = (source.folder, source.labels, names, source.category, source.title, tree)
    return completed_objects.get(
        key, lambda: _complete(obj, source.workspace / "collision", key, progress)
    )


def _complete(
    obj: ArticulatedObject, store: Path, key: tuple[Any, ...], progress: Progress
) -> ArticulatedObject:
    name = fingerprint("completed", version("artiworld"), *key[:-1], key[-1].joints)
    path = store / f"surface-{name}.npz"  # removed as other surfaces are
    kept = load_arrays(path)
    if kept is not None:
        with suppress(ValueError, KeyError):  # damaged
            return completed_with(obj, kept)
    done = complete(obj, progress)
    save_arrays(path, completed_arrays(done))
    return done


def _uncompleted(source: PartSource, tree: KinematicTree) -> ArticulatedObject:
    inertials, shapes = _declared_physics(source)
    return ArticulatedObject(
        source.title,
        parts_of(source),
        tree,
        source.category,
        {k: i for k, i in inertials.items() if k in tree.links},
        {k: s for k, s in shapes.items() if k in tree.links},
    )


def _declared_physics(
    source: PartSource,
) -> tuple[dict[str, Inertial], dict[str, tuple[Shape, ...]]]:
    """Return declared masses and collision shapes by link, of the parts that are as in the file."""
    asset = asset_of(source.folder)
    if not (asset.inertials or asset.shapes) or asset.element_part is None:
        return {}, {}
    now = np.maximum(arrays_of(source.workspace).get(source.labels), BASE)
    if now.shape != asset.element_part.shape:
        return {}, {}
    differs = now != asset.element_part
    cut = {*np.unique(now[differs]).tolist(), *np.unique(asset.element_part[differs]).tolist()}
    changed = {f"link_{part}" for part in cut}
    return (
        {link: i for link, i in asset.inertials.items() if link not in changed},
        {link: s for link, s in asset.shapes.items() if link not in changed},
    )


def prepare_bodies(source: PartSource, progress: Progress = no_progress) -> None:
    """Compute and cache the parts' collision shapes, where they don't depend on the joints."""
    if source.complete:
        return
    prepare(
        parts_of(source), source.workspace / "collision", progress, _declared_physics(source)[1]
    )


def warm_up(predictor: str) -> None:
    """Load a predictor, and what a scan's surfaces and checks need, which takes seconds."""
    with suppress(ArtiworldError):  # its prediction will say so
        load_predictor(predictor)
    for name in ("open3d", "mujoco"):
        if find_spec(name) is not None:
            import_module(name)


def predict(
    source: PartSource,
    predictor: str,
    locked: tuple[Joint, ...],
    seed: int,
    like: Path | None = None,
    progress: Progress = no_progress,
) -> Prediction:
    """Predict the kinematic tree of the parts.

    Args:
        like: accepted asset that is one more example; predictors that read none say so.
    """
    progress(0.02, "Cutting out the parts")
    segmented = segmented_object(source)
    chosen, remarks = load_predictor(predictor), list[str]()
    if like is not None:
        teach = getattr(chosen, "with_example", None)  # the hybrid's
        taught = teach and teach(load_object(like), like.name)
        if taught is None:
            remarks += [
                f"{predictor} follows no accepted object: joints of {like.name} aren't taken"
            ]
        chosen = taught or chosen
    found: object = chosen.predict(segmented, locked=locked, seed=seed, progress=progress)
    answer = checked(predictor, segmented, found)
    if answer.tree is not None:
        obj = ArticulatedObject(segmented.name, segmented.parts, answer.tree)
        scene, _ = scene_of(obj)
        if scene is not None:
            answer = checked_ranges(answer, scene, {j.child for j in locked})
    return replace(answer, problems=(*answer.problems, *remarks))


def checked(predictor: str, segmented: SegmentedObject, found: object) -> Prediction:
    """Return a plug-in's answer, without its tree where that doesn't fit the parts.

    Raises:
        ConfigurationError: where it is no prediction.
    """
    if not isinstance(found, Prediction):
        kind = type(found).__name__
        raise ConfigurationError(f"predictor {predictor!r} gave a {kind} instead of a Prediction")
    if found.tree is None:
        return found
    try:
        ArticulatedObject(segmented.name, segmented.parts, found.tree)
    except KinematicsError as error:
        return replace(found, tree=None, problems=(*found.problems, *error.problems))
    return found


PACKAGES = static_assets().parent
DEPENDENCIES = ("core", "geometry", "kinematics", "physics", "validation")
"""Packages of the model that a report depends on, with their thresholds."""


def validate_joints(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> ValidationReport:
    """Validate all joints, or return the cached report."""
    cached = _cache_file(source, tree)
    try:
        return codec.read(ValidationReport, json.loads(cached.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        pass

    obj = articulated_object(source, tree, scaled_progress(progress, 0.0, 0.2))
    progress = scaled_progress(progress, 0.2, 1.0)
    report = validate(obj, store=source.workspace / "collision", progress=progress)
    with suppress(OSError, ArtiworldError, ValueError), draft_of(cached) as draft:  # optional
        draft.write_text(json.dumps(codec.write(report)), encoding="utf-8")
    return report


def _cache_file(source: PartSource, tree: KinematicTree) -> Path:
    own = source.folder.name, source.labels, sorted(source.names.items()), source.category
    key = fingerprint("gate", validation_version(), *own, source.complete, tree.links, tree.joints)
    return source.workspace / "cache" / "gate" / f"{key}.json"


@cache
def validation_version(root: Path = PACKAGES) -> str:
    """Return a key of the code, its settings, the material table and the libraries.

    Cached reports count until it changes.

    Args:
        root: folder of the packages.
    """
    digest = hashlib.sha256()
    for package in DEPENDENCIES:
        for path in sorted((root / "model" / package).rglob("*.py")):
            digest.update(f"{path.name}\0".encode() + path.read_bytes())
    digest.update((static_assets() / "physics" / "materials.json").read_bytes())
    versions = installed_versions("artiworld", "mujoco", "numpy", "open3d", "scipy")
    digest.update(repr(versions).encode())
    return digest.hexdigest()


DRAFTS_KEPT = 4


def prepare_asset(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> Path:
    """Write an asset without its record and read it back, so that accepting only moves it.

    Returns:
        The draft's folder, the same for the same parts and joints.

    Raises:
        ArtiworldError: where the written asset doesn't load correctly.
    """
    target = _draft_name(source, tree)
    with suppress(OSError):  # the place to write to is judged where it is written
        os.utime(target)  # now the newest, it is kept longest
        return target
    progress(0.02, "Cutting out the parts")
    asset = asset_of(source.folder)
    obj = articulated_object(source, tree, scaled_progress(progress, 0.02, 0.3))
    physics = physics_of(
        obj, store=source.workspace / "collision", progress=scaled_progress(progress, 0.3, 0.7)
    )
    with written_to(target, "check space and permissions"), draft_of(target, Path.is_dir) as fresh:
        write_draft(
            obj,
            fresh,
            original=asset,
            physics=physics,
            progress=scaled_progress(progress, 0.7, 0.85),
        )
        progress(0.85, "Checking the files")
        problems = reload_check(fresh)
        if problems:
            raise ArtiworldError(f"{obj.name} doesn't load correctly: {problems[0]}")
    _drop_drafts(target.parent)
    return target


def _draft_name(source: PartSource, tree: KinematicTree) -> Path:
    own = source.folder.name, source.labels, sorted(source.names.items()), source.category
    made = source.title, source.complete, tree.links, tree.joints
    return source.workspace / "drafts" / fingerprint("draft", version("artiworld"), *own, *made)


def _drop_drafts(folder: Path) -> None:
    """Remove the oldest drafts, but for those being written."""
    found: list[tuple[float, Path]] = []
    for path in folder.glob("[!.]*"):
        with suppress(FileNotFoundError):  # it was accepted just now
            found.append((path.stat().st_mtime, path))
    for _, old in sorted(found)[:-DRAFTS_KEPT]:
        shutil.rmtree(old, ignore_errors=True)


SWEEP_POINTS = 3000


def snap_joint(source: PartSource, tree: KinematicTree, child: str, to: str) -> Joint:
    """Return the joint of ``child`` snapped to a feature of its part.

    Args:
        to: "axis Long", "axis Middle", "axis Short", "Box edge", "Contact", "Centre" or
            "free range" (limits up to the first collision).
    """
    parts = {p.link: p for p in parts_of(source)}
    joint = tree.joint_of[child]
    # Each joint of a serial chain snaps to the part at its end, and to the next part above.
    chain = moving_chain(tree, child, parts.__contains__)
    moved, above = chain[-1], tree.joint_of[chain[0]].parent
    if moved not in parts:
        raise CommandError(f"{child} carries several parts: it can't be snapped to one")
    points = _surface_points(parts[moved])
    if to == "free range":
        along = points @ np.asarray(joint.axis)
        most = math.pi if joint.rotates else 0.95 * float(np.ptp(along))
        return _with_free_range(source, tree, joint, tuple(parts.values()), most)
    if to.startswith("axis "):
        return axis_along_box(joint, box_of(points), to.removeprefix("axis "))  # type: ignore[arg-type]
    if to == "Box edge":
        return origin_on_box_edge(joint, box_of(points))
    if to == "Centre":
        return replace(joint, origin=tuple(float(v) for v in box_of(points).center))
    if above not in parts:
        raise CommandError(f"{above} has no geometry to touch")
    both = (parts[moved], parts[above])
    found = on_barrels(joint, *both)
    if found is not None:
        return found
    reach = 0.01 * float(np.linalg.norm(np.ptp(points, axis=0)))
    at_contact = origin_on_contact(joint, points, _surface_points(parts[above]), reach)
    # Barrels parallel to the present axis give it more exactly than a contact does.
    found = on_barrels(replace(at_contact, axis=joint.axis), *both) or on_barrels(at_contact, *both)
    return found or at_contact


def equal_parts(source: PartSource, part: int, others: tuple[int, ...]) -> tuple[int, ...]:
    """Return those of ``others`` that have the shape of ``part``, or are its mirror image."""
    links = {f"link_{k}": k for k in (part, *others)}
    points = {links[p.link]: _surface_points(p) for p in parts_of(source) if p.link in links}
    return tuple(
        k for k in others if k in points and part in points and fitting(points[part], points[k])
    )


def joints_like(
    source: PartSource, tree: KinematicTree, child: str, locked: frozenset[str]
) -> tuple[Joint, ...]:
    """Return the joints by which the parts that are equal to ``child`` move as it does.

    Args:
        locked: child links whose joints stay.
    """
    parts = {p.link: p for p in parts_of(source)}
    mine = parts.get(child)
    points = {k: _surface_points(p) for k, p in parts.items() if mine and namesakes(p, mine)}
    joint, out = tree.joint_of[child], []
    within = EXACT if mine is None or mine.cloud is None or not mine.name else SCANNED
    for own in tree.joints:
        apart = own.child not in (child, joint.parent, *locked) and own.child in points
        if not apart or child not in points or own.mimic is not None:
            continue
        for image in fitting(points[child], points[own.child], within)[:1]:
            out.append(replace(carried(joint, own, image), parent=joint.parent))
    return tuple(out)


def change_type(source: PartSource, tree: KinematicTree, child: str, kind: JointType) -> Joint:
    """Return the joint of ``child`` as one of another type."""
    return change_joint_type(segmented_object(source), tree, child, kind)


def _surface_points(part: Part) -> npt.NDArray[np.float64]:
    if part.mesh is not None and len(part.mesh.faces):
        samples, _ = sample_surface(part.mesh, SWEEP_POINTS, np.random.default_rng(0))
        corners = part.mesh.vertices[np.unique(part.mesh.faces)]
        return np.concatenate([samples.points.astype(np.float64), corners])
    assert part.cloud is not None
    points = part.cloud.points.astype(np.float64)
    if len(points) > 4 * SWEEP_POINTS:
        keep = np.random.default_rng(0).choice(len(points), 4 * SWEEP_POINTS, replace=False)
        points = points[keep]
    return points


def _with_free_range(
    source: PartSource, tree: KinematicTree, joint: Joint, parts: tuple[Part, ...], most: float
) -> Joint:
    lower, upper = free_range(ArticulatedObject(source.title, parts, tree), joint.name, most)
    closed_below, closed_above = joint.lower == 0.0, joint.upper == 0.0
    return replace(
        joint,
        lower=0.0 if closed_below else float(lower),
        upper=0.0 if closed_above else float(upper),
    )
