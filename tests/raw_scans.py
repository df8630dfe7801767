"""Scans as they come from a phone: the bundled ones at any rotation and scale, on a table."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial.transform import Rotation

from model.core.asset import Asset
from model.core.files import static_assets
from model.core.geometry import PointCloud
from model.io.open_asset import open_asset
from model.io.write import write_cloud


def raw_scan(
    out: Path,
    name: str = "oven_scan",
    seed: int = 0,
    scale: float | None = None,
    every: int = 1,
) -> npt.NDArray[np.float64]:
    """Write a bundled scan, or every so many of its points, on a table, with strays, to a PLY file.

    Returns:
        (4, 4) source_from_object.
    """
    rng = np.random.default_rng(seed)
    asset: Asset = open_asset(static_assets() / "examples" / f"{name}.ply")
    cloud = asset.cloud
    assert cloud is not None
    cloud = cloud.take(np.arange(0, len(cloud), every))
    assert cloud.colors is not None
    low, high = asset.bounds
    size = float(np.linalg.norm(high - low))
    count = len(cloud) // 3
    middle, half = (low + high)[:2] / 2, 0.8 * size
    flat = rng.uniform(middle - half, middle + half, (count, 2))
    table = np.column_stack([flat, rng.normal(low[2], 0.001 * size, count)])
    strays = rng.uniform(low - 0.3 * size, high + 0.3 * size, (len(cloud) // 250, 3))
    points = np.concatenate([cloud.points, table, strays])
    wood = np.clip(rng.normal((150, 112, 78), 6, (count, 3)), 0, 255)
    colors = np.concatenate([cloud.colors, wood, rng.integers(40, 220, (len(strays), 3))])
    frame = np.eye(4)
    factor = rng.uniform(0.3, 3.0) if scale is None else scale
    frame[:3, :3] = factor * Rotation.random(rng=rng).as_matrix()
    frame[:3, 3] = rng.normal(0, 1, 3)
    moved = points @ frame[:3, :3].T + frame[:3, 3]
    write_cloud(PointCloud(moved.astype(np.float32), None, colors.astype(np.uint8)), out)
    return frame


def saved_along_another_axis(
    asset: Asset, path: Path, turn: npt.NDArray[np.float64] | None = None
) -> Path:
    """Write an upright asset so that it is read lying on its back, or under ``turn`` (3, 3)."""
    y_up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    read_as_y_up = path.suffix in (".obj", ".glb")
    if turn is None:
        turn = np.eye(3) if read_as_y_up else y_up
    elif read_as_y_up:
        turn = y_up @ turn
    if asset.cloud is not None:
        points = (asset.cloud.points @ turn.T).astype(np.float32)
        write_cloud(PointCloud(points, None, asset.cloud.colors), path)
        return path
    assert asset.mesh is not None
    trimesh.Trimesh(asset.mesh.vertices @ turn.T, asset.mesh.faces, process=False).export(path)
    return path
