"""Formats of scanners, from files that their own libraries write, and broken ones of each."""

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from model.core.errors import ArtiworldError, InputFileError
from model.geometry.sampling import face_colors
from model.io.open_asset import open_asset

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]])
COLORS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]], np.uint8)


def las(path: Path) -> Path:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = [0.001] * 3
    file = laspy.LasData(header)
    file.x, file.y, file.z = POINTS.T
    file.red, file.green, file.blue = (COLORS.astype(np.uint16) * 257).T
    file.write(path)
    return path


def e57(path: Path) -> Path:
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(path), mode="w")
    names = ("cartesianX", "cartesianY", "cartesianZ", "colorRed", "colorGreen", "colorBlue")
    columns = [*POINTS.T, *COLORS.T]
    file.write_scan_raw(dict(zip(names, columns, strict=True)))
    file.close()
    return path


def dae(path: Path) -> Path:
    collada = pytest.importorskip("collada")
    file = collada.Collada()
    file.assetInfo.upaxis, file.assetInfo.unitmeter, file.assetInfo.unitname = "Y_UP", 0.01, "cm"
    effect = collada.material.Effect("e", [], "phong", diffuse=(1, 0, 0, 1))
    material = collada.material.Material("m", "red", effect)
    file.effects.append(effect)
    file.materials.append(material)
    source = collada.source.FloatSource("v", (100 * POINTS).ravel(), ("X", "Y", "Z"))
    geometry = collada.geometry.Geometry(file, "g", "tetra", [source])
    inputs = collada.source.InputList()
    inputs.addInput(0, "VERTEX", "#v")
    index = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    geometry.primitives.append(geometry.createTriangleSet(index, inputs, "m"))
    file.geometries.append(geometry)
    bound = collada.scene.MaterialNode("m", material, inputs=[])
    node = collada.scene.Node("n", children=[collada.scene.GeometryNode(geometry, [bound])])
    file.scenes.append(collada.scene.Scene("s", [node]))
    file.scene = file.scenes[0]
    file.write(str(path))
    return path


def usd(path: Path) -> Path:
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom, UsdUtils

    plain = path.with_suffix(".usdc")
    stage = Usd.Stage.CreateNew(str(plain))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    mesh = UsdGeom.Mesh.Define(stage, "/tetra")
    mesh.CreatePointsAttr((100 * POINTS).tolist())
    mesh.CreateFaceVertexCountsAttr([3] * 4)
    mesh.CreateFaceVertexIndicesAttr([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    stage.Save()
    if path.suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(plain)), str(path))
    return path


WRITERS = {"a.las": las, "a.laz": las, "a.e57": e57}
MESHES = {"a.dae": dae, "a.usdc": usd, "a.usdz": usd}


@pytest.mark.parametrize("name", WRITERS)
def test_clouds_keep_places_and_colours(name: str, tmp_path: Path) -> None:
    asset = open_asset(WRITERS[name](tmp_path / name))
    assert asset.cloud is not None and asset.cloud.colors is not None
    assert asset.cloud.points == pytest.approx(POINTS, abs=1e-3)
    assert asset.cloud.colors.tolist() == COLORS.tolist()


@pytest.mark.parametrize("name", MESHES)
def test_meshes_are_turned_and_scaled_as_they_state(name: str, tmp_path: Path) -> None:
    asset = open_asset(MESHES[name](tmp_path / name))
    assert asset.mesh is not None and len(asset.mesh.faces) == 4
    # y up and centimetres: (x, y, z) stands at (x, -z, y) metres.
    assert asset.mesh.bounds == pytest.approx(np.array([[0, -3, 0], [1, 0, 2]]), abs=1e-6)
    if name.endswith(".dae"):
        assert asset.mesh.materials[0].base_color[:3] == (255, 0, 0)


@pytest.mark.parametrize("name", [*WRITERS, *MESHES])
@pytest.mark.parametrize("damage", ["cut", "noise", "text"])
def test_a_broken_file_is_named(name: str, damage: str, tmp_path: Path) -> None:
    path = (WRITERS | MESHES)[name](tmp_path / name)
    data = bytearray(path.read_bytes())
    if damage == "cut":
        data = data[: len(data) // 3]
    elif damage == "noise":
        rng = np.random.default_rng(0)
        data[4:] = rng.integers(0, 256, len(data) - 4, dtype=np.uint8).tobytes()
    else:
        data = bytearray(b"not a scan at all\n" * 10)
    path.write_bytes(data)
    with pytest.raises(ArtiworldError) as error:
        open_asset(path)
    assert isinstance(error.value, InputFileError) and name in str(error.value)


def test_a_laz_that_declares_billions_of_chunks_is_refused(tmp_path: Path) -> None:
    """lazrs would ask for 70 GB, get none, and end the process."""
    path = las(tmp_path / "a.laz")
    data = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, start)
    chunk = data.index(b"laszip encoded") - 2 + 54 + 12  # points of a chunk
    wrong = ((table + 4, "<I", 2**32 - 1), (start, "<q", 2**40), (start, "<q", 0))
    for place, form, value in (*wrong, (chunk, "<I", 2**31)):
        damaged = bytearray(data)
        struct.pack_into(form, damaged, place, value)
        path.write_bytes(damaged)
        with pytest.raises(InputFileError, match="damaged LAS header"):
            open_asset(path)
    path.write_bytes(data)
    assert open_asset(path).element_count == len(POINTS)


def test_a_panic_of_a_rust_library_is_a_damaged_file(tmp_path: Path, monkeypatch) -> None:
    """lazrs panics at some damages; what it raises is no ``Exception``."""
    laspy = pytest.importorskip("laspy")
    panic = type("PanicException", (BaseException,), {})

    def read(*_: object) -> None:
        raise panic("capacity overflow")

    path = las(tmp_path / "a.las")
    monkeypatch.setattr(laspy.LasReader, "read", read)
    with pytest.raises(InputFileError, match="capacity overflow"):
        open_asset(path)
    monkeypatch.setattr(
        laspy.LasReader, "read", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        open_asset(path)


XYZ = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
DAE = f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>%(image)s</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="p"><sampler2D><source>s</source></sampler2D></newparam>
<technique sid="c"><phong><diffuse><texture texture="p" texcoord="UV"/></diffuse></phong>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="v"><float_array id="va" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#va" count="4" stride="3">{XYZ}</accessor></technique_common>
</source><source id="t"><float_array id="ta" count="4">0.25 0.25 0.75 0.75</float_array>
<technique_common><accessor source="#ta" count="2" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="vs"><input semantic="POSITION" source="#v"/></vertices>
<triangles material="M" count="4"><input semantic="VERTEX" source="#vs" offset="0"/>%(inputs)s
<p>%(index)s</p>
</triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="M" target="#m">
<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="7"/></instance_material>
</technique_common></bind_material></instance_geometry></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
SETS = tuple(
    f'<input semantic="TEXCOORD" source="#t" offset="{at}" set="{number}"/>'
    for at, number in ((1, 3), (2, 7))
)
SIDES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
BLUE, RED, GREY = (0, 0, 255, 255), (255, 0, 0, 255), (200, 200, 200, 255)
DRESSED = {  # image, inputs, colours of faces, what is told
    "beside": ("./tex/a%20b.png", SETS, {RED: 3, BLUE: 1}, ""),
    "one set": ("tex/a b.png", SETS[:1], {RED: 1, BLUE: 3}, ""),
    "of another machine": ("file:///C:/me/own.png", SETS, {RED: 3, BLUE: 1}, ""),
    "missing": ("tex/c.png", SETS, {GREY: 4}, "'tex/c.png' is missing"),
    "without coordinates": ("own.png", (), {(192, 0, 64, 255): 4}, "coordinates of the texture"),
}


@pytest.mark.parametrize("within", ["alone", "urdf"])
@pytest.mark.parametrize("name", DRESSED)
def test_textures_of_collada_are_shown(name: str, within: str, tmp_path: Path) -> None:
    pytest.importorskip("collada")
    image, inputs, colors, said = DRESSED[name]
    corners = np.column_stack([SIDES, [0] * 9 + [1] * 3, [1] * 9 + [0] * 3])[:, : len(inputs) + 1]
    index = " ".join(map(str, corners.ravel()))
    text = DAE % {"image": image, "inputs": "".join(inputs), "index": index}
    folder = tmp_path / "meshes"
    (folder / "tex").mkdir(parents=True)
    (folder / "a.dae").write_text(text)
    picture = Image.new("RGB", (8, 8), RED[:3])
    picture.paste(BLUE[:3], (0, 4, 4, 8))
    for place in ("tex/a b.png", "own.png"):
        picture.save(folder / place)
    path = folder / "a.dae"
    if within == "urdf":
        path = tmp_path / "a.urdf"
        mesh = '<visual><geometry><mesh filename="meshes/a.dae"/></geometry></visual>'
        path.write_text(f'<robot name="r"><link name="l">{mesh}</link></robot>')
    asset = open_asset(path)
    assert asset.mesh is not None
    found, counts = np.unique(face_colors(asset.mesh), axis=0, return_counts=True)
    assert dict(zip(map(tuple, found.tolist()), counts.tolist(), strict=True)) == colors
    assert said in " ".join(asset.warnings) and (said or not asset.warnings)
