"""What costs more than an object may is refused from its header, or in time that grows linearly."""

import io
import json
import os
import struct
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import pytest
from PIL import Image

from model.core import textures
from model.core.errors import InputFileError
from model.io.open_asset import open_asset
from tests.builders import gltf_of, ply_head

BOX = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


def png_header(side: int) -> bytes:
    """The beginning of a PNG of so many pixels, without them."""
    head = struct.pack(">2I5B", side, side, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + head
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk
    return head + struct.pack(">II", zlib.crc32(chunk), 0) + b"IDAT"


def textured(folder: Path, images: int) -> Path:
    """An OBJ with so many triangles, each with a texture of its own."""
    rows = [f"newmtl m{i}\nmap_Kd t{i}.png\n" for i in range(images)]
    (folder / "a.mtl").write_text("".join(rows))
    faces = "".join(f"usemtl m{i}\nf 1/1 2/2 3/3\n" for i in range(images))
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{BOX}{faces}")
    return folder / "a.obj"


def test_the_sum_of_the_textures_is_limited(tmp_path: Path, monkeypatch) -> None:
    path = textured(tmp_path, 5)
    for i in range(5):
        Image.new("RGB", (100, 100), (i, 0, 0)).save(tmp_path / f"t{i}.png")
    monkeypatch.setattr(textures, "MOST_PIXELS", 30_000)
    for _ in range(2):  # each reading has a budget of its own
        asset = open_asset(path)
        assert asset.mesh is not None
        assert sum(m.texture is not None for m in asset.mesh.materials) == 3
        assert sum("million pixels" in w for w in asset.warnings) == 2


def test_sizes_of_images_are_read_from_their_headers(tmp_path: Path, monkeypatch) -> None:
    path = textured(tmp_path, 2)
    for i, side in enumerate((13_000, 40_000)):
        (tmp_path / f"t{i}.png").write_bytes(png_header(side))
    monkeypatch.setattr(textures, "MOST_PIXELS", 1000)
    began = time.perf_counter()
    beyond_all, alone = open_asset(path).warnings
    assert "million pixels" in beyond_all and "pixels" in alone
    assert time.perf_counter() - began < 1


def test_a_texture_that_is_a_pipe_holds_nobody_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    head = ply_head(3, "float x y z s t", faces=1)
    head = head.replace("made elsewhere", "TextureFile pipe.png")
    (tmp_path / "a.ply").write_text(head + "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n")
    assert any("regular file" in w for w in open_asset(tmp_path / "a.ply").warnings)


def test_a_text_cloud_in_one_line_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1.5,2.5,3.5," * 2_000_000)
    began = time.perf_counter()
    with pytest.raises(InputFileError, match="line of more than 100,000 characters"):
        open_asset(path)
    assert time.perf_counter() - began < 2
    path.write_text("0 0 0\n" * 5 + "1 " * 100_000 + "\n0 1 0\n")
    with pytest.raises(InputFileError, match="line of more than"):
        open_asset(path)


def test_lines_of_an_old_macintosh_are_lines(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_bytes(b"0 0 0\r1 0 0\r0 1 0\r0 0 1\r")
    assert open_asset(tmp_path / "a.xyz").element_count == 4


def gltf(path: Path, nodes: list[dict]) -> Path:
    points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    (path.parent / "b.bin").write_bytes(points)
    buffers = [{"byteLength": 36, "uri": "b.bin"}]
    path.write_text(json.dumps(gltf_of(nodes=nodes, buffers=buffers)))
    return path


def test_many_nodes_of_a_gltf_are_read_in_linear_time(tmp_path: Path) -> None:
    def seconds(count: int) -> float:
        children = [{"mesh": 0, "translation": [i, 0, 0]} for i in range(count)]
        path = gltf(tmp_path / "a.gltf", [{"children": [*range(1, count + 1)]}, *children])
        took = []
        for _ in range(3):
            began = time.process_time()
            assert open_asset(path).element_count == count
            took.append(time.process_time() - began)
        return min(took)

    seconds(100)
    few, many = seconds(1000), seconds(8000)
    assert many < 24 * few  # 8 times as many; three times that for other work on the machine
    too_many = gltf(tmp_path / "b.gltf", [{} for _ in range(200_001)])
    with pytest.raises(InputFileError, match="more than 200,000 nodes"):
        open_asset(too_many)


@pytest.mark.skipif(sys.platform == "darwin", reason="macOS has no such limit")
def test_a_process_with_a_limit_gets_a_clear_error_and_lives(tmp_path: Path) -> None:
    """An image that needs 500 MB, in a process that may take 200 MB more than it has."""
    out = io.BytesIO()
    Image.new("L", (12_000, 12_000)).save(out, "PNG")
    textured(tmp_path, 1)
    (tmp_path / "t0.png").write_bytes(out.getvalue())
    code = (
        "import sys, resource; from model.core import memory; from model.io.open_asset import "
        "open_asset; from model.core.errors import InputFileError; import model.io.formats.mtl\n"
        "used = int(open('/proc/self/statm').read().split()[5]) * resource.getpagesize()\n"
        "memory.LEAST = 0; memory.machine_memory = lambda: used + 200_000_000\n"
        "memory.limit_memory(1.0)\n"
        "try: open_asset(sys.argv[1])\n"
        "except InputFileError as error: print(error)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.obj")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "doesn't fit into memory" in done.stdout, done.stderr


def test_many_comments_before_a_cloud_are_passed_over_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("# scanned\n" * 200_000 + "x y z\n" + "0 0 0\n1 0 0\n0 1 0\n0 0 1\n" * 20_000)
    began = time.perf_counter()
    assert open_asset(path).element_count == 80_000
    assert time.perf_counter() - began < 5


def test_remarks_without_number_are_counted(tmp_path: Path) -> None:
    lines = "".join(f"mtllib gone{i}.mtl\n" for i in range(2000))
    (tmp_path / "a.obj").write_text(f"{lines}{BOX}f 1 2 3\n")
    began = time.perf_counter()
    warnings = open_asset(tmp_path / "a.obj").warnings
    assert len(warnings) == 51 and "1,950 more remarks" in warnings[-1]
    assert time.perf_counter() - began < 20


def test_a_mesh_that_names_its_points_many_times_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("model.io.formats.loaded.MOST_VALUES", 1000)
    path = gltf(tmp_path / "a.gltf", [{"mesh": 0}])
    tree = json.loads(path.read_text())
    tree["meshes"][0]["primitives"] *= 400
    path.write_text(json.dumps(tree))
    with pytest.raises(InputFileError, match="more than 1,000 corners and points"):
        open_asset(path)


def instances_of_usd(path: Path) -> None:
    """Two to the 24th cubes, in instances of instances."""
    pytest.importorskip("pxr")
    levels = "".join(
        f'def Xform "l{i}" {{\n'
        + "".join(
            f'def Xform "{side}" (\ninstanceable = true\nreferences = </l{i + 1}>\n) {{}}\n'
            for side in "ab"
        )
        + "}\n"
        for i in range(24)
    )
    path.write_text(
        f'#usda 1.0\n(\nupAxis = "Z"\n)\n{levels}def Xform "l24" {{\ndef Cube "c" {{}}\n}}\n'
    )


def instances_of_dae(path: Path) -> None:
    """Two to the 24th triangles."""
    source, geometry = ET.Element("source", id="p"), ET.Element("geometry", id="g")
    ET.SubElement(source, "float_array", id="a", count="9").text = "0 0 0 1 0 0 0 1 0"
    common = ET.SubElement(ET.SubElement(source, "technique_common"), "accessor")
    common.attrib = {"source": "#a", "count": "3", "stride": "3"}
    for axis in "XYZ":
        ET.SubElement(common, "param", name=axis, type="float")
    mesh = ET.SubElement(geometry, "mesh")
    mesh.append(source)
    vertices = ET.SubElement(mesh, "vertices", id="v")
    ET.SubElement(vertices, "input", semantic="POSITION", source="#p")
    triangles = ET.SubElement(mesh, "triangles", count="1")
    ET.SubElement(triangles, "input", semantic="VERTEX", source="#v", offset="0")
    ET.SubElement(triangles, "p").text = "0 1 2"
    top = ET.Element("COLLADA", xmlns="http://www.collada.org/2005/11/COLLADASchema")
    top.attrib["version"] = "1.4.1"
    ET.SubElement(top, "library_geometries").append(geometry)
    library = ET.SubElement(top, "library_nodes")
    ET.SubElement(ET.SubElement(library, "node", id="n0"), "instance_geometry", url="#g")
    for i in range(24):
        node = ET.SubElement(library, "node", id=f"n{i + 1}")
        for _ in range(2):
            ET.SubElement(node, "instance_node", url=f"#n{i}")
    scene = ET.SubElement(ET.SubElement(top, "library_visual_scenes"), "visual_scene", id="s")
    ET.SubElement(ET.SubElement(scene, "node"), "instance_node", url="#n24")
    ET.SubElement(ET.SubElement(top, "scene"), "instance_visual_scene", url="#s")
    ET.ElementTree(top).write(path)


def instances_of_gltf(path: Path) -> None:
    """A node with ten triangles, and one with 199,995."""
    at = [{"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": n}}} for n in (1, 2)]
    gltf(path, [{"children": [1, 2]}, *({"mesh": 0, "extensions": each} for each in at)])
    tree = json.loads(path.read_text())
    for count in (10, 199_995):
        tree["accessors"].append({"componentType": 5126, "count": count, "type": "VEC3"})
    path.write_text(json.dumps(tree))


@pytest.mark.parametrize(
    ("name", "write"),
    [("a.usda", instances_of_usd), ("a.dae", instances_of_dae), ("a.gltf", instances_of_gltf)],
)
def test_instances_are_counted_before_they_are_made(tmp_path: Path, name: str, write) -> None:
    write(tmp_path / name)
    began = time.process_time()
    with pytest.raises(InputFileError, match="more than 200,000 nodes, with those that it repeats"):
        open_asset(tmp_path / name)
    assert time.process_time() - began < 20


def test_instances_of_a_large_mesh_are_counted(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("pxr")
    rows = "".join(
        f'def Xform "i{i}" (\ninstanceable = true\nreferences = </p>\n) {{}}\n' for i in range(5)
    )
    (tmp_path / "a.usda").write_text(
        f'#usda 1.0\n(\nupAxis = "Z"\n)\nclass "p" {{\ndef Sphere "c" {{}}\n}}\n{rows}'
    )
    assert open_asset(tmp_path / "a.usda").element_count == 5 * 1280
    monkeypatch.setattr("model.io.formats.loaded.MOST_VALUES", 4 * 4500)
    with pytest.raises(InputFileError, match="more than 18,000 corners and points"):
        open_asset(tmp_path / "a.usda")


def test_a_binary_stage_that_ends_or_holds_pxr_is_refused(tmp_path: Path, monkeypatch) -> None:
    sdf = pytest.importorskip("pxr.Sdf")
    layer = sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString('#usda 1.0\n(\nupAxis = "Z"\n)\ndef Cube "c" {\n}\n')
    layer.Export(str(tmp_path / "a.usdc"))
    assert open_asset(tmp_path / "a.usdc").element_count == 12
    run = subprocess.run

    def opened_by(code: str) -> None:
        def instead(command: list[str], **more: object) -> object:
            return run([sys.executable, "-c", code], **more)  # type: ignore[call-overload]

        monkeypatch.setattr("model.io.formats.usd.subprocess.run", instead)

    opened_by("import os; os.abort()")
    with pytest.raises(InputFileError, match="crashes pxr"):
        open_asset(tmp_path / "a.usdc")
    monkeypatch.setattr("model.io.formats.usd.OPEN_SECONDS", 0.3)
    opened_by("import time; time.sleep(60)")
    with pytest.raises(InputFileError, match="can't be opened within"):
        open_asset(tmp_path / "a.usdc")
