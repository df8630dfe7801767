"""``artiworld predict``: prediction from files to files, here or by an ArtiWorld backend."""

from __future__ import annotations

import json
import math
import os
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.cli import output
from app.cli.commands import PredictCommand
from app.cli.options import PredictorOptions
from app.cli.output import Result, check_output, check_replaceable
from app.cli.segment import vector_text
from model.core.articulated_object import ArticulatedObject, Prediction, SegmentedObject, remarks_of
from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.core.files import write_json
from model.core.geometry import PointCloud
from model.core.joint import JOINT_KINDS, Joint
from model.core.names import category_remark
from model.core.packages import installed_versions
from model.core.progress import Progress, scaled_progress
from model.core.tree import KinematicTree
from model.geometry import completion
from model.geometry.prepare import tilt_remark
from model.geometry.sampling import sample_surface
from model.io.assets.asset_folder import write_asset
from model.io.file_names import FileNames
from model.io.open_asset import read_part_files
from model.physics.collision.store import default_store
from model.physics.simulation_values import Physics, physics_of, plain_physics
from model.prediction import TOKEN_VARIABLE, is_backend
from model.prediction.registry import DEFAULT, load_predictor
from model.prediction.remote_backend import BackendError, BackendRefused, HttpPredictor


def chosen_predictor(options: PredictorOptions) -> str:
    """The predictor's name, or the backend's address.

    The token goes into the environment, where worker processes find it.

    Raises:
        ConfigurationError: where both a backend and another predictor are given, or the address
            can't be one.
    """
    url = options.backend
    if url is None and is_backend(options.predictor):
        url = options.predictor
    if url is None:
        if options.backend_token:
            raise ConfigurationError("a backend's token is given, but no --backend")
        return options.predictor
    if options.predictor not in (DEFAULT, url):
        raise ConfigurationError(
            f"--backend and --predictor {options.predictor} exclude each other: "
            "the backend has its own"
        )
    if options.backend_token:
        os.environ[TOKEN_VARIABLE] = options.backend_token
    return HttpPredictor(url).url


def check_backend(url: str) -> None:
    """Warn on stderr where a backend can't be reached yet; predictions fail until it can.

    Raises:
        BackendRefused: where it refuses the token.
    """
    try:
        HttpPredictor(url, connect_seconds=3.0, silence_seconds=3.0).check()
    except BackendRefused:
        raise
    except BackendError as error:
        print(f"artiworld: {error}; the app asks again at every prediction", file=sys.stderr)


FORMAT = 1
"""Version of ``prediction.json``."""
PREDICTION_JSON = "prediction.json"
_SAMPLES = 100_000
"""Points of meshes that are looked at for their up direction."""
URDF_PRECISION = 1e-5
"""Metres or radians: a saved URDF rounds numbers to less than this."""


class NothingPredicted(RuntimeError):
    """The predictor gave no tree; ``prediction.json`` holds the reason."""


def predict(options: PredictCommand, progress: Progress) -> Result:
    """Predict the joints of a folder of part meshes.

    Writes ``object.urdf``, ``tree.json``, ``meshes/``, ``provenance.json`` and ``prediction.json``.
    Masses are those that a URDF declares, else those of the table of materials. Collision shapes
    take long: they are made with ``--collision``, or where a URDF declares those of every part.

    Raises:
        ArtiworldError: where the input can't be used.
        NothingPredicted: where the predictor found no tree.
    """
    folder, out, reading = options.folder, options.out, options.reading
    predictor = chosen_predictor(options.prediction)
    check_output(out, folder)
    check_replaceable(out, lambda f: "provenance.json" in f or f == {PREDICTION_JSON})
    chosen = load_predictor(predictor)
    progress(0.0, f"reading {folder}")
    segmented = read_part_files(folder, up_axis=reading.up_axis, unit_scale=reading.unit_scale)
    if options.category:
        segmented = replace(segmented, category=options.category)
    answer = chosen.predict(
        segmented, seed=options.seed, progress=scaled_progress(progress, 0.1, 0.65)
    )
    if answer.tree is not None:
        segmented, answer = _named_for_files(segmented, answer, answer.tree)
    report = prediction_json(segmented, answer)
    if remark := category_remark(options.category):
        report["problems"].insert(0, remark)
    whole = Asset(segmented.name, cloud=PointCloud(_points(segmented)))
    report["problems"] += filter(None, [tilt_remark(whole, declared=not _scanned(segmented))])
    if answer.tree is None:
        write_json(out / PREDICTION_JSON, report)
        why = "; ".join(answer.problems) or "no reason was given"
        raise NothingPredicted(f"{predictor} found no kinematic tree for {folder}: {why}")
    obj = _articulated(segmented, answer.tree)
    if options.complete:
        obj = completion.complete(obj, scaled_progress(progress, 0.65, 0.7))
        report["completed"] = {p.link: list(p.completed) for p in obj.parts if p.completed}
    physics = _physics(obj, options.collision, scaled_progress(progress, 0.7, 0.8))
    report["kilograms"] = round(sum(i.mass for i in physics.inertials.values()), 4)
    report["collision_shapes"] = sum(map(len, physics.collision.values()))
    report["collision_from_source"] = list(physics.declared_shapes)
    progress(0.8, f"writing {out}")
    provenance = {"source": str(folder), "predictor": report["backend"]}
    provenance["seed"] = options.seed
    provenance["versions"] = installed_versions("artiworld", "numpy", "scipy")
    (out / PREDICTION_JSON).unlink(missing_ok=True)  # of a failed run
    write_asset(
        obj,
        out.absolute(),
        provenance=provenance,
        physics=physics,
        progress=scaled_progress(progress, 0.8, 1.0),
    )
    write_json(out / PREDICTION_JSON, report)
    progress(1.0, "done")
    return Result(report, lambda: _print(report, out))


def _physics(obj: ArticulatedObject, collision: bool, progress: Progress) -> Physics:
    if collision or all(p.link in obj.shapes for p in obj.parts):
        return physics_of(obj, store=default_store(), progress=progress)
    return plain_physics(obj)


def _articulated(segmented: SegmentedObject, tree: KinematicTree) -> ArticulatedObject:
    """The parts with ``tree``; what a source declares of links that are in no joint is left out."""
    inertials = {k: i for k, i in segmented.inertials.items() if k in tree.links}
    shapes = {k: each for k, each in segmented.shapes.items() if k in tree.links}
    return ArticulatedObject(
        segmented.name, segmented.parts, tree, segmented.category, inertials, shapes
    )


def _named_for_files(
    segmented: SegmentedObject, answer: Prediction, tree: KinematicTree
) -> tuple[SegmentedObject, Prediction]:
    """Parts and prediction with the names that the asset's files use."""
    obj = _articulated(segmented, tree)
    names = FileNames.of(obj)
    parts = names.object(obj).parts
    inertials, shapes = names.by_link(segmented.inertials), names.by_link(segmented.shapes)
    confidence, notes = names.by_link(answer.confidence), names.by_link(answer.notes)
    return (
        replace(segmented, parts=parts, inertials=inertials, shapes=shapes),
        replace(answer, tree=names.tree(tree), confidence=confidence, notes=notes),
    )


def _scanned(segmented: SegmentedObject) -> bool:
    return any(p.mesh is None for p in segmented.parts)


def _points(segmented: SegmentedObject) -> npt.NDArray[np.float32]:
    """(N, 3) of all surfaces."""
    meshes = [p.mesh for p in segmented.parts if p.mesh is not None]
    area = max(sum(float(m.face_areas.sum()) for m in meshes), 1e-12)
    rng = np.random.default_rng(0)
    sampled = [
        sample_surface(m, 1 + int(_SAMPLES * m.face_areas.sum() / area), rng)[0].points
        for m in meshes
        if m.face_areas.sum() > 0
    ]
    scans = [p.cloud.points for p in segmented.parts if p.mesh is None and p.cloud is not None]
    return np.concatenate([*sampled, *scans])


def prediction_json(segmented: SegmentedObject, answer: Prediction) -> dict[str, Any]:
    """``prediction.json``: lengths in metres, angles in radians, all in the object frame."""
    tree = answer.tree
    return {
        "format": FORMAT,
        "name": segmented.name,
        "category": segmented.category,
        "backend": answer.backend,
        "seed": answer.seed,
        "seconds": round(answer.seconds, 6),
        "problems": [*remarks_of(segmented.parts), *answer.problems],
        "base": tree.root if tree is not None else None,
        "links": list(tree.links) if tree is not None else [],
        "parts": [{"link": part.link, "name": part.name} for part in segmented.parts],
        "joints": [_joint_json(j, answer) for j in tree.joints] if tree is not None else [],
        "raw_text": answer.raw_text,
    }


def _joint_json(joint: Joint, answer: Prediction) -> dict[str, Any]:
    return {
        "name": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "axis": list(joint.axis),
        "origin": list(joint.origin),
        "limits": [joint.lower, joint.upper] if joint.limited else None,
        "mimic": asdict(joint.mimic) if joint.mimic is not None else None,
        "confidence": answer.confidence.get(joint.child),
        "note": answer.notes.get(joint.child),
    }


def predicted_confidence(folder: Path, tree: KinematicTree) -> dict[str, float]:
    """Child link → confidence, 0..1, of the joints that are still as :func:`predict` wrote them.

    Empty where ``folder`` holds no prediction; a joint that a person changed is left out.
    """
    try:
        joints = json.loads((folder / PREDICTION_JSON).read_text(encoding="utf-8"))["joints"]
        return {
            j["child"]: float(j["confidence"])
            for j in joints
            if j["confidence"] is not None and _same_joint(j, tree.joint_of.get(j["child"]))
        }
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _same_joint(predicted: dict[str, Any], joint: Joint | None) -> bool:
    """True if a joint agrees with ``prediction.json`` within the precision of a URDF."""
    if joint is None or (predicted["type"], predicted["parent"]) != (joint.type, joint.parent):
        return False
    if not joint.moves:
        return True
    numbers = [*predicted["axis"], *predicted["origin"], *(predicted["limits"] or ())]
    limits = (joint.lower, joint.upper) if joint.limited else ()
    have = (*joint.axis, *joint.origin, *(v for v in limits if v is not None))
    return len(numbers) == len(have) and all(
        abs(a - b) < URDF_PRECISION for a, b in zip(numbers, have, strict=True)
    )


def _print(report: dict[str, Any], out: Path) -> None:
    names = {part["link"]: part["name"] for part in report["parts"]}
    rows = []
    for joint in report["joints"]:
        moves, confidence = joint["type"] != "fixed", joint["confidence"]
        rows.append(
            {
                "joint": joint["name"],
                **{key: joint[key] for key in ("type", "parent", "child")},
                "part": names.get(joint["child"]) or "",
                "axis": vector_text(joint["axis"]) if moves else "",
                "origin (m)": vector_text(joint["origin"]) if moves else "",
                "limits": _limits_text(joint["type"], joint["limits"]),
                "confidence": "" if confidence is None else f"{100 * confidence:.0f} %",
            }
        )
    output.print_records(
        f"{report['name']}: base {report['base']}, {report['backend']}, {report['seconds']:.2f} s",
        rows,
    )
    output.print_notes(report["problems"])
    shapes = report["collision_shapes"] or "no"
    hint = "" if report["collision_shapes"] else " (--collision makes them)"
    output.console().print(f"{report['kilograms']:.3g} kg, {shapes} collision shapes{hint}")
    output.console().print(f"written to {out}")


def _limits_text(kind: str, limits: list[float] | None) -> str:
    """Limits with their unit: degrees or millimetres."""
    if limits is None:
        return ""
    scale, unit = (1000.0, " mm") if JOINT_KINDS[kind].slides else (180.0 / math.pi, "°")
    low, high = (round(v * scale) + 0 for v in limits)
    return f"{low}…{high}{unit}"
