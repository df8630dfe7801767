"""A scan in any frame is levelled, sized and cleaned, and the way back is exact."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.core.geometry import PointCloud
from model.data.simulated.depth_camera import (
    Reconstruction,
    ReconstructionSettings,
    reconstruct_scan,
)
from model.geometry.cleaning import OBJECT, OUTLIER, SUPPORT, classify
from model.geometry.crop import largest_component, outliers
from model.geometry.levelling import find_up, sampled
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
        {"height": 0.0},
        {"height": float("nan")},
        {"up": (0, 0, 0)},
        {"unit_scale": -1.0},
        {"height": 1.0, "length": ((0, 0, 0), (1, 0, 0), 1.0)},
        {"length": ((0, 0, 0), (0, 0, 0), 1.0)},
    ],
)
def test_impossible_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(ConfigurationError):
        PrepareSettings(**wrong)


@settings(max_examples=40)
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


def _scanned(boxes: list[tuple], count: int, least: float, seed: int = 0) -> np.ndarray:
    """(count, 3) points on boxes of (size, middle), at ``least`` of the density on one side."""
    rng = np.random.default_rng(seed)
    shapes = [trimesh.creation.box(size).apply_translation(at) for size, at in boxes]
    mesh = trimesh.util.concatenate(shapes)
    points, face = trimesh.sample.sample_surface(mesh, 12 * count, seed=seed)
    weight = np.clip(mesh.face_normals[face] @ [0.5, -0.7, 0.5], least, 1.0)
    return points[rng.choice(len(points), count, replace=False, p=weight / weight.sum())]


_SIDES = [((0.02, 0.4, 1), (-0.49, 0, 0.5)), ((0.02, 0.4, 1), (0.49, 0, 0.5))]
_BACK = [((1, 0.02, 1), (0, 0.19, 0.5))]
_SHELF = [*_SIDES, *_BACK, *(((1, 0.4, 0.02), (0, 0, z)) for z in np.linspace(0.01, 0.99, 8))]
_CABINET = [*_SIDES, *_BACK, *(((1, 0.4, 0.02), (0, 0, z)) for z in (0.01, 0.99))]
_CUBE = [((1, 1, 1), (0, 0, 0.5))]
_LAMP = [((0.4, 0.4, 0.015), (0, 0, 0.0075)), ((0.04, 0.04, 0.5), (0, 0, 0.26))]
_PANEL = [((0.8, 0.5, 0.02), (0, 0, 0.01)), ((0.4, 0.3, 0.006), (0, 0, 0.023))]
_PAIR = [((0.3, 0.3, 0.6), (x, 0, 0.3)) for x in (-0.3, 0.3)]


@pytest.mark.parametrize("least", [1.0, 0.1])
@pytest.mark.parametrize(
    ("boxes", "count"),
    [
        (_SHELF, 100_000),
        (_CABINET, 30_000),
        *((b, 20_000) for b in (_SHELF, _CUBE, _LAMP, _PANEL, _PAIR)),
    ],
    ids=["shelf", "cabinet", "sparse shelf", "cube", "no table", "panel", "two pieces"],
)
def test_clean_scans_are_kept(boxes: list[tuple], count: int, least: float) -> None:
    points = _scanned(boxes, count, least)
    cloud = PointCloud(np.repeat(points, 2, axis=0).astype(np.float32))  # of two merged files
    found = prepare(Asset("scan", cloud=cloud), PrepareSettings(up=(0, 0, 1)))
    assert len(found.kept) > 0.995 * len(cloud)
    assert found.asset.warnings == ()


def test_an_open_shelf_stays_upright() -> None:
    assert find_up(_scanned(_SHELF, 20_000, 1.0)).up == (0, 0, 1)


def test_repeated_points_do_not_hide_the_others() -> None:
    points = _scanned(_CABINET, 20_000, 1.0)
    cloud = np.concatenate([points, np.repeat(points[:1], 5_000, axis=0)])
    assert len(sampled(cloud, None)[0]) > 0.5 * len(sampled(points, None)[0])


@pytest.mark.parametrize("degrees", [0.0, 17.3])
def test_the_object_is_squared_whatever_it_stands_on(degrees: float) -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1.2, 1.2, (8000, 2)), np.zeros(8000)])
    points = np.concatenate([0.8 * _scanned(_CUBE, 8000, 0.3) * [1, 0.75, 1.5], floor])
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    cloud = PointCloud((points @ turn.T).astype(np.float32))
    found = prepare(Asset("scan", cloud=cloud), PrepareSettings(up=(0, 0, 1)))
    np.testing.assert_allclose(np.ptp(found.asset.bounds, axis=0)[:2], [0.8, 0.6], atol=2e-3)
    np.testing.assert_allclose(found.object_from_source[:3, :3] @ turn, np.eye(3), atol=4e-3)


def test_a_round_object_is_not_turned() -> None:
    tube, _ = trimesh.sample.sample_surface(trimesh.creation.cylinder(0.3, 0.5), 20_000, seed=1)
    cloud = PointCloud(tube.astype(np.float32))
    found = prepare(Asset("scan", cloud=cloud), PrepareSettings(up=(0, 0, 1)))
    np.testing.assert_allclose(found.object_from_source[:3, :3], np.eye(3), atol=1e-6)


def test_many_outliers_are_left_to_a_person() -> None:
    rng = np.random.default_rng(0)
    points = _scanned(_CUBE, 20_000, 1.0)
    for count, stay in ((200, False), (1500, True)):
        air = rng.uniform(-3, 3, (count, 3))
        air = air[(np.abs(air - [0, 0, 0.5]) > 0.8).any(1)]
        cloud = PointCloud(np.concatenate([points, air]).astype(np.float32))
        found = prepare(Asset("scan", cloud=cloud), PrepareSettings(up=(0, 0, 1)))
        kept = (found.kept >= len(points)).mean() * len(found.kept) / len(air)
        assert (kept > 0.9) if stay else (kept < 0.1)
        assert any("outliers" in w for w in found.asset.warnings) == stay


@pytest.mark.parametrize("least", [1.0, 0.1])
def test_a_sparse_side_is_no_outlier_in_a_room(least: float) -> None:
    points = _scanned(_CABINET, 20_000, least)
    air = np.random.default_rng(0).uniform(-1.5, 1.5, (100, 3)) + [0, 0, 3]
    asset = Asset("scan", cloud=PointCloud(np.concatenate([points, air]).astype(np.float32)))
    found = outliers(asset)
    assert found[: len(points)].mean() < 0.005 and found[len(points) :].mean() > 0.95


def test_a_sparse_scan_is_one_piece() -> None:
    points = 4 * _scanned(_CUBE, 5000, 0.1)
    far = points[:500] * 0.2 + [9, 0, 0]
    found = largest_component(np.concatenate([points, far]))
    assert found[:5000].mean() > 0.995 and not found[5000:].any()


def test_what_is_thin_is_kept_without_its_table() -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform(-0.2, 0.2, (40_000, 2)), rng.normal(0, 2e-4, 40_000)])
    blade, _ = trimesh.sample.sample_surface(trimesh.creation.box((0.2, 0.04, 0.005)), 9000, seed=1)
    blade = (blade + [0, 0, 0.0025])[blade[:, 2] > -0.001]
    turn = Rotation.from_euler("xyz", (0.9, 0.4, 0.2)).as_matrix()
    points = np.concatenate([table, blade]) @ turn.T
    found = prepare(Asset("blade", cloud=PointCloud(points.astype(np.float32))))
    kept = found.kept >= len(table)
    assert kept.mean() > 0.98 and kept.sum() > 0.9 * len(blade)


def test_an_object_on_a_table_is_told_apart_from_that_and_from_points_in_the_air() -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform(-1, 1, (8000, 2)), rng.normal(0, 0.002, 8000)])
    box, _ = trimesh.sample.sample_surface(trimesh.creation.box((0.6, 0.4, 0.5)), 8000, seed=1)
    box = box + [0, 0, 0.25]
    box = box[box[:, 2] > 0.02]
    air = np.array([(0.1, 0.1, 0.65), (0.0, 0.1, 0.8), (0.2, -0.1, 3.0)])
    kinds = classify(np.concatenate([table, air, box]), 0.0)
    assert (kinds[:8000] == SUPPORT).mean() > 0.98 and (kinds[8000:8003] == OUTLIER).all()
    assert (kinds[8003:] == OBJECT).mean() > 0.99


def test_a_dense_scan_is_levelled_among_its_outliers() -> None:
    """In a dense scan outliers fill as many cells as surfaces do."""
    rng = np.random.default_rng(0)
    boxes = [((0.6, 0.4, 0.5), (0, 0, 0.25)), ((0.5, 0.03, 0.4), (0, -0.215, 0.25))]
    solids = [(trimesh.creation.box(size), at) for size, at in boxes]
    sides = [trimesh.sample.sample_surface(s, 200_000, seed=1)[0] + at for s, at in solids]
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
