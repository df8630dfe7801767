"""The bundled demo objects with their ground truth."""

from __future__ import annotations

import json

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.resources import static_assets
from model.core.tree import KinematicTree
from model.geometry.parts import split
from model.io.open_asset import open_asset

EXAMPLES = static_assets() / "examples"
DEMOS = tuple(sorted(p.stem for p in (EXAMPLES / "truth").glob("*.json")))


def demo_object(name: str) -> ArticulatedObject:
    """A demo cut by its true labels, with its true joints."""
    truth = json.loads((EXAMPLES / "truth" / f"{name}.json").read_text())
    path = next(p for p in EXAMPLES.glob(f"{name}.*") if p.suffix in (".glb", ".ply"))
    asset = open_asset(path)
    labels = np.concatenate([np.full(n, part) for part, n in truth["runs"]])
    parts = split(asset, np.maximum(labels, 0), {p["id"]: p["name"] for p in truth["parts"]})
    joints = tuple(
        Joint(**{**j, "axis": tuple(j["axis"]), "origin": tuple(j["origin"])})
        for j in truth["joints"]
    )
    tree = KinematicTree(tuple(truth["links"]), joints)
    return ArticulatedObject(name, parts, tree, truth["category"])
