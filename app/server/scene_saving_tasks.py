"""Writing a scene in the worker process: its assets, the files of ``artiworld scene convert``, and
a report with a picture and the state of each object.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from app.server.names import part_title
from app.server.part_tasks import PartSource, articulated_object
from app.server.scene_tasks import SceneItem, Shape, placed
from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ArtiworldError, CommandError, InputFileError
from model.core.files import write_json
from model.core.geometry import Mesh, PointCloud, merged
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.core.tables import write_page
from model.core.tree import KinematicTree, holds_part
from model.geometry import drawing
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import read_provenance
from model.io.file_names import FileNames
from model.physics.simulation_values import physics_of
from model.scenes.asset_parts import asset_digest
from model.scenes.convert import ConvertSettings, alone, asset_job, shorten_limits
from model.scenes.jobs import (
    ACCEPTED,
    ASSETS,
    FAILED,
    MISSING,
    PLAIN,
    PREDICTED,
    REJECTED,
    STATIC,
    TODO,
    ConvertAsset,
    read_done,
    write_formats,
)
from model.scenes.registry import read_scene
from model.scenes.results import SCENE_JSON, Outcome, write_results
from model.scenes.scene import Decision, SceneProblem
from sessions.document import Document

STATES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "predicted": ("predicted, not reviewed", (146, 130, 190)),
    "on_hold": ("on hold: accepted, and refused by the checks", (190, 120, 60)),
    "todo": ("to do: no joints yet", (214, 182, 122)),
    "rejected": ("rejected", (205, 95, 95)),
    "accepted": ("accepted", (110, 170, 120)),
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
        document: the decisions about its working copy, or None.
        notes: notes for the reader.
        source: its parts, to draw it.
        work: id of the working copy that it shares with its twins.
    """

    item: SceneItem
    status: str
    confidence: float
    decided: bool | None
    document: Document | None
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
                entry["shortened"] = [
                    {**c, "joint": own.get(c["joint"], c["joint"])} for c in shortened
                ]
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
    doc = row.document
    if doc is None or doc.tree is None:
        return []
    shorter = {c["joint"]: c for c in saved.get("shortened", ())}
    return [_joint(doc, joint, shorter.get(joint.name)) for joint in doc.tree.joints if joint.moves]


def _joint(doc: Document, joint: Joint, shorter: Mapping[str, Any] | None) -> tuple[str, str]:
    limits = (joint.lower or 0.0, joint.upper or 0.0) if joint.limited else None
    confidence, note = confidences(doc).get(joint.child), ""
    if shorter is not None and _same(limits, shorter["was"]):
        hits = ", ".join(dict.fromkeys(shorter["hits"].values()))
        was = "" if limits is None else f", was{_span(joint, limits)}"
        limits = shorter["limits"]
        note = f"in the saved scene limited by {hits}{was}"
    name = part_title(doc, joint.child) if holds_part(joint.child) else joint.name
    span = "" if limits is None else _span(joint, limits)
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
        found = placed(row.item, shapes)
        if found is None:
            continue
        shape, world, scale = found
        faces = None if shape.faces is None else shape.faces.astype(np.int32)
        at = (shape.vertices * scale) @ world[:3, :3].T + world[:3, 3]
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
    view = drawing.View(azimuth=-1.05, elevation=0.6, width=1100, height=620)
    return drawing.png(
        drawing.draw(whole, colors={link: STATES[link.split()[0]][1] for link in links}, view=view)
    )


def _thumbnail(row: ReportRow) -> bytes | None:
    assert row.source is not None and row.document is not None and row.document.tree is not None
    try:
        obj = articulated_object(row.source, row.document.tree)
    except ArtiworldError:
        return None
    colors = drawing.part_colors([p.link for p in obj.parts], obj.tree.root)
    shown = drawing.draw(
        obj,
        colors=colors,
        q=drawing.half_open(obj),
        joints=True,
        view=drawing.View(azimuth=-math.pi / 2 - 0.6, width=220, height=180),
    )
    return drawing.png(shown)


ASSET_SECONDS = 1800.0
"""Longest time for one rigid asset, collision shapes included."""


@dataclass(frozen=True, eq=False)
class MovingCopy:
    """A working copy that moves in the saved scene.

    Attributes:
        document: the decisions about it, with its joints.
        bounds: (2, 3) of its asset, at the asset's own size.
    """

    source: PartSource
    document: Document
    bounds: list[list[float]]


def confidences(doc: Document) -> Mapping[str, float]:
    """Return child link → confidence of the predicted joints."""
    return {} if doc.prediction is None else doc.prediction.confidence


@dataclass(frozen=True)
class Decided:
    """The decision about an articulable object.

    Attributes:
        state: ``accepted``, ``predicted``, ``rejected`` or ``todo``; the last two are rigid.
        reason: human-readable.
        by, at: author and time; "" without a decision.
    """

    state: str
    reason: str = ""
    by: str = ""
    at: str = ""


def save_scene(
    path: Path,
    format: str,
    ids: Sequence[str],
    items: Sequence[SceneItem],
    copies: Mapping[Path, MovingCopy],
    decided: Mapping[str, Decided],
    out: Path,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write the scene and its assets into ``out``; assets that are there already stay.

    Args:
        format, ids: the reader and the objects of the scene's file when it was opened.
        items: the present objects, those that were picked out of others among them.
        copies: working copy → the copy that moves.
        decided: articulable object → the decision about it.

    Returns:
        The summary, as ``artiworld scene convert`` gives it.

    Raises:
        ConfigurationError: where another server saves the scene at the moment.
    """
    progress(0.0, "reading")
    scene = read_scene(path, format)
    if [o.id for o in scene.objects] != list(ids):
        raise CommandError(f"{path} was changed since it was opened: restart the server")
    scene = replace(scene, objects=tuple(i.obj for i in items))
    with alone(out):
        (out / ASSETS).mkdir(parents=True, exist_ok=True)
        made: dict[str, dict[str, Any]] = {}
        outcomes: list[Outcome] = []
        for k, item in enumerate(items):
            progress(0.8 * k / len(items), item.obj.id)
            outcome = Outcome(item.obj, item.decision, item.path, item.truth)
            outcomes.append(outcome)
            if item.obj.box is not None:
                outcome.state, outcome.reason = PLAIN, "a plain box without an asset"
            elif item.problem:
                outcome.state, outcome.reason = FAILED, item.problem
            elif item.path is None:
                outcome.state, outcome.reason = MISSING, "its asset is in none of the folders"
            else:
                try:
                    _write_object(outcome, item, copies, out, made)
                    _apply_decision(outcome, decided.get(item.obj.id))
                except ArtiworldError as error:
                    outcome.state, outcome.reason, outcome.key = FAILED, str(error), None
        shorten_limits(outcomes, out, progress)
        progress(0.97, "writing")
        summary = write_results(scene, outcomes, out, free_bases=True, formats=_formats())
        write_json(out / "summary.json", summary, indent=1)
        for folder in (out / ASSETS).iterdir():
            if folder.name not in made:  # left from a former save
                shutil.rmtree(folder, ignore_errors=True)
    return summary


def _formats() -> tuple[str, ...]:
    """Return the formats of the scene besides MJCF."""
    return ("sdf", "usd") if find_spec("pxr") is not None else ("sdf",)


def _write_object(
    outcome: Any,
    item: SceneItem,
    copies: Mapping[Path, MovingCopy],
    out: Path,
    made: dict[str, dict[str, Any]],
) -> None:
    moving = None if item.copy is None else copies.get(item.copy)
    if moving is None:
        report = _rigid(item, out, made)
    else:
        assert item.copy is not None
        report = made.get(item.copy.name) or _moving_asset(item, moving, out)
    outcome.key, outcome.report = report["key"], report
    made[report["key"]] = report
    outcome.state, outcome.reason = report["state"], report["reason"]


def _apply_decision(outcome: Outcome, decided: Decided | None) -> None:
    """Record the decision about a written object; a rigid one may only be waiting for one."""
    if decided is None:
        return
    outcome.by, outcome.at = decided.by, decided.at
    if decided.state in (REJECTED, TODO) and outcome.state == STATIC:
        outcome.state, outcome.reason = decided.state, decided.reason


def _rigid(item: SceneItem, out: Path, made: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    assert item.path is not None
    settings = ConvertSettings(seconds=ASSET_SECONDS, collision=True, formats=_formats())
    rigid = Outcome(item.obj, Decision(False), item.path)
    job = asset_job(rigid, asset_digest(item.path), settings)
    report = made.get(job.key) or read_done(out, job.key)
    return report or ConvertAsset(out, {job.key: job}, os.getpid())(job.key)


def _moving_asset(item: SceneItem, moving: MovingCopy, out: Path) -> dict[str, Any]:
    """Write a working copy as an asset below ``out``."""
    assert item.copy is not None and item.path is not None
    key, doc = item.copy.name, moving.document
    folder, accepted = out / ASSETS / key, doc.review.state == "accepted"
    saved = Path(doc.saved.folder) if accepted and doc.saved is not None else None
    assert doc.tree is not None
    store = moving.source.workspace / "collision"
    shutil.rmtree(folder, ignore_errors=True)
    # Not read from the accepted files: the collision shapes of these very parts are cached.
    obj = articulated_object(moving.source, doc.tree)
    physics = physics_of(obj, store=store)
    names = FileNames.of(obj)
    if saved is not None and saved.is_dir():
        shutil.copytree(saved, folder)
        names = FileNames.stored(read_provenance(folder)["asset"])
    else:
        source = {"path": item.path.name, "sha256": asset_digest(item.path)}
        write_asset(
            obj,
            folder,
            physics=physics,
            provenance={"source": source, "review": "predicted, not accepted"},
        )
    obj, confidence = names.object(obj), names.by_link(confidences(doc))
    write_formats(obj, folder, _formats(), names.physics(physics))
    joints = [
        {**asdict(j), "confidence": confidence.get(j.child)} for j in obj.tree.joints if j.moves
    ]
    state = PREDICTED if saved is None else ACCEPTED
    return {
        "key": key,
        "state": state if joints else STATIC,
        "reason": f"accepted by {doc.review.by}" if accepted else "",
        "bounds": moving.bounds,
        "joints": joints,
    }
