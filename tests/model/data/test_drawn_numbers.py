"""The generators draw what they drew when the shipped weights were trained.

``drawn_numbers.json`` holds, for one seed of each family and assembly, the number of vertices and
faces, a weighted sum of the coordinates, and the generator's next integer: another order of draws,
one more or one less changes the last. ``python -m tests.model.data.test_drawn_numbers`` writes it.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from model.core.geometry import Mesh
from model.data.procedural.composite import random_composite
from model.data.procedural.families import FAMILIES
from model.data.procedural.generate import COMPOSITE
from model.data.simulated import furniture, gadgets
from model.data.simulated.primitives import Builder
from model.data.simulated.scans import build

FILE = Path(__file__).with_name("drawn_numbers.json")
SEED = 20
ASSEMBLIES = {
    f.__name__: f for f in (*furniture.FAMILIES, furniture.flush_front, *gadgets.FAMILIES)
}
NAMES = (*FAMILIES, COMPOSITE, *ASSEMBLIES, "build 0", "build 3")


def weighted(points: np.ndarray) -> float:
    return float((points * np.arange(1, 1 + points.size).reshape(points.shape)).sum())


def summed(meshes: list[Mesh]) -> list[float]:
    return [
        sum(len(m.vertices) for m in meshes),
        sum(len(m.faces) for m in meshes),
        sum(weighted(m.vertices) for m in meshes),
    ]


def drawn(name: str) -> list[float]:
    """Vertices, faces, weighted sum of coordinates, next integer (-1 for a finished object)."""
    if name.startswith("build"):
        return [*summed([build(int(name.split()[1])).mesh]), -1]
    rng = np.random.default_rng(SEED)
    if name in ASSEMBLIES:
        builder = Builder(rng)
        ASSEMBLIES[name](builder)
        points = np.concatenate([triangles for triangles, _, _ in builder.solids]).reshape(-1, 3)
        sums = [len(points), len(points) // 3, weighted(points)]
    else:
        made = FAMILIES.get(name, random_composite)(rng)
        sums = summed([p.mesh for p in made.object.parts if p.mesh])
    return [*sums, int(rng.integers(1 << 40))]


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_draws_the_same_object_as_ever(name: str) -> None:
    assert drawn(name) == pytest.approx(json.loads(FILE.read_text())[name], rel=1e-9)


def test_no_family_is_missing() -> None:
    assert set(json.loads(FILE.read_text())) == set(NAMES)


if __name__ == "__main__":
    rows = [f"{json.dumps(name)}: {json.dumps(drawn(name))}" for name in NAMES]
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n")
