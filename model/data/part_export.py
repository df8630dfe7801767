"""Ground-truth objects as the folder of part meshes that a predictor reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from model.data.protocol import GroundTruth
from model.io.write import write_cloud, write_mesh


def export_parts(
    truth: GroundTruth,
    folder: Path,
    *,
    with_names: bool = True,
    rng: np.random.Generator | None = None,
) -> Path:
    """Write the parts of ``truth`` at rest, without their tree.

    One ``link_*.obj`` (a cloud: ``.ply``) a part and ``object.json``, which is
    ``{"category": ..., "parts": [{"file": ..., "name": ...}]}``.

    Args:
        truth: the object.
        folder: made where it isn't there.
        with_names: whether category and part names are written.
        rng: lists the parts in a random order; in their natural one where it is None.

    Returns:
        The path of ``object.json``.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for part in truth.segmented(names=with_names).parts:
        if part.mesh is not None:
            path = folder / f"{part.link}.obj"
            write_mesh(part.mesh, path)
        else:
            assert part.cloud is not None
            path = folder / f"{part.link}.ply"
            write_cloud(part.cloud, path)
        entry = {"file": path.name}
        if part.name:
            entry["name"] = part.name
        entries.append(entry)
    if rng is not None:
        entries = [entries[i] for i in rng.permutation(len(entries))]
    document: dict[str, object] = {"parts": entries}
    if with_names and truth.object.category:
        document = {"category": truth.object.category, **document}
    out = folder / "object.json"
    out.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return out
