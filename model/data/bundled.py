"""The bundled examples, cut by their true labels, with their true joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import InputFileError
from model.core.files import read_json, static_assets
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.protocol import GroundTruth
from model.geometry.splitting import split
from model.io.open_asset import open_asset


class Bundled:
    """``<id>.glb`` or ``<id>.ply`` with ``truth/<id>.json``.

    Args:
        root: folder; by default the examples that ArtiWorld brings along.
    """

    name = "bundled"

    def __init__(self, root: Path | None = None) -> None:
        self._folder = root or static_assets() / "examples"

    def ids(self) -> tuple[str, ...]:
        """Names, sorted.

        Raises:
            InputFileError: where there is none.
        """
        found = tuple(sorted(p.stem for p in (self._folder / "truth").glob("*.json")))
        if not found:
            raise InputFileError(self._folder, "no truth/<id>.json in it", "leave --root out")
        return found

    def category(self, object_id: str) -> str | None:
        """Category of the example."""
        return self._truth(object_id)["category"]

    def _truth(self, object_id: str) -> dict[str, Any]:
        if object_id not in self.ids():
            raise InputFileError(
                self._folder, f"no example {object_id!r}", f"there are {', '.join(self.ids())}"
            )
        return read_json(self._folder / "truth" / f"{object_id}.json")

    def load(self, object_id: str) -> GroundTruth:
        """Open the scan or mesh and cut it."""
        truth = self._truth(object_id)
        (file,) = (p for p in self._folder.glob(f"{object_id}.*") if p.suffix in (".glb", ".ply"))
        parts_of, counts = zip(*truth["runs"], strict=True)
        labels = np.maximum(np.repeat(parts_of, counts), 0)
        names = {p["id"]: p["name"] for p in truth["parts"]}
        joints = tuple(
            Joint(**{**j, "axis": tuple(j["axis"]), "origin": tuple(j["origin"])})
            for j in truth["joints"]
        )
        tree = KinematicTree(tuple(truth["links"]), joints)
        parts = split(open_asset(file), labels, names)
        return GroundTruth(object_id, ArticulatedObject(object_id, parts, tree, truth["category"]))
