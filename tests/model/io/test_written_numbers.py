"""Numbers in files: as short as they may be, and without what differs between processors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.shapes import Primitive
from model.core.tree import KinematicTree
from model.io.export.registry import load_exporter, write_object
from model.io.urdf.writer import number, vector
from model.physics.simulation_values import Physics, physics_of
from tests.model.io.test_exporters import make_object


def test_numbers_are_short_and_keep_a_billionth() -> None:
    some = (0.030000000000000002 * 1.5, -0.0, 2.0, 1e-5, 1e20)
    assert [number(v) for v in some] == ["0.045", "0", "2", "1e-05", "1e+20"]
    assert vector((1.0, 6.1e-17, -3e-16)) == "1 0 0"
    rng = np.random.default_rng(0)
    values = rng.normal(size=1000) * 10.0 ** rng.uniform(-8, 8, 1000)
    read = np.array([float(number(v)) for v in values])
    assert np.abs(read / values - 1).max() <= 1e-9
    assert [number(v) for v in read] == [number(v) for v in values]


def with_other_last_bits(
    obj: ArticulatedObject, physics: Physics, rng: np.random.Generator
) -> tuple[ArticulatedObject, Physics]:
    """The same object as another processor computes it, to some units of the last place."""

    def bent(value):
        value = np.asarray(value, np.float64)
        residue = 1e-16 * np.abs(value).max(initial=0) * rng.uniform(-1, 1, value.shape)
        return value * (1 + rng.uniform(-4e-16, 4e-16, value.shape)) + residue

    def triple(value):
        x, y, z = bent(value).tolist()
        return x, y, z

    joints = []
    for j in obj.tree.joints:
        low, high = (v and float(bent(v)) for v in (j.lower, j.upper))
        bare = replace(j, origin=triple(j.origin), axis=triple(j.axis))
        joints.append(replace(bare, lower=low, upper=high))
    inertials = {
        k: Inertial(float(bent(i.mass)), bent(i.center), bent(i.tensor))
        for k, i in physics.inertials.items()
    }

    def moved(s):
        sizes = tuple(bent(s.sizes).tolist()) if isinstance(s, Primitive) else ()
        return Primitive(s.kind, bent(s.object_from_shape), sizes) if sizes else s

    collision = {k: tuple(map(moved, held)) for k, held in physics.collision.items()}
    return (
        replace(obj, tree=KinematicTree(obj.tree.links, tuple(joints))),
        replace(physics, inertials=inertials, collision=collision),
    )


@pytest.mark.parametrize("format_name", ["urdf", "mjcf", "sdf", "usd"])
def test_last_bits_change_no_file(format_name: str, tmp_path: Path) -> None:
    obj = make_object()
    physics = physics_of(obj)
    rng, seen = np.random.default_rng(0), set()
    for k in range(4):
        made = (obj, physics) if k == 0 else with_other_last_bits(obj, physics, rng)
        out = tmp_path / str(k)
        write_object(made[0], load_exporter(format_name), out, physics=made[1])
        files = sorted(out.rglob("*"))
        texts = [p.read_text() for p in files if p.suffix in (".urdf", ".xml", ".sdf")]
        for path in (p for p in files if "usd" in p.suffix):
            stage = Usd.Stage.Open(str(path))
            lines = stage.GetRootLayer().ExportToString().splitlines()
            texts += [line for line in lines if "[]" not in line]  # but for arrays of vertices
        assert texts
        seen.add(tuple(texts))
    assert len(seen) == 1
