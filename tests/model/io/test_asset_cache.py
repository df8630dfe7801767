"""Saved assets come back the same, shared and whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.core.asset import Asset, Source
from model.core.errors import InputFileError
from model.core.geometry import Mesh, PointCloud
from model.io.asset_cache import FORMAT_VERSION, load_asset, save_asset


def test_mesh_with_textures_comes_back(tmp_path: Path, textured: Mesh) -> None:
    asset = Asset(
        "cube",
        mesh=textured,
        source=Source(Path("/a/b.obj"), "ab" * 32, "y", 0.01, (1.0, 2.0, 3.0)),
        element_part=np.arange(12, dtype=np.int32) // 6,
        part_names=("body", "door"),
        category="box",
        warnings=("a warning",),
    )
    save_asset(asset, tmp_path / "c")
    got = load_asset(tmp_path / "c")
    for name in ("name", "source", "part_names", "category", "warnings"):
        assert getattr(got, name) == getattr(asset, name)
    np.testing.assert_array_equal(got.element_part, asset.element_part)
    assert got.mesh is not None
    for name in ("vertices", "faces", "face_material", "uv"):
        np.testing.assert_array_equal(getattr(got.mesh, name), getattr(textured, name))
    for a, b in zip(got.mesh.materials, textured.materials, strict=True):
        assert a.maps == b.maps
        assert (a.name, a.base_color, a.texture is None, a.metallic, a.roughness) == (
            b.name,
            b.base_color,
            b.texture is None,
            b.metallic,
            b.roughness,
        )
    texture, original = got.mesh.materials[0].texture, textured.materials[0].texture
    np.testing.assert_array_equal(np.asarray(texture), np.asarray(original))


def test_arrays_are_mapped_and_read_only(tmp_path: Path, cloud: PointCloud) -> None:
    save_asset(Asset("scan", cloud=cloud), tmp_path / "c")
    got = load_asset(tmp_path / "c").cloud
    assert got is not None
    assert isinstance(got.points.base, np.memmap) and not got.points.flags.writeable
    np.testing.assert_array_equal(got.colors, cloud.colors)


def test_saving_again_replaces_and_leaves_nothing_behind(
    tmp_path: Path, cloud: PointCloud, textured: Mesh
) -> None:
    save_asset(Asset("one", mesh=textured), tmp_path / "c")
    first = load_asset(tmp_path / "c")
    save_asset(Asset("two", cloud=cloud), tmp_path / "c")
    assert load_asset(tmp_path / "c").name == "two"
    assert [p.name for p in tmp_path.iterdir()] == ["c"]
    assert not list((tmp_path / "c").glob("mesh_*"))
    assert first.mesh is not None  # what is open stays usable
    assert first.mesh.face_areas.sum() == pytest.approx(6)


def test_a_failed_save_keeps_the_old_asset(
    tmp_path: Path, cloud: PointCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_asset(Asset("old", cloud=cloud), tmp_path / "c")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(InputFileError, match="No space left"):
        save_asset(Asset("new", cloud=cloud), tmp_path / "c")
    monkeypatch.undo()
    assert load_asset(tmp_path / "c").name == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def test_damaged_and_newer_caches_say_so(tmp_path: Path, cloud: PointCloud) -> None:
    folder = tmp_path / "c"
    with pytest.raises(InputFileError, match="no saved asset"):
        load_asset(folder)
    save_asset(replace(Asset("a", cloud=cloud)), folder)
    meta = json.loads((folder / "asset.json").read_text())
    (folder / "asset.json").write_text(json.dumps(meta | {"version": FORMAT_VERSION + 1}))
    with pytest.raises(InputFileError, match="update ArtiWorld"):
        load_asset(folder)
    (folder / "asset.json").write_text(json.dumps(meta | {"version": 1}))
    with pytest.raises(InputFileError, match="open the source file again"):  # which the app does
        load_asset(folder)
    (folder / "asset.json").write_text(json.dumps(meta))
    points = folder / "cloud_points.npy"
    points.write_bytes(points.read_bytes()[:500])
    with pytest.raises(InputFileError, match="damaged"):
        load_asset(folder)
