"""What ``artiworld segment`` and ``predict`` do: files in, files out, no browser."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from app.server.prompt_file import PromptFile, check_prompts, read_prompts
from model.core.articulated_object import (
    ArticulatedObject,
    Part,
    Prediction,
    SegmentedObject,
    remarks_of,
)
from model.core.asset import Asset, UpAxis
from model.core.errors import ArtiworldError, ConfigurationError, InputFileError
from model.core.joint import Joint
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tree import KinematicTree
from model.prediction.registry import DEFAULT

FORMAT = 1
OBJECT_JSON = "object.json"
PREDICTION_JSON = "prediction.json"
_OF_PARTS = re.compile(r"link_\d+\.(obj|mtl|ply)|texture_[0-9a-f]{12}\.(png|jpg)")


class NothingPredicted(RuntimeError):
    """The predictor gave no tree; ``prediction.json`` says why."""


@dataclass(frozen=True)
class ReadOptions:
    """How files are read: see :func:`model.io.open_asset.read_asset`."""

    up_axis: UpAxis | None = None
    unit_scale: float = 1.0


def segment(
    scan: Path,
    prompts: Path,
    out: Path,
    *,
    segmenter: str = "default",
    reading: ReadOptions | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Cut ``scan`` into parts by the clicks of a prompt file.

    Writes ``link_<id>.obj`` (or ``.ply`` for a cloud) for each part, +z up and in metres, and
    ``object.json``, which :func:`predict` reads. They take the place of an earlier result.

    Returns:
        What ``object.json`` holds.

    Raises:
        ArtiworldError: naming the file and the place of the mistake.
    """
    from model.geometry.parts import split
    from model.io.open_asset import read_asset
    from model.segmentation.registry import load_segmenter

    reading = reading or ReadOptions()
    file = read_prompts(prompts)
    check_output(out, scan, *_folder_of(scan))
    _check_holds_no_other(out)
    chosen = load_segmenter(segmenter)
    progress(0.0, f"reading {scan.name}")
    asset = read_asset(scan, up_axis=reading.up_axis, unit_scale=reading.unit_scale)
    check_prompts(file, asset)
    session = chosen.encode(asset, scaled_progress(progress, 0.1, 0.7))
    progress(0.7, "segmenting")
    answer = session.segment(file.prompts)
    parts = split(asset, answer.labels, file.names)
    progress(0.9, f"writing {out}")
    report = {
        "format": FORMAT,
        "name": asset.name,
        "category": file.category or asset.category,
        "parts": _write_parts(parts, out),
        "source": _source_json(asset, scan),
        "segmenter": answer.segmenter or chosen.name,
        "seconds": round(answer.seconds, 6),
        "problems": _problems(asset, file, parts),
    }
    write_json(out / OBJECT_JSON, report)
    progress(1.0, "done")
    return report


def _problems(asset: Asset, file: PromptFile, parts: Sequence[Part]) -> list[str]:
    from model.geometry.units import UNITS, odd_size

    found = {part.link for part in parts}
    missing = [i for i in file.prompts.parts if f"link_{i}" not in found and i != 0]
    out = [*asset.warnings, *(f"part {i} got no {asset.element_kind}" for i in missing)]
    odd = odd_size(asset.bounds, asset.source.unit_scale if asset.source else 1.0)
    if odd is not None:
        remedy = "" if odd.unit is None else f" If so, give --unit-scale {UNITS[odd.unit]:g}"
        out.append(odd.question + remedy)
    return out


def _source_json(asset: Asset, scan: Path) -> dict[str, Any]:
    return {
        "file": scan.name,
        "sha256": asset.source.sha256 if asset.source else None,
        "elements": asset.element_kind,
        "count": asset.element_count,
        "remarks": list(asset.warnings),
    }


def predict(
    folder: Path,
    out: Path,
    *,
    predictor: str = DEFAULT,
    category: str | None = None,
    seed: int = 0,
    reading: ReadOptions | None = None,
    collision: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Predict the joints of a folder of part meshes.

    Writes ``object.urdf``, ``tree.json``, ``meshes/``, ``provenance.json`` and ``prediction.json``.
    Masses are those that a URDF tells of its links, else those of the table of materials; there are
    collision shapes only with ``collision``, as they take long, or where a URDF tells those of
    every part.

    Returns:
        What ``prediction.json`` holds.

    Raises:
        ArtiworldError: where the input can't be used.
        NothingPredicted: where the predictor found no tree.
    """
    from model.core.part_names import category_remark
    from model.io.assets.asset_folder import write_asset
    from model.io.open_asset import read_part_files
    from model.physics.collision.store import default_store
    from model.physics.simulation_values import physics_of, plain_physics
    from model.prediction.registry import load_predictor

    reading = reading or ReadOptions()
    check_output(out, folder)
    _check_replaceable(out)
    chosen = load_predictor(predictor)
    progress(0.0, f"reading {folder}")
    segmented = read_part_files(folder, up_axis=reading.up_axis, unit_scale=reading.unit_scale)
    if category:
        segmented = replace(segmented, category=category)
    near = category_remark(category)
    answer = chosen.predict(segmented, seed=seed, progress=scaled_progress(progress, 0.1, 0.7))
    report = prediction_json(segmented, answer)
    report["problems"][:0] = [near] if near else []
    if answer.tree is None:
        write_json(out / PREDICTION_JSON, report)
        why = "; ".join(answer.problems) or "no reason was given"
        raise NothingPredicted(f"{predictor} found no kinematic tree for {folder}: {why}")
    told = {k: i for k, i in segmented.inertials.items() if k in answer.tree.links}
    shapes = {k: held for k, held in segmented.shapes.items() if k in answer.tree.links}
    made = ArticulatedObject(
        segmented.name, segmented.parts, answer.tree, segmented.category, told, shapes
    )
    if collision or all(p.link in shapes for p in made.parts):
        physics = physics_of(
            made, store=default_store(), progress=scaled_progress(progress, 0.7, 0.8)
        )
    else:
        physics = plain_physics(made)
    report["kilograms"] = round(sum(i.mass for i in physics.inertials.values()), 4)
    report["collision_shapes"] = sum(map(len, physics.collision.values()))
    report["collision_from_source"] = list(physics.told_shapes)
    progress(0.8, f"writing {out}")
    provenance = {
        "source": str(folder), "predictor": report["backend"], "seed": seed, "versions": versions(),
    }  # fmt: skip
    (out / PREDICTION_JSON).unlink(missing_ok=True)  # of a run that found nothing
    write_asset(
        made, out.absolute(), provenance=provenance, physics=physics,
        progress=scaled_progress(progress, 0.8, 1.0),
    )  # fmt: skip
    write_json(out / PREDICTION_JSON, report)
    progress(1.0, "done")
    return report


def prediction_json(segmented: SegmentedObject, answer: Prediction) -> dict[str, Any]:
    """``prediction.json``: lengths in metres, angles in radians, all in the object frame."""
    joints = answer.tree.joints if answer.tree is not None else ()
    return {
        "format": FORMAT,
        "name": segmented.name,
        "category": segmented.category,
        "backend": answer.backend,
        "seed": answer.seed,
        "seconds": round(answer.seconds, 6),
        "problems": [*remarks_of(segmented.parts), *answer.problems],
        "base": answer.tree.root if answer.tree is not None else None,
        "links": list(answer.tree.links) if answer.tree is not None else [],
        "parts": [{"link": part.link, "name": part.name} for part in segmented.parts],
        "joints": [_joint_json(joint, answer) for joint in joints],
        "raw_text": answer.raw_text,
    }


def _joint_json(joint: Joint, answer: Prediction) -> dict[str, Any]:
    limits = [joint.lower, joint.upper] if joint.limited else None
    mimic = None
    if joint.mimic is not None:
        mimic = {
            "joint": joint.mimic.joint,
            "multiplier": joint.mimic.multiplier,
            "offset": joint.mimic.offset,
        }
    return {
        "name": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "axis": list(joint.axis),
        "origin": list(joint.origin),
        "limits": limits,
        "mimic": mimic,
        "confidence": answer.confidence.get(joint.child),
        "note": answer.notes.get(joint.child),
    }


def predicted_sure(folder: Path, tree: KinematicTree) -> dict[str, float]:
    """Child link → confidence, 0..1, of the joints that are as :func:`predict` wrote them.

    Returns:
        Nothing where ``folder`` holds no such prediction: what a person accepted is no guess.
    """
    try:
        told = json.loads((folder / PREDICTION_JSON).read_text(encoding="utf-8"))["joints"]
        return {
            j["child"]: float(j["confidence"])
            for j in told
            if j["confidence"] is not None and _same_joint(j, tree.joint_of.get(j["child"]))
        }
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _same_joint(told: dict[str, Any], joint: Joint | None) -> bool:
    """Whether a joint is the one that was told, as far as URDF keeps numbers."""
    if joint is None or (told["type"], told["parent"]) != (joint.type, joint.parent):
        return False
    if not joint.moves:
        return True
    numbers = [*told["axis"], *told["origin"], *(told["limits"] or ())]
    limits = (joint.lower, joint.upper) if joint.limited else ()
    have = (*joint.axis, *joint.origin, *(v for v in limits if v is not None))
    return len(numbers) == len(have) and all(
        abs(a - b) < 1e-5 for a, b in zip(numbers, have, strict=True)
    )


def check_output(out: Path, *inputs: Path, option: str = "--out") -> None:
    """Refuse an output folder that can't be one, or that would overwrite what is read.

    Args:
        option: what names the folder.

    Raises:
        ConfigurationError: with what to do.
    """
    try:
        taken = out.exists() and not out.is_dir()
    except (OSError, ValueError) as error:  # too long, or nothing that a file can be called
        why = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"{option} {str(out)[:80]}… can't be a folder ({why}); give another name"
        ) from error
    if taken:
        raise ConfigurationError(f"{option} {out} is a file; give a folder")
    for source in inputs:
        if os.path.realpath(out) == os.path.realpath(source):  # where links lead in a circle, too
            raise ConfigurationError(f"{option} {out} is where the input is; give another folder")
    above = next((p for p in (out, *out.absolute().parents) if p.exists()), Path("/"))
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise ConfigurationError(f"{option} {out} can't be written; choose a folder of your own")


def _check_replaceable(out: Path) -> None:
    """Saving replaces the whole folder, so it must be new or an earlier result."""
    if not out.is_dir():
        return
    held = {path.name for path in out.iterdir()}
    if held and "provenance.json" not in held and held != {PREDICTION_JSON}:
        raise ConfigurationError(f"--out {out} holds other files; give a new or an empty folder")


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` at once or not at all.

    Raises:
        InputFileError: where the folder can't be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        draft.write_bytes(text.encode("utf-8", "backslashreplace"))  # half a surrogate: \ud800
        draft.replace(path)
    except OSError as error:
        raise InputFileError(path, f"can't be written: {error.strerror}") from error


def versions() -> dict[str, str]:
    """Versions that a result depends on."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    out = {"python": platform.python_version()}
    for name in ("artiworld", "numpy", "scipy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out


def _check_holds_no_other(out: Path) -> None:
    """What :func:`segment` writes replaces its earlier result, and nothing else."""
    if not out.is_dir() or all(path.name.startswith(".") for path in out.iterdir()):
        return
    try:
        told = json.loads((out / OBJECT_JSON).read_text())
    except (OSError, ValueError):
        told = None
    if not isinstance(told, dict) or "segmenter" not in told:
        raise ConfigurationError(f"--out {out} holds other files; give a new or an empty folder")


def _write_parts(parts: Sequence[Part], out: Path) -> list[dict[str, Any]]:
    """All parts in the place of those of an earlier result, whose files would be taken for theirs.

    They are written aside first: where that fails, the earlier result stays whole.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".parts.", dir=out) as aside:
            entries = [_write_part(part, Path(aside)) for part in parts]
            (out / OBJECT_JSON).unlink(missing_ok=True)  # comes last: with it the folder is whole
            for path in out.iterdir():
                if _OF_PARTS.fullmatch(path.name):
                    path.unlink()
            for path in Path(aside).iterdir():
                path.rename(out / path.name)
    except OSError as error:
        raise InputFileError(
            out, f"can't be written: {error.strerror or error}", "check space and permissions"
        ) from error
    return entries


def _folder_of(scan: Path) -> Sequence[Path]:
    return [] if scan.is_dir() else [scan.parent]


def _write_part(part: Part, out: Path) -> dict[str, Any]:
    from model.io.write.meshes import write_cloud, write_mesh

    if part.mesh is not None:
        files = write_mesh(part.mesh, out / f"{part.link}.obj")
        count = len(part.mesh.faces)
    elif part.cloud is not None:
        files = write_cloud(part.cloud, out / f"{part.link}.ply")
        count = len(part.cloud)
    else:  # Part's constructor forbids it
        raise ArtiworldError(f"part {part.link} has no geometry")
    entry: dict[str, Any] = {"file": files[0].name, "count": count}
    return entry if part.name is None else {"file": files[0].name, "name": part.name, **entry}
