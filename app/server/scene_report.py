"""A report on an open scene: a picture, and the state of each object with its reason.

The page loads nothing from elsewhere and runs no scripts. Every name is escaped.
"""

from __future__ import annotations

import base64
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from app.server.part_tasks import PartSource, articulated_object
from app.server.scene_shapes import Shape
from app.server.scene_tasks import SceneItem
from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ArtiworldError, InputFileError
from model.core.joint import Joint
from model.core.mesh import Mesh
from model.core.point_cloud import PointCloud
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.evaluation import render
from model.io.urdf.meshes import merged
from model.scenes.results import SCENE_JSON
from model.scenes.scene import SceneProblem

STATES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "predicted": ("predicted, not reviewed", (128, 90, 213)),
    "todo": ("to do: no joints yet", (237, 160, 40)),
    "rejected": ("rejected", (224, 49, 49)),
    "accepted": ("accepted", (47, 158, 68)),
    "static": ("static", (196, 200, 206)),
    "failed": ("failed: unreadable asset", (90, 96, 104)),
    "missing": ("missing", (90, 96, 104)),
}
"""State → label and colour, in the order of the page."""
STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:74rem;padding:0 1rem;
color:#1d2329;background:#fff}
h1,h2{line-height:1.2}table{border-collapse:collapse;width:100%;font-size:13.5px}
th,td{padding:.4rem .6rem;border-bottom:1px solid #dde1e6;text-align:left;vertical-align:top}
img{max-width:100%;border:1px solid #e3e6ea;border-radius:4px}td img{width:150px}
.dot{display:inline-block;width:.8em;height:.8em;border-radius:3px;margin-right:.4em}
.counts{display:flex;flex-wrap:wrap;gap:.4rem 1.6rem;margin:1rem 0;padding:0;list-style:none}
.line{white-space:nowrap}.note{color:#556}.warn{color:#a4510a}
"""


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
    counts = Counter(r.status for r in rows)
    legend = "".join(
        f"<li>{_dot(s)}{escape(STATES[s][0])}: <b>{counts[s]}</b></li>" for s in order if counts[s]
    )
    remarks = "".join(f"<li class=warn>{escape(p.object)}: {escape(p.text)}</li>" for p in problems)
    entries = _saved_entries(saved)
    body = "".join(
        _line(r, drawn.get(r.work) if r.work is not None else None, entries.get(r.item.obj.id, {}))
        for r in rows
    )
    page = (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(name)}</title>"
        f"<style>{STYLE}</style><h1>{escape(name)}</h1><p class=note>{len(rows)} objects. "
        f"{_sim_id(rows)}</p><ul class=counts>{legend}</ul>{_img(picture, 'the scene')}"
        f"{f'<h2>About the file</h2><ul>{remarks}</ul>' if remarks else ''}"
        "<h2>Objects</h2><table><tr><th>object<th>state<th>why<th>joints<th>picture</tr>"
        f"{body}</table></html>"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputFileError(path, f"can't be written: {error.strerror or error}") from None
    return path


def _sim_id(rows: Sequence[ReportRow]) -> str:
    """Return Sim-Id (ArtiWorld, metrics) of the objects whose asset is known to move."""
    known = [r for r in rows if r.item.truth]
    if not known:
        return ""
    found = sum(r.item.decision.articulable for r in known)
    return f"Sim-Id {found}/{len(known)} articulable objects found."


def _dot(status: str) -> str:
    return f"<span class=dot style='background:rgb{STATES[status][1]}'></span>"


def _img(data: bytes | None, alt: str) -> str:
    if data is None:
        return ""
    return (
        f"<img alt='{escape(alt)}' src='data:image/png;base64,{base64.b64encode(data).decode()}'>"
    )


def _saved_entries(folder: Path | None) -> dict[str, dict[str, Any]]:
    """Return object → its entry in the saved scene; empty where that is gone."""
    if folder is None:
        return {}
    try:
        entries = json.loads((folder / SCENE_JSON).read_text(encoding="utf-8"))
        return {o["id"]: o for o in entries["objects"]}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _line(row: ReportRow, picture: bytes | None, saved: Mapping[str, Any]) -> str:
    obj, decision = row.item.obj, row.item.decision
    state = f"{_dot(row.status)}{escape(STATES[row.status][0])}"
    if row.by and row.status in ("accepted", "rejected"):
        why = f": {escape(row.reason)}" if row.reason else ""
        when = row.at[:16].replace("T", " ")
        state += f"<br><span class=note>{escape(row.by)}, {escape(when)}{why}</span>"
    reason = escape(decision.reason)
    if row.decided is not None:
        reason += f"<br>Decided by a person: {'articulable' if row.decided else 'static'}."
    notes = list(row.notes)
    if saved.get("held"):
        notes.append(f"Its base is fixed in the saved scene: it {saved['held']}")
    for name in dict.fromkeys(p["through"] for p in saved.get("passes", ())):
        notes.append(f"Starts inside {name}, and passes through it in the saved scene")
    reason += "".join(f"<br><span class=warn>{escape(n)}</span>" for n in notes)
    shorter = {c["joint"]: c for c in saved.get("shortened", ())}
    joints = "" if row.tree is None else "<br>".join(
        _joint(j, row.names.get(j.child, j.name), row.confidences.get(j.child),
               shorter.get(j.name))
        for j in row.tree.joints if j.moves
    )  # fmt: skip
    about = (
        ""
        if obj.description == obj.id
        else f"<br><span class=note>{escape(obj.description)}</span>"
    )
    return (
        f"<tr><td><b>{escape(obj.id)}</b>{about}<td>{state}<td>{reason}<td>{joints}"
        f"<td>{_img(picture, obj.id)}</tr>"
    )


def _joint(
    joint: Joint, name: str, confidence: float | None, shorter: Mapping[str, Any] | None
) -> str:
    """Return a joint with its range; ``shorter`` is the range in the saved scene."""
    limits = (joint.lower or 0.0, joint.upper or 0.0) if joint.limited else None
    note = ""
    certainty = "" if confidence is None else f", confidence {100 * confidence:.0f} %"
    if shorter is not None and _same(limits, shorter["was"]):
        hits = ", ".join(dict.fromkeys(shorter["hits"].values()))
        was = "" if limits is None else f", was{_span(joint, limits)}"
        limits = shorter["limits"]
        note = f"<br><span class=note>{escape(f'in the saved scene limited by {hits}{was}')}</span>"
    span = "" if limits is None else _span(joint, limits)
    return f"<span class=line>{escape(name)}: {joint.type}{span}{certainty}</span>{note}"


def _span(joint: Joint, limits: Sequence[float]) -> str:
    low, high = limits
    if joint.rotates:
        return f" {math.degrees(low):.0f}…{math.degrees(high):.0f}°"
    return f" {1000 * low:.0f}…{1000 * high:.0f} mm"


def _same(limits: Sequence[float] | None, was: Sequence[float] | None) -> bool:
    """Whether a joint still has the limits of the last save."""
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
