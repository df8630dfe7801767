"""A report on an open scene: a picture, and the state of each object with its reason.

The page loads nothing from elsewhere and runs no scripts.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.server.part_tasks import PartSource, articulated_object
from app.server.scene_shapes import Shape
from app.server.scene_tasks import SceneItem
from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ArtiworldError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.evaluation import render
from model.evaluation.html_report import write_page
from model.io.assets.reader import read_provenance
from model.io.urdf.meshes import merged
from model.scenes.results import SCENE_JSON
from model.scenes.scene import SceneProblem

STATES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "predicted": ("predicted, not reviewed", (128, 90, 213)),
    "on_hold": ("on hold: accepted, and refused by the checks", (168, 92, 26)),
    "todo": ("to do: no joints yet", (237, 160, 40)),
    "rejected": ("rejected", (224, 49, 49)),
    "accepted": ("accepted", (47, 158, 68)),
    "static": ("static", (196, 200, 206)),
    "failed": ("failed: unreadable asset", (90, 96, 104)),
    "missing": ("missing", (90, 96, 104)),
}
"""State → label and colour, in the order of the page."""
TEMPLATE = Path(__file__).with_name("scene_report.html")


@dataclass(frozen=True, eq=False)
class ReportRow:
    """One object on the page.

    Attributes:
        item: as the scene has it.
        status: its state.
        confidence: of its least confident joint, or of the finder.
        decided: whether a person called it articulable; None where nobody decided.
        tree, confidences: its joints and their confidence by child link.
        names: link → display name.
        by, at, reason: who decided last, when, and why it was rejected.
        notes: notes for the reader.
        source: its parts, to draw it.
        work: id of the working copy that it shares with its twins.
    """

    item: SceneItem
    status: str
    confidence: float
    decided: bool | None
    tree: KinematicTree | None
    confidences: Mapping[str, float]
    names: Mapping[str, str]
    by: str
    at: str
    reason: str
    notes: tuple[str, ...]
    source: PartSource | None
    work: int | None


def write_report(
    path: Path,
    name: str,
    rows: Sequence[ReportRow],
    problems: Sequence[SceneProblem],
    shapes: Mapping[Path, Shape | str],
    workspace: Path,
    progress: Progress = no_progress,
    *,
    saved: Path | None = None,
) -> Path:
    """Write the page.

    Args:
        saved: folder of the last save; limits that surroundings shorten are shown as saved.

    Raises:
        InputFileError: where it can't be written.
    """
    order = list(STATES)
    rows = sorted(rows, key=lambda r: (order.index(r.status), r.confidence))
    progress(0.05, "drawing the scene")
    picture = _scene_picture(rows, shapes)
    drawn: dict[int, bytes | None] = {}
    for k, row in enumerate(rows):
        if row.work is not None and row.source is not None and row.work not in drawn:
            progress(0.1 + 0.85 * k / len(rows), row.item.obj.id)
            drawn[row.work] = _thumbnail(row)
    entries = _saved_entries(saved)
    known = [r for r in rows if r.item.truth]  # their asset is known to move
    return write_page(
        path, TEMPLATE, name=name, rows=rows, states=STATES, counts=Counter(r.status for r in rows),
        picture=picture, problems=problems, drawn=drawn, known=len(known),
        found=sum(r.item.decision.articulable for r in known),
        notes=lambda row: _notes(row, entries.get(row.item.obj.id, {})),
        joints=lambda row: _joints(row, entries.get(row.item.obj.id, {})),
    )  # fmt: skip


def _saved_entries(folder: Path | None) -> dict[str, dict[str, Any]]:
    """Return object → its entry in the saved scene; empty where that is gone."""
    if folder is None:
        return {}
    try:
        entries = json.loads((folder / SCENE_JSON).read_text(encoding="utf-8"))
        found = {o["id"]: o for o in entries["objects"]}
        for entry in found.values():
            if shortened := entry.get("shortened"):  # under the names of the asset's files
                kept = read_provenance(folder / entry["asset_folder"])["asset"].get("names", {})
                own = kept.get("joints", {})
                entry["shortened"] = [{**c, "joint": own.get(c["joint"], c["joint"])}
                                      for c in shortened]  # fmt: skip
    except (InputFileError, OSError, ValueError, KeyError, TypeError):
        return {}
    return found


def _notes(row: ReportRow, saved: Mapping[str, Any]) -> list[str]:
    notes = list(row.notes)
    if saved.get("held"):
        notes.append(f"Its base is fixed in the saved scene: it {saved['held']}")
    for name in dict.fromkeys(p["through"] for p in saved.get("passes", ())):
        notes.append(f"Starts inside {name}, and passes through it in the saved scene")
    return notes


def _joints(row: ReportRow, saved: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return a line for each moving joint, and a note where the saved scene shortens its range."""
    if row.tree is None:
        return []
    shorter = {c["joint"]: c for c in saved.get("shortened", ())}
    return [_joint(row, joint, shorter.get(joint.name)) for joint in row.tree.joints if joint.moves]


def _joint(row: ReportRow, joint: Joint, shorter: Mapping[str, Any] | None) -> tuple[str, str]:
    limits = (joint.lower or 0.0, joint.upper or 0.0) if joint.limited else None
    confidence, note = row.confidences.get(joint.child), ""
    if shorter is not None and _same(limits, shorter["was"]):
        hits = ", ".join(dict.fromkeys(shorter["hits"].values()))
        was = "" if limits is None else f", was{_span(joint, limits)}"
        limits = shorter["limits"]
        note = f"in the saved scene limited by {hits}{was}"
    name, span = (
        row.names.get(joint.child, joint.name),
        "" if limits is None else _span(joint, limits),
    )
    certainty = "" if confidence is None else f", confidence {100 * confidence:.0f} %"
    return f"{name}: {joint.type}{span}{certainty}", note


def _span(joint: Joint, limits: Sequence[float]) -> str:
    low, high = limits
    if joint.rotates:
        return f" {math.degrees(low):.0f}…{math.degrees(high):.0f}°"
    return f" {1000 * low:.0f}…{1000 * high:.0f} mm"


def _same(limits: Sequence[float] | None, was: Sequence[float] | None) -> bool:
    """True if a joint still has the limits of the last save."""
    if limits is None or was is None:
        return limits is was
    return bool(np.allclose(limits, was, atol=1e-4))


def _scene_picture(rows: Sequence[ReportRow], shapes: Mapping[Path, Shape | str]) -> bytes | None:
    by_state: dict[str, list[Mesh]] = {}
    scanned: dict[str, list[np.ndarray]] = {}
    for row in rows:
        obj = row.item.obj
        if obj.box is not None:
            corners = np.array([[i >> k & 1 for k in range(3)] for i in range(8)]) - 0.5
            shape, scale, world = corners, np.asarray(obj.box), obj.world_from_object
            faces = _BOX_FACES
        else:
            found = None if row.item.path is None else shapes.get(row.item.path)
            if not isinstance(found, Shape):
                continue
            placed = obj.placed(found.bounds)
            shape, scale, world = found.vertices, placed.scale, placed.world_from_asset
            faces = None if found.faces is None else found.faces.astype(np.int32)
        at = (shape * scale) @ world[:3, :3].T + world[:3, 3]
        if faces is None:
            scanned.setdefault(row.status, []).append(at.astype(np.float32))
        else:
            by_state.setdefault(row.status, []).append(Mesh(at, faces))
    solid = [Part(state, merged(meshes)) for state, meshes in by_state.items()]
    parts = tuple(solid) + tuple(
        Part(f"{state} scans", None, PointCloud(np.concatenate(points)))
        for state, points in scanned.items()
    )
    if not parts:
        return None
    links = tuple(p.link for p in parts)
    fixed = tuple(Joint(link, "fixed", links[0], link, (0, 0, 1), (0, 0, 0)) for link in links[1:])
    whole = ArticulatedObject("scene", parts, KinematicTree(links, fixed))
    view = render.View(azimuth=-1.05, elevation=0.6, width=1100, height=620)
    return render.png(
        render.draw(whole, colors={link: STATES[link.split()[0]][1] for link in links}, view=view)
    )


def _thumbnail(row: ReportRow) -> bytes | None:
    assert row.source is not None and row.tree is not None
    try:
        obj = articulated_object(row.source, row.tree)
    except ArtiworldError:
        return None
    colors = render.part_colors([p.link for p in obj.parts], obj.tree.root)
    shown = render.draw(
        obj, colors=colors, q=render.half_open(obj), joints=True,
        view=render.View(azimuth=-math.pi / 2 - 0.6, width=220, height=180),
    )  # fmt: skip
    return render.png(shown)


_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], np.int32,
)  # fmt: skip
