"""What a reader doesn't know it counts in a remark, or refuses; nothing passes silently."""

import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.errors import InputFileError
from model.io.mjcf_reader import read_mjcf_model
from model.io.open_asset import open_asset
from model.io.robot_xml import MJCF, URDF, XmlSchema
from model.io.urdf.reader import read_urdf_model
from model.scenes.readers.lisdf import SDF
from model.scenes.registry import read_scene
from tests.builders import gltf_of, ply_head, write_glb

URDF_TEXT = """<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="a"><inertial><origin xyz="0 0 0"/><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><origin xyz="0 0 0"/><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="b"><visual><geometry><sphere radius="1"/></geometry></visual>
<collision><geometry><cylinder radius="1" length="1"/></geometry></collision></link>
<joint name="j" type="revolute"><origin xyz="0 0 1"/><parent link="a"/><child link="b"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1"/><dynamics damping="1"/></joint></robot>"""
MJCF_TEXT = """<mujoco model="m"><compiler angle="radian"/><option timestep="0.01"/>
<default><geom rgba="1 0 0 1"/></default><asset><material name="x" rgba="1 1 1 1"/></asset>
<worldbody><light pos="0 0 3"/><body name="a"><geom type="box" size="1 1 1" material="x"/>
<frame pos="0 0 1"><body name="b"><joint name="j" axis="0 0 1" range="0 1"/>
<geom type="sphere" size="1"/></body></frame></body></worldbody></mujoco>"""
SDF_TEXT = """<sdf version="1.9"><world name="w"><frame name="f"><pose>1 0 0 0 0 0</pose></frame>
<include name="c"><uri>a/b.urdf</uri><pose relative_to="f">0 0 0 0 0 0</pose><static>1</static>
<scale>1</scale></include><model name="box"><static>1</static><pose>0 0 0 0 0 0</pose>
<link name="l"><collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>
</link></model></world></sdf>"""


def urdf_notes(path: Path) -> list[str]:
    return list(read_urdf_model(path).notes)


def mjcf_notes(path: Path) -> list[str]:
    return list(read_mjcf_model(path).notes)


def sdf_notes(path: Path) -> list[str]:
    return [p.reason for p in read_scene(path).problems]


FORMATS: dict[str, tuple[str, str, XmlSchema, Callable[[Path], list[str]]]] = {
    "URDF": ("a.urdf", URDF_TEXT, URDF, urdf_notes),
    "MJCF": ("a.xml", MJCF_TEXT, MJCF, mjcf_notes),
    "SDF": ("a.sdf", SDF_TEXT, SDF, sdf_notes),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_of_known_items_has_no_remark(name: str, tmp_path: Path) -> None:
    file, text, _, notes_of = FORMATS[name]
    (tmp_path / file).write_text(text)
    assert not [n for n in notes_of(tmp_path / file) if n.startswith("ignored")]


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=40)
@given(data=st.data())
def test_an_unknown_item_anywhere_is_named_or_refused(name: str, data: st.DataObject) -> None:
    file, text, schema, notes_of = FORMATS[name]
    root = ET.fromstring(text)
    within = {child: element for element in root.iter() for child in element}
    known = [e for e in root.iter() if e.tag in schema.elements]
    known = [e for e in known if all(a.tag not in schema.passed_over for a in above(e, within))]
    element = data.draw(st.sampled_from(known))
    # Another element's name is as unknown where it doesn't belong.
    names = st.from_regex(r"[a-z_]{1,12}", fullmatch=True) | st.sampled_from([*schema.elements])
    as_attribute = data.draw(st.booleans())
    below, said = schema.elements[element.tag]
    taken = (said if as_attribute else below) or frozenset()
    word = data.draw(names.filter(lambda w: w not in taken and w not in schema.passed_over))
    if as_attribute and word not in element.attrib:
        element.set(word, "1")
    else:
        word = word if below is None or word not in below else f"{word}_x"
        ET.SubElement(element, word)
    with TemporaryDirectory() as folder:
        path = Path(folder, file)
        path.write_bytes(ET.tostring(root))
        try:
            notes = notes_of(path)
        except InputFileError as error:
            assert path.name in str(error)
            return
    assert any(word in note for note in notes)


def above(element: ET.Element, within: dict[ET.Element, ET.Element]) -> list[ET.Element]:
    out = [element]
    while out[-1] in within:
        out.append(within[out[-1]])
    return out


def test_kinds_are_counted_and_cut_short() -> None:
    root = ET.fromstring("<robot>" + "".join(f"<x{i}/>" * (9 - i) for i in range(8)) + "</robot>")
    (note,) = URDF.unread(root)
    assert "<x0> in <robot> (9)" in note and "3 kinds more" in note and "<x7>" not in note


def test_what_an_sdf_world_has_beside_is_told(tmp_path: Path) -> None:
    more = SDF_TEXT.replace('<link name="l">', '<joint name="j"/><link name="k"/><link name="l">')
    more = more.replace("</sdf>", '<world name="second"/></sdf>')
    (tmp_path / "a.sdf").write_text(more)
    notes = " ".join(sdf_notes(tmp_path / "a.sdf"))
    assert "joint 'j' needs <parent>" in notes and "only the first of 2 worlds" in notes
    assert "first of 2 worlds" in notes


def glb(tree: dict, path: Path) -> Path:
    points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    return write_glb(path, gltf_of(**tree), points)


def test_unknown_extensions_of_gltf_are_named_and_required_ones_refused(tmp_path: Path) -> None:
    assert open_asset(glb({}, tmp_path / "a.glb")).element_count == 1
    optional = glb({"extensionsUsed": ["MSFT_lod", "KHR_materials_ior"]}, tmp_path / "b.glb")
    assert open_asset(optional).warnings == ("ignored: extensions MSFT_lod",)
    for required in (["KHR_texture_transform_2"], [7], [["nested"]]):
        with pytest.raises(InputFileError, match="needs the extension"):
            open_asset(glb({"extensionsRequired": required}, tmp_path / "c.glb"))


def test_built_in_textures_and_huge_height_fields_of_mjcf(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    texture = '<texture name="t" builtin="checker" width="90000" height="90000"/>'
    with_texture = MJCF_TEXT.replace("<asset>", f"<asset>{texture}")
    path.write_text(with_texture.replace('name="x"', 'name="x" texture="t"'))
    assert "not kept: the built-in texture 't'" in mjcf_notes(path)
    field = '<asset><hfield name="h" size="1 1 1 1" {}/>'
    for said in ('nrow="50000" ncol="50000"', 'file="h.bin"'):
        (tmp_path / "h.bin").write_bytes(struct.pack("<2i", 50_000, 50_000))
        path.write_text(MJCF_TEXT.replace("<asset>", field.format(said)))
        with pytest.raises(InputFileError, match=r"50,000 x 50,000 cells"):
            mjcf_notes(path)
    path.write_text(MJCF_TEXT.replace("<asset>", field.format('nrow="50" ncol="50"')))
    mjcf_notes(path)


@pytest.mark.parametrize("number", ["1000000000000", "-7", "99999999999999999999"])
@pytest.mark.parametrize("kind", ["obj", "ply", "dae"])
def test_an_index_is_reported_as_it_is_written(kind: str, number: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{kind}"
    corners = ["0 0 0", "1 0 0", "0 1 0"]
    if kind == "obj":
        rows = "".join(f"v {c}\n" for c in corners)
        path.write_text(f"{rows}f 1 2 3\nf 1 2 {number}\n")
    elif kind == "ply":
        path.write_text(ply_head(3, faces=2) + "\n".join([*corners, "3 0 1 2", f"3 0 1 {number}"]))
    else:
        pytest.importorskip("collada")
        path.write_text(f"<COLLADA><p>0 1 {number}</p></COLLADA>")
    shown = f"{float(number):g}" if kind != "dae" and len(number) > 18 else number
    if kind == "dae" and number == "-7":
        shown = ""
    with pytest.raises(InputFileError, match=shown.replace("+", r"\+")) as caught:
        open_asset(path)
    assert "9223372036854775808" not in str(caught.value)
    assert kind == "dae" or "face 1" in str(caught.value)


def test_what_a_stage_draws_beside_meshes_is_counted(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "a.usda").write_text(
        '#usda 1.0\n(\n upAxis = "Z"\n)\ndef Xform "w" {\ndef Cube "c" {}\n'
        'def PointInstancer "p" {}\ndef BasisCurves "b" {}\ndef BasisCurves "d" {}\n}\n'
    )
    warnings = open_asset(tmp_path / "a.usda").warnings
    assert warnings == ("ignored: BasisCurves (2), PointInstancer (1)",)
