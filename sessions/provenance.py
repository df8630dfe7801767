"""The provenance of an asset: source, prompts, predictor, edits, people, times, versions."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core import codec
from model.core.asset import Source
from model.io.geometry_files import turned_up
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Document, ObjectFrame
from sessions.state import SessionState
from sessions.store import Entry

FORMAT = 1
MASKS = "masks "
"""Name of the tool that took parts from masks, before the file."""


def provenance(
    state: SessionState, history: Iterable[Entry], source: Source | None
) -> dict[str, Any]:
    """Return the provenance for the asset's ``provenance.json``.

    Args:
        state: the session.
        history: all its commands, as :meth:`sessions.store.Store.history` gives them.
        source: where the asset was read from, None for one made in memory.

    Returns:
        A dict that JSON can hold. ``object_from_source``, (4, 4), leads from the file's own
        numbers to the asset; ``scan_from_object`` to the scan that the object was cut out of.
        ``edits`` lists the joint edits made on the last prediction that are still in force,
        without undone ones.
    """
    document = state.present
    kept = effective(history)
    object_from_source = _object_from_source(document, source)
    placement = document.placement
    return {
        "format": FORMAT,
        "source": None if source is None else _source(source),
        "object_from_source": object_from_source.tolist(),
        "left_out": codec.write(document.left_out, "left_out"),
        "face_cuts": codec.write(document.face_cuts, "face_cuts"),
        "placement": codec.write(placement, "placement"),
        "scan_from_object": None
        if placement is None
        else (
            ObjectFrame(placement.position, placement.wxyz).object_from_read
            @ np.linalg.inv(object_from_source)
        ).tolist(),
        "category": document.category,
        "parts": _parts(document),
        "prompts": [_prompt(p) for p in document.prompts],
        "masks": _masks(kept),
        "segmenter": None if document.segmentation is None else _segmenter(document),
        "predictor": _predictor(document, kept),
        "edits": _edits(kept),
        "edited_joints": list(document.edited_joints),
        "review": codec.write(document.review, "review"),
        "people": _people(kept),
        "started": kept[0].at if kept else None,
        "finished": kept[-1].at if kept else None,
        "commands": state.seq,
        "versions": _versions(),
    }


def _object_from_source(document: Document, source: Source | None) -> npt.NDArray[np.float64]:
    """(4, 4) the object's frame in the source file's own axes and unit."""
    out = document.frame.object_from_read
    if source is None:
        return out
    read = turned_up(source.up_axis)
    read[:3, :3] *= source.unit_scale
    read[:3, 3] = np.negative(source.shift)
    return out @ read


def effective(history: Iterable[Entry]) -> list[Entry]:
    """Return the entries in force: without undone ones, without undo and redo themselves."""
    done: list[Entry] = []
    undone: list[Entry] = []
    amendments: list[Entry] = []
    for entry in history:
        if isinstance(entry.command, cmd.Undo):
            undone.append(done.pop())
        elif isinstance(entry.command, cmd.Redo):
            done.append(undone.pop())
        elif isinstance(entry.command, cmd.JobResult):
            amendments.append(entry)
        else:
            done.append(entry)
    return sorted([*done, *amendments], key=lambda e: e.seq)


def _source(source: Source) -> dict[str, Any]:
    return {
        "path": str(source.path),
        "sha256": source.sha256,
        "up_axis": source.up_axis,
        "unit_scale": source.unit_scale,
    }


def _parts(document: Document) -> list[dict[str, Any]]:
    counts: Mapping[int, int] = (
        {} if document.segmentation is None else document.segmentation.counts
    )
    return [
        {"id": p.id, "link": p.link, "name": p.name, "elements": counts.get(p.id, 0)}
        for p in document.parts
    ]


def _prompt(prompt: Any) -> dict[str, Any]:
    kind = "click" if isinstance(prompt, Click) else "region"
    return {"kind": kind, **codec.write(prompt, kind)}


def _segmenter(document: Document) -> dict[str, Any]:
    record = document.segmentation
    assert record is not None
    return {"name": record.segmenter, "seconds": record.seconds, "labels": record.labels}


def _masks(kept: list[Entry]) -> list[str]:
    """The files of other systems' masks that parts were taken from."""
    tools = [e.command.tool for e in kept if isinstance(e.command, cmd.ApplyTool)]
    return [tool for tool in tools if tool.startswith(MASKS)]


def _predictor(document: Document, kept: list[Entry]) -> dict[str, Any] | None:
    prediction = document.prediction
    if prediction is None:
        return None
    made = next((e for e in reversed(kept) if isinstance(e.command, cmd.RecordPrediction)), None)
    return {
        "backend": prediction.backend,
        "file": prediction.file,
        "seed": prediction.seed,
        "seconds": prediction.seconds,
        "problems": list(prediction.problems),
        "confidence": codec.write(prediction.confidence, "confidence"),
        "by": None if made is None else made.who,
        "at": None if made is None else made.at,
        "parts_changed_since": document.prediction_stale,
    }


def _edits(kept: list[Entry]) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for e in kept:
        starts_afresh = isinstance(e.command, (cmd.SetFrame, cmd.Prepare)) or (
            isinstance(e.command, cmd.RecordPrediction) and e.command.prediction.tree is not None
        )
        if starts_afresh:
            out = []
        elif isinstance(e.command, cmd.JointEdit):
            out.append(
                {
                    "seq": e.seq,
                    "who": e.who,
                    "at": e.at,
                    "what": e.command.describe(),
                    "command": cmd.to_json(e.command),
                }
            )
    return out


def _people(kept: list[Entry]) -> list[dict[str, Any]]:
    """Contributors, earliest first, with the number of their decisions."""
    counts: dict[str, int] = {}
    for e in kept:
        if not isinstance(e.command, cmd.JobResult):
            counts[e.who] = counts.get(e.who, 0) + 1
    return [{"who": who, "decisions": n} for who, n in counts.items()]


def _versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for package in ("artiworld", "numpy", "trimesh"):
        try:
            out[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            out[package] = "unknown"
    return out
