"""Bad input: a clear error that names the file, or a warning; never anything else."""

from __future__ import annotations

import json
import os
import re
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest

from model.core.errors import ArtiworldError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.io.formats.points import read_npz
from model.io.geometry_files import SUFFIXES
from model.io.model_files import find_assets
from model.io.open_asset import open_asset, read_part_files
from model.io.write import write_cloud, write_mesh
from tests.builders import ply_head

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def refused(path: Path, match: str) -> InputFileError:
    with pytest.raises(InputFileError, match=match) as caught:
        open_asset(path)
    assert path.name in str(caught.value)
    return caught.value


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_empty_file(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a{suffix}").touch()
    refused(tmp_path / f"a{suffix}", "empty")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_ascii_garbage(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text("It was the best of times, it was the worst of times.\n" * 50)
    refused(path, ".")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_binary_garbage(tmp_path: Path, suffix: str, rng: np.random.Generator) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(rng.integers(0, 256, 5000, np.uint8).tobytes())
    refused(path, ".")


def test_missing_unknown_and_strange_paths(tmp_path: Path) -> None:
    refused(tmp_path / "nothing.ply", "no such file")
    refused(tmp_path / "nothing.abc", "no such file")
    (tmp_path / "a.docx").write_text("x")
    refused(tmp_path / "a.docx", r"can't be opened.*\.ply")
    os.mkfifo(tmp_path / "pipe.ply")  # reading it would wait for ever
    refused(tmp_path / "pipe.ply", "regular file")
    with pytest.raises(InputFileError, match="nothing in it can be opened"):
        (tmp_path / "void").mkdir()
        find_assets([tmp_path / "void"])
    with pytest.raises(InputFileError, match="no such file or folder"):
        find_assets([tmp_path / "gone"])


def test_file_over_the_limit(tmp_path: Path, cloud: PointCloud) -> None:
    write_cloud(cloud, tmp_path / "a.ply")
    with pytest.raises(InputFileError, match="over the limit"):
        open_asset(tmp_path / "a.ply", max_bytes=1000)


def test_nan_points_are_left_out_and_counted(tmp_path: Path) -> None:
    rows = ["0 0 0", "nan 0 0", "1 0 0", "0 1 inf", "0 1 0", "0 0 1"]
    (tmp_path / "a.ply").write_text(ply_head(6) + "\n".join(rows))
    asset = open_asset(tmp_path / "a.ply")
    assert asset.element_count == 4
    assert "2 of 6 points are NaN" in asset.warnings[0]
    (tmp_path / "b.ply").write_text(ply_head(6) + "nan nan nan\n" * 6)
    refused(tmp_path / "b.ply", "all 6 points are NaN")
    (tmp_path / "c.obj").write_text(TRIANGLE + "v nan 0 0\nf 1 2 3\nf 1 2 4\n")
    asset = open_asset(tmp_path / "c.obj")
    assert asset.element_kind == "face" and asset.element_count == 1
    assert "with 1 faces" in asset.warnings[0]


def test_too_few_points(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n")
    assert "4 points or more" in str(refused(tmp_path / "a.xyz", "a single point"))
    (tmp_path / "b.xyz").write_text("1 2 3\n" * 10)
    refused(tmp_path / "b.xyz", "at one place")
    (tmp_path / "c.ply").write_text(ply_head(0))
    refused(tmp_path / "c.ply", "neither points nor faces")


def test_mesh_without_faces_is_a_cloud(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TRIANGLE + "v 0 0 1\n")
    assert open_asset(tmp_path / "a.obj").element_kind == "point"
    (tmp_path / "b.obj").write_text("# nothing\n")
    refused(tmp_path / "b.obj", "no vertices")
    (tmp_path / "c.obj").write_text(TRIANGLE + "v 0 0 1\nf 1 1 1\nf 2 2 3\n")
    asset = open_asset(tmp_path / "c.obj")
    assert asset.element_kind == "point" and "none of its 2 faces" in asset.warnings[0]
    (tmp_path / "d.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    refused(tmp_path / "d.obj", "none of its 1 faces has an area")
    refused(tmp_path / "gone", "no such file; check the path")
    (tmp_path / "bare").write_text("x")
    refused(tmp_path / "bare", "files without a suffix can't be opened")


def test_missing_and_broken_materials_are_warnings(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("mtllib gone.mtl\n" + TRIANGLE + "usemtl x\nf 1 2 3\n")
    assert "gone.mtl" in open_asset(path).warnings[0]
    (tmp_path / "gone.mtl").write_text("newmtl x\nmap_Kd gone.png\nKd one two\n")
    assert "gone.png" in open_asset(path).warnings[0]
    (tmp_path / "gone.png").write_bytes(b"no image at all")
    assert "not an image" in open_asset(path).warnings[0]


@pytest.mark.parametrize(
    "name", ["../secret", "/etc/passwd", "sub/../../secret", "link", "http://a/b"]
)
def test_references_may_not_leave_the_folder(tmp_path: Path, name: str) -> None:
    """The secret is a valid material, so that reading it would show."""
    folder = tmp_path / "in"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "secret").write_text("newmtl m\nKd 1 0 0\n")
    (folder / "link").symlink_to(tmp_path / "secret")
    (folder / "a.obj").write_text(f"mtllib {name}\n{TRIANGLE}usemtl m\nf 1 2 3\n")
    asset = open_asset(folder / "a.obj")
    assert asset.mesh is not None and asset.mesh.materials[0].base_color != (255, 0, 0, 255)
    assert "not used" in asset.warnings[0]
    tree = {"asset": {"version": "2.0"}, "buffers": [{"uri": name, "byteLength": 4}],
            "bufferViews": [{"buffer": 0, "byteLength": 4}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 1}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}  # fmt: skip
    (folder / "a.gltf").write_text(json.dumps(tree))
    refused(folder / "a.gltf", "outside|absolute|address")
    (folder / "object.json").write_text(json.dumps({"parts": [{"file": name}]}))
    with pytest.raises(InputFileError, match=r"outside|absolute|address"):
        read_part_files(folder)
    (folder / "mobility.urdf").write_text(
        f'<robot name="r"><link name="a"><visual><geometry><mesh filename="{name}"/></geometry>'
        "</visual></link></robot>"
    )
    with pytest.raises(InputFileError, match=r"outside|absolute|address"):
        open_asset(folder)


def test_xml_entities_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mobility.urdf").write_text(
        '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="r">&a;</robot>'
    )
    with pytest.raises(InputFileError, match="entities"):
        open_asset(tmp_path)
    (tmp_path / "mobility.urdf").write_text(
        '<robot name="r"><link name="a"><visual><origin xyz="0.01, 0 0"/><geometry>'
        '<box size="1 1 1"/></geometry></visual></link></robot>'
    )
    with pytest.raises(InputFileError, match="blanks between"):
        open_asset(tmp_path)


def test_absurd_counts_are_not_believed(tmp_path: Path) -> None:
    for style in ("ascii", "binary_little_endian"):
        (tmp_path / "a.ply").write_text(ply_head(10**12, style=style) + "0 0 0\n")
        began = time.perf_counter()
        refused(tmp_path / "a.ply", "promises 1000000000000 rows")
        assert time.perf_counter() - began < 0.5
    (tmp_path / "a.stl").write_bytes(b"\0" * 80 + (2**32 - 1).to_bytes(4, "little") + b"\0" * 50)
    refused(tmp_path / "a.stl", "promises 4294967295 triangles")
    (tmp_path / "a.pcd").write_text(
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 999999999999\nHEIGHT 1\nDATA binary\n1234"
    )
    refused(tmp_path / "a.pcd", "promises 999999999999 points")
    tree = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "accessors": [{"componentType": 5126, "type": "VEC3", "count": 10**13}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}  # fmt: skip
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    refused(tmp_path / "a.gltf", "counts")


def test_indices_out_of_range(tmp_path: Path) -> None:
    for bad in ("4", "0", "-4", "99999999999999999999"):
        (tmp_path / "a.obj").write_text(TRIANGLE + f"f 1 2 {bad}\n")
        refused(tmp_path / "a.obj", "vertex|absurd|whole number")
    (tmp_path / "a.ply").write_text(ply_head(3, faces=1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    refused(tmp_path / "a.ply", "vertex 7 of 3")


def test_gltf_cycles_and_compression(tmp_path: Path) -> None:
    tree = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
            "nodes": [{"children": [1]}, {"children": [0]}]}  # fmt: skip
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    refused(tmp_path / "a.gltf", "cycle")
    tree = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    (tmp_path / "b.gltf").write_text(json.dumps(tree))
    refused(tmp_path / "b.gltf", "Draco")


def test_broken_part_folders(tmp_path: Path, ball: Mesh) -> None:
    write_mesh(ball, tmp_path / "link_0.ply")
    (tmp_path / "link_1.ply").write_text(ply_head(0))
    with pytest.raises(InputFileError, match=r"link_1\.ply.*neither points nor faces"):
        read_part_files(tmp_path)
    for text in ("{", "[]", "{}", '{"parts": []}', '{"parts": [3]}',
                 '{"parts": [{"file": "no.obj"}]}',
                 '{"parts": ["link_0.ply", "link_0.ply"]}'):  # fmt: skip
        (tmp_path / "object.json").write_text(text)
        with pytest.raises(InputFileError, match=r"object\.json"):
            read_part_files(tmp_path)
    with pytest.raises(InputFileError, match="no such folder"):
        read_part_files(tmp_path / "gone")


def test_many_shells_and_huge_polygons_open(tmp_path: Path) -> None:
    """200 disconnected triangles, and a star that no fan can fill."""
    rows = [f"v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nf -3 -2 -1\n" for i in range(200)]
    (tmp_path / "a.obj").write_text("".join(rows))
    assert open_asset(tmp_path / "a.obj").element_count == 200
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = np.where(np.arange(400) % 2, 0.3, 1.0)
    rows = [
        f"v {x:.6f} {y:.6f} 0"
        for x, y in zip(radius * np.cos(angle), radius * np.sin(angle), strict=True)
    ]
    (tmp_path / "b.obj").write_text(
        "\n".join(rows) + "\nf " + " ".join(map(str, range(1, 401))) + "\n"
    )
    mesh = open_asset(tmp_path / "b.obj").mesh
    assert mesh is not None
    assert mesh.face_areas.sum() == pytest.approx(200 * 0.3 * np.sin(np.pi / 200), rel=1e-4)


@pytest.fixture
def samples(tmp_path: Path, textured: Mesh, cloud: PointCloud) -> list[Path]:
    """One small valid file of each kind."""
    small = cloud.take(np.arange(60))
    assert small.colors is not None
    folder = tmp_path / "samples"
    folder.mkdir()
    for suffix in (".obj", ".glb", ".ply", ".stl"):
        write_mesh(textured, folder / f"mesh{suffix}")
    write_cloud(small, folder / "cloud.ply")
    rows = "\n".join(
        " ".join(f"{v:.6g}" for v in r) for r in np.column_stack([small.points, small.colors])
    )
    (folder / "cloud.xyz").write_text(rows)
    bare = re.sub(r"( \d+){3}$", "", rows, flags=re.M)
    (folder / "ascii.ply").write_text(ply_head(60) + bare)
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA {}\n"
    (folder / "cloud.pcd").write_bytes(head.format("binary").encode() + small.points.tobytes())
    np.savez(folder / "cloud.npz", points=small.points)
    return [p for p in sorted(folder.iterdir()) if p.suffix in SUFFIXES]


def test_an_archive_that_unpacks_to_far_more_is_refused_before_it_is_unpacked(tmp_path) -> None:
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, points=np.zeros((6_000_000, 3), np.float32))
    assert path.stat().st_size < 200_000
    tracemalloc.start()
    try:
        with pytest.raises(InputFileError, match="unpacks to"):
            open_asset(path)
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


def test_points_of_an_archive_keep_their_precision(tmp_path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 4))
    for kind in (np.float16, np.float32, np.float64, ">f4"):
        np.savez(tmp_path / "cloud.npz", points=points.astype(kind))
        read = read_npz(tmp_path / "cloud.npz").vertices
        assert read.dtype == (np.float64 if kind is np.float64 else np.float32)
        assert (read == points.astype(kind)[:, :3]).all()


TOKENS = [
    b"-1",
    b"99999999999999999999",
    b"nan",
    b"1e400",
    b"null",
    b"[]",
    b"{}",
    b"/",
    b"\n",
    b"\0",
]


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    at = int(rng.integers(0, len(out)))
    match int(rng.integers(0, 5)):
        case 0:
            return bytes(out[:at])
        case 1:
            for i in rng.integers(0, len(out), 4):
                out[i] = rng.integers(0, 256)
        case 2:
            out[min(at, 400)] = rng.integers(0, 256)
        case 3:
            del out[at : at + int(rng.integers(1, 200))]
        case _:
            out[at:at] = TOKENS[int(rng.integers(0, len(TOKENS)))]
    return bytes(out)


@pytest.mark.parametrize("seed", range(3))
def test_damaged_bytes_never_surprise(tmp_path: Path, samples: list[Path], seed: int) -> None:
    """Anything but an asset or an error of ours, and any warning of numpy's, fails the test."""
    rng = np.random.default_rng(seed)
    outcomes = set()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in samples:
            assert open_asset(path).element_count > 0
            data = path.read_bytes()
            for _ in range(60):
                target = path.with_name(f"damaged{path.suffix}")
                target.write_bytes(damaged(data, rng))
                try:
                    asset = open_asset(target)
                    assert np.isfinite(asset.bounds).all() and asset.element_count > 0
                    outcomes.add("opened")
                except ArtiworldError as error:
                    assert "damaged" in str(error)
                    outcomes.add("refused")
    assert outcomes == {"opened", "refused"}


def test_every_cut_of_a_glb_is_noticed(samples: list[Path]) -> None:
    glb = next(p for p in samples if p.suffix == ".glb")
    data = glb.read_bytes()
    for size in range(0, len(data), 97):
        glb.write_bytes(data[:size])
        refused(glb, "empty|cut off|instead of|not glTF|not UTF|is not")
