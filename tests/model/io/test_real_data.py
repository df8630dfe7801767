"""Real scans and objects open: a spread of them, as all take longer."""

from pathlib import Path

import numpy as np
import pytest

from model.io.geometry_files import SUFFIXES
from model.io.model_files import find_assets
from model.io.open_asset import open_asset


def test_partnet_mobility_objects_open_with_their_textures(shared_data: Path) -> None:
    found = find_assets([shared_data / "partnet_mobility"])
    assert len(found) == 79
    names = {p.name for p in found}
    chosen = [p for p in found[::6] if p] + [p for p in found if p.name in ("dex_cup", "102872")]
    assert {"dex_cup", "102872"} <= names
    textured = 0
    for path in chosen:
        asset = open_asset(path)
        assert asset.mesh is not None and asset.warnings == (), path.name
        assert 0.01 < asset.diagonal < 10, path.name
        textured += any(m.texture is not None for m in asset.mesh.materials)
    assert textured > len(chosen) / 3


def test_rest_pose_agrees_with_yourdfpy(shared_data: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    for name in ("45261", "dex_cup"):
        folder = shared_data / "partnet_mobility" / name
        urdf = yourdfpy.URDF.load(str(folder / "mobility.urdf"), load_meshes=True)
        urdf.update_cfg(np.zeros(len(urdf.actuated_joint_names)))
        asset = open_asset(folder)
        assert asset.mesh is not None
        np.testing.assert_allclose(asset.bounds, urdf.scene.bounds, atol=1e-6)
        assert asset.mesh.face_areas.sum() == pytest.approx(urdf.scene.area, rel=1e-6)


def test_all_scans_open(shared_data: Path) -> None:
    found = find_assets([shared_data / "scans"])
    assert len(found) == 12
    for path in found:
        asset = open_asset(path)
        assert asset.cloud is not None and asset.cloud.colors is not None, path.name
        assert asset.warnings == ()


def test_articulated_meshes_open(shared_data: Path) -> None:
    files = sorted(
        p
        for p in (shared_data / "articulated_free").rglob("*")
        if p.suffix in SUFFIXES and p.suffix != ".txt"
    )
    assert len(files) > 60
    for path in files[::4]:
        assert open_asset(path).element_kind == "face", path.name
