"""A scan in any frame is levelled, sized and cleaned, and the way back is exact."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.data.simulated.reconstruction import (
    Reconstruction,
    ReconstructionSettings,
    reconstruct_scan,
)
from model.geometry.cleaning import OBJECT, OUTLIER, SUPPORT, classify
from model.geometry.levelling import find_up
from model.geometry.prepare import PrepareSettings, prepare
from tests.model.demos import demo_object


@pytest.fixture(scope="module")
def tilted() -> Reconstruction:
    """The bundled cabinet on a table, in a frame of any rotation and scale."""
    settings = ReconstructionSettings(points=60_000)
    return reconstruct_scan(demo_object("cabinet"), settings, np.random.default_rng(4))


def test_up_is_found_to_two_degrees(tilted: Reconstruction) -> None:
    up = tilted.source_from_object[:3, 2]
    found = find_up(tilted.cloud.points)
    cosine = float(np.dot(found.up, up / np.linalg.norm(up)))
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 2
    assert found.confidence > 0.5 and found.support is not None


def test_the_object_alone_is_kept_and_sized(tilted: Reconstruction) -> None:
    asset = Asset("scan", cloud=tilted.cloud)
    found = prepare(asset, PrepareSettings(height=1.2))
    kept = np.zeros(len(tilted.kind), bool)
    kept[found.kept] = True
    true = tilted.kind == OBJECT
    assert (kept & true).sum() / (kept | true).sum() > 0.95
    assert np.ptp(found.asset.bounds, axis=0)[2] == pytest.approx(1.2, rel=0.03)
    assert set(found.removed) >= {"support"}


def test_the_recorded_frame_leads_back_to_the_source(tilted: Reconstruction) -> None:
    found = prepare(Asset("scan", cloud=tilted.cloud))
    assert found.asset.cloud is not None
    source_from_object = np.linalg.inv(found.object_from_source)
    back = found.asset.cloud.points @ source_from_object[:3, :3].T + source_from_object[:3, 3]
    source = tilted.cloud.points[found.kept]
    assert np.abs(back - source).max() < 1e-5 * np.ptp(source, axis=0).max()


def test_a_given_up_and_length_are_taken(tilted: Reconstruction) -> None:
    a, b = (tuple(map(float, p)) for p in tilted.cloud.points[:2])
    found = prepare(
        Asset("scan", cloud=tilted.cloud),
        PrepareSettings(up=(0, 2, 0), length=(a, b, 0.5), keep_support=True),
    )
    frame = found.object_from_source
    assert frame[:3, :3] @ [0, 1, 0] == pytest.approx([0, 0, np.cbrt(np.linalg.det(frame[:3, :3]))])
    assert np.linalg.norm(frame[:3, :3] @ np.subtract(a, b)) == pytest.approx(0.5)
    assert len(found.kept) > 0.9 * len(tilted.cloud)


@pytest.mark.parametrize(
    "wrong",
    [
        {"height": 0.0}, {"height": float("nan")}, {"up": (0, 0, 0)}, {"unit_scale": -1.0},
        {"height": 1.0, "length": ((0, 0, 0), (1, 0, 0), 1.0)},
        {"length": ((0, 0, 0), (0, 0, 0), 1.0)},
    ],
)  # fmt: skip
def test_impossible_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(ConfigurationError):
        PrepareSettings(**wrong)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 400), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-6, 1.0, 1e6]))
def test_any_points_are_classified(count: int, seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = (scale * rng.integers(-3, 4, (count, 3))).astype(np.float32)
    points[rng.random(count) < 0.1] = np.nan
    kinds = classify(points, 0.0)
    assert kinds.shape == (count,) and set(np.unique(kinds)) <= {0, 1, 2, 3}
    assert (kinds[~np.isfinite(points).all(1)] == OUTLIER).all()
    if np.isfinite(points).all(1).sum() > 3:
        assert np.isfinite(find_up(points).up).all()


def test_what_lies_on_a_table_is_told_apart_from_it() -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform(-1, 1, (8000, 2)), rng.normal(0, 0.002, 8000)])
    box, _ = trimesh.sample.sample_surface(trimesh.creation.box((0.6, 0.4, 0.5)), 8000, seed=1)
    box = box + [0, 0, 0.25]
    box = box[box[:, 2] > 0.02]
    kinds = classify(np.concatenate([table, box]), 0.0)
    assert (kinds[:8000] == SUPPORT).mean() > 0.98
    assert (kinds[8000:] == OBJECT).mean() > 0.99


def test_a_dense_scan_is_levelled_among_its_outliers() -> None:
    """In a dense scan outliers fill as many cells as surfaces do."""
    rng = np.random.default_rng(0)
    boxes = [((0.6, 0.4, 0.5), (0, 0, 0.25)), ((0.5, 0.03, 0.4), (0, -0.215, 0.25))]
    sides = [trimesh.sample.sample_surface(trimesh.creation.box(s), 200_000, seed=1)[0] + at
             for s, at in boxes]  # fmt: skip
    table = np.column_stack([rng.uniform(-0.8, 0.8, (200_000, 2)), rng.normal(0, 0.001, 200_000)])
    air = rng.uniform(-0.7, 0.9, (15_000, 3)) + [0, 0, 0.3]
    turn = Rotation.random(rng=rng).as_matrix()
    points = (np.concatenate([*sides, table, air]) @ turn.T).astype(np.float32)
    found = find_up(points)
    assert np.degrees(np.arccos(min(float(turn[:, 2] @ found.up), 1.0))) < 0.5
    assert found.support is not None


def test_preparing_is_cancelled_between_its_steps(tilted: Reconstruction) -> None:
    told: list[float] = []

    def progress(fraction: float, message: str) -> None:
        told.append(fraction)
        if fraction > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(Asset("scan", cloud=tilted.cloud), progress=progress)
    assert told == sorted(told) and len(told) > 5


def test_a_mesh_keeps_its_faces_and_textures(textured) -> None:
    found = prepare(Asset("cube", mesh=textured), PrepareSettings(up=(1, 0, 0), height=2.0))
    assert found.asset.mesh is not None and found.asset.mesh.materials == textured.materials
    assert found.asset.mesh.bounds[1] - found.asset.mesh.bounds[0] == pytest.approx([2, 2, 2])
    assert found.asset.mesh.bounds[0][2] == pytest.approx(0, abs=1e-9)
