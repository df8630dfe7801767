"""Workspaces with accepted objects, as a person leaves them, without a server."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject, Prediction
from model.core.joint import Joint
from model.io.assets.asset_folder import write_asset
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.provenance import provenance
from sessions.store import Store
from tests.builders import box, part, two

BEGIN = datetime(2026, 3, 2, 9, tzinfo=UTC)
FILE = "scan of an oven"
"""Content of the source file; nothing reads it."""


def cupboard(category: str | None = "Oven", **joint: Any) -> ArticulatedObject:
    """A body with a door in front of it, hung at the left; ``joint`` replaces fields of it."""
    fields = {"type": "revolute", "axis": (0, 0, -1), "origin": (0, -0.02, 0), "upper": 1.5}
    fields |= {"name": "hinge", "parent": "link_0", "child": "link_1", "lower": 0.0} | joint
    hinge = Joint(**fields)  # type: ignore[arg-type]
    body = part("link_0", box((0, 0, 0), (0.6, 0.5, 0.8)), name="body")
    door = part("link_1", box((0, -0.02, 0), (0.6, 0, 0.8)), name="door")
    return replace(two(hinge, body, door), category=category)


def accept(
    store: Store,
    path: Path,
    obj: ArticulatedObject,
    who: str = "anna",
    day: int = 0,
    extra: Mapping[str, Any] | None = None,
) -> int:
    """Annotate, predict, accept and save an object; returns its id.

    Args:
        path: its source; made where it is missing.
        day: after 2 March 2026, when it is done.
        extra: entries of its provenance.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(FILE)
    id = store.open_object(path, None, path.stem).id
    labels = store.put_array(np.array([0, 0, 1, 1], np.int16))
    moment = BEGIN + timedelta(days=day)

    def do(command: cmd.Command, by: str = who) -> None:
        nonlocal moment
        moment += timedelta(seconds=5)
        at = moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        store.append(id, command, by, store.load(id).seq, at=at)

    if store.object(id).state == "accepted":
        do(cmd.Reopen())
    do(cmd.AddClick(Click((0.1, 0.0, 0.2), 1)))
    key = store.load(id).present.key
    do(cmd.RecordSegmentation(key, labels, "default", 0.1, {0: 2, 1: 2}), "segmenter")
    if obj.category:
        do(cmd.SetCategory(obj.category))
    prediction = Prediction(obj.tree, backend="geometric 1", seconds=0.5)
    do(cmd.RecordPrediction(prediction, labels))
    do(cmd.Accept())
    told = provenance(store.load(id), store.history(id), None)
    told |= {"source": {"path": str(path), "sha256": "ab" * 32, "up_axis": "z", "unit_scale": 1.0}}
    told |= {"gate": {"verdict": "fine"}} | dict(extra or {})
    saved = write_asset(obj, store.workspace / "assets" / f"{path.stem}-{id}", provenance=told)
    do(cmd.Saved(str(saved.folder)))
    return id
