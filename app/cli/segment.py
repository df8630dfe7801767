"""``artiworld prepare`` and ``segment``: level, size and clean a scan; segmentation from files to
files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from app.cli import output
from app.cli.commands import PrepareCommand, SegmentCommand
from app.cli.output import Result, check_output, check_replaceable
from app.server.prompt_file import PromptFile, check_prompts, read_prompts
from model.core.articulated_object import Part
from model.core.asset import Asset, Source
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.files import write_json, written_to
from model.core.geometry import affine
from model.core.progress import Progress, scaled_progress
from model.geometry.prepare import Prepared, PrepareSettings, Vector, prepare, tilt_remark
from model.geometry.splitting import split
from model.geometry.units import UNITS, odd_size
from model.io.geometry_files import declares_up, default_up_axis, turned_up
from model.io.masks import read_masks, with_masks
from model.io.open_asset import open_asset
from model.io.write import mesh_to_glb, write_cloud, write_mesh
from model.segmentation.prompts import PartSegmentation, Prompts, Region
from model.segmentation.registry import load_segmenter

FORMAT = 1
"""Version of ``prepare.json``."""


def prepare_scan(options: PrepareCommand, progress: Progress) -> Result:
    """Write ``object.ply``, or ``object.glb`` for a mesh, ``kept.npy`` and ``prepare.json``.

    Raises:
        ArtiworldError: where the scan can't be read, nothing is left of it, or the folder can't be
            written.
    """
    scan, out = options.scan, options.out
    settings = PrepareSettings(
        options.up, options.height, options.length, options.unit_scale, options.keep_support
    )
    check_output(out, scan, *([] if scan.is_dir() else [scan.parent]))
    axis = "z" if settings.up is not None or scan.is_dir() else default_up_axis(scan)
    asset = open_asset(scan, up_axis=axis, progress=scaled_progress(progress, 0.0, 0.4))
    turn = turned_up(axis)
    if settings.length is not None:
        a, b, metres = settings.length
        settings = replace(settings, length=(_turned(turn, a), _turned(turn, b), metres))
    found = prepare(asset, settings, scaled_progress(progress, 0.4, 0.5))
    progress(0.9, f"writing {out}")
    out.mkdir(parents=True, exist_ok=True)
    if found.asset.mesh is not None:
        target = out / "object.glb"
        target.write_bytes(mesh_to_glb(found.asset.mesh, y_up=True))
    else:
        assert found.asset.cloud is not None
        target = out / "object.ply"
        write_cloud(found.asset.cloud, target)
    np.save(out / "kept.npy", found.kept)
    report = {
        "format": FORMAT,
        "object": target.name,
        "object_from_source": _from_file(found, asset.source, turn),
        "up_in_source": _turned(turn.T, found.levelling.up),
        "confidence": round(found.levelling.confidence, 4),
        "tilt_degrees": round(float(np.degrees(found.levelling.tilt)), 2),
        "alternatives": [_turned(turn.T, v) for v in found.levelling.alternatives],
        "size": np.ptp(found.asset.bounds, axis=0).round(6).tolist(),
        "kept": "kept.npy",
        "elements": {"of": asset.element_kind, "kept": len(found.kept)},
        "removed": found.removed,
        "source": {"file": scan.name, "sha256": asset.source.sha256 if asset.source else None},
        "problems": list(found.asset.warnings),
    }
    write_json(out / "prepare.json", report)
    progress(1.0, "prepared")
    return Result(report, lambda: _print_prepared(report, out))


def _print_prepared(report: dict[str, Any], out: Path) -> None:
    """Print how ``prepare`` turned a scan and what it took away."""
    x, y, z = report["size"]
    output.console().print(
        f"up {vector_text(report['up_in_source'])} in the file, "
        f"tilted by {report['tilt_degrees']:.0f}°, confidence {100 * report['confidence']:.0f} %"
    )
    output.console().print(
        f"{x:.3g} × {y:.3g} × {z:.3g} m, {report['elements']['kept']:,} elements kept"
    )
    if report["removed"]:
        taken = ", ".join(f"{n:,} of {kind}" for kind, n in report["removed"].items())
        output.console().print(f"taken away: {taken} (--keep-support keeps all but outliers)")
    output.print_notes(report["problems"])
    output.console().print(f"written to {out}")


def vector_text(values: list[float]) -> str:
    """A vector with three digits behind the point."""
    return " ".join(f"{v + 0.0:.3f}" for v in values)


def _from_file(
    found: Prepared, source: Source | None, turn: npt.NDArray[np.float64]
) -> list[list[float]]:
    """(4, 4) object_from_source of the file's own numbers, row by row."""
    taken = affine(shift=-np.asarray(source.shift if source else (0, 0, 0)))
    return (found.object_from_source @ taken @ turn).tolist()


def _turned(matrix: npt.NDArray[np.float64], vector: Vector) -> Vector:
    x, y, z = (matrix[:3, :3] @ vector).tolist()
    return x, y, z


"""Version of ``object.json``."""
OBJECT_JSON = "object.json"
_PART_FILES = re.compile(r"link_\d+\.(obj|mtl|ply)|texture_[0-9a-f]{12}\.(png|jpg)")


def segment(options: SegmentCommand, progress: Progress) -> Result:
    """Cut a scan into parts by the clicks of a prompt file, by masks, or by clicks on masks.

    Writes ``link_<id>.obj`` (or ``.ply`` for a cloud) for each part, +z up and in metres, and
    ``object.json``, which ``artiworld predict`` reads. They replace an earlier result.

    Raises:
        ArtiworldError: naming the file and the place of the mistake.
    """
    scan, prompts, masks, out = options.scan, options.prompts, options.masks, options.out
    if prompts is None and masks is None:
        raise ConfigurationError("nothing says what the parts are: give --prompts or --masks")
    file = PromptFile(scan, Prompts(()), {}) if prompts is None else read_prompts(prompts)
    check_output(out, scan, *([] if scan.is_dir() else [scan.parent]))
    check_replaceable(out, lambda names: _is_earlier(out, names))
    chosen = load_segmenter(options.segmentation.segmenter)
    progress(0.0, f"reading {scan.name}")
    reading = options.reading
    asset = open_asset(scan, up_axis=reading.up_axis, unit_scale=reading.unit_scale)
    check_prompts(file, asset)
    read = None if masks is None else read_masks(masks)
    if read is not None:
        asset = with_masks(asset, read)
        file = _on_masks(file, asset)
    if prompts is None and asset.element_part is not None:
        answer = PartSegmentation(asset.element_part.astype(np.int16), "masks")
    else:
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
        **({} if read is None else {"masks": read.origin}),
        "seconds": round(answer.seconds, 6),
        "problems": _problems(asset, file, parts),
    }
    write_json(out / OBJECT_JSON, report)
    progress(1.0, "done")
    return Result(report, lambda: _print_parts(report, out))


def _on_masks(file: PromptFile, asset: Asset) -> PromptFile:
    """The prompts after a region for each part that the masks tell."""
    assert asset.element_part is not None
    held = range(len(asset.part_names))
    regions = [Region(i, np.flatnonzero(asset.element_part == i), True) for i in held]
    named = {i: name for i, name in enumerate(asset.part_names) if name}
    known = (r for r in regions if len(r.elements))
    return replace(
        file, prompts=Prompts((*known, *file.prompts.items)), names={**named, **file.names}
    )


def _is_earlier(out: Path, names: set[str]) -> bool:
    """True if a folder with these files holds an earlier result, or only hidden files."""
    try:
        found = json.loads((out / OBJECT_JSON).read_text())
    except (OSError, ValueError):
        found = None
    hidden = all(name.startswith(".") for name in names)
    return hidden or (isinstance(found, dict) and "segmenter" in found)


def _problems(asset: Asset, file: PromptFile, parts: Sequence[Part]) -> list[str]:
    found = {part.link for part in parts}
    missing = [i for i in file.prompts.parts if f"link_{i}" not in found and i != 0]
    out = [*asset.warnings, *(f"part {i} got no {asset.element_kind}" for i in missing)]
    odd = odd_size(asset.bounds, asset.source.unit_scale if asset.source else 1.0)
    declared = asset.source is not None and declares_up(asset.source.path)
    if asset.element_part is None and (remark := tilt_remark(asset, declared)):
        out.append(remark)
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


def _write_parts(parts: Sequence[Part], out: Path) -> list[dict[str, Any]]:
    """Replace the part files of an earlier result.

    They are written to a folder aside first: where that fails, the earlier result stays whole.
    """
    with written_to(out, "check space and permissions"):
        out.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".parts.", dir=out) as aside:
            entries = [_write_part(part, Path(aside)) for part in parts]
            (out / OBJECT_JSON).unlink(missing_ok=True)  # written last: it marks a whole result
            for path in out.iterdir():
                if _PART_FILES.fullmatch(path.name):
                    path.unlink()
            for path in Path(aside).iterdir():
                path.rename(out / path.name)
    return entries


def _write_part(part: Part, out: Path) -> dict[str, Any]:
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


def _print_parts(report: dict[str, Any], out: Path) -> None:
    elements = f"{report['source']['elements']}s"
    rows = [
        {"file": p["file"], "name": p.get("name") or "", elements: p["count"]}
        for p in report["parts"]
    ]
    output.print_records(f"{report['name']} in {len(rows)} parts", rows)
    output.print_notes(report["problems"])
    output.console().print(f"written to {out}")
