"""The table of docs/formats.md: what a file of each format says, and whether it is read or told;
every row has an input."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from model.core.asset import Asset
from model.geometry.sampling import face_colors
from model.io.open_asset import open_asset
from tests.model.io import test_changed_values as changes
from tests.model.io.test_changed_values import E57_ROWS, LAS_ROWS, Facts, same, stated
from tests.model.io.test_field_scans_and_sdf import BOX, ptx_station
from tests.model.io.test_field_values import cubes
from tests.model.io.test_scanner_formats import DAE, SETS
from tests.model.io.test_usd_reports import ROWS as USD_ROWS

DOCUMENT = Path(__file__).parents[3] / "docs/formats.md"
BEGIN, END = "| format | what a file says | |\n|---|---|---|\n", "\n\n"
Files = dict[str, str | bytes]
Table = dict[tuple[str, str], set[bool]]
"""Format and what it says → whether its inputs are read without a remark."""


def obj(material: str = "Kd 1 0 0", names: tuple[str, ...] = ("",), more: str = "") -> Files:
    text = f"mtllib m.mtl\nusemtl m\nvt 0.3 0.3\n{cubes(*names)}\n{more}"
    return {"a.obj": text, "m.mtl": f"newmtl m\n{material}\n"}


def textured_obj(material: str) -> Files:
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0.3 0.3\nusemtl m\n"
    faces = "".join(
        f"f {a}/1 {b}/1 {c}/1\n" for a, b, c in ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))
    )
    return {"a.obj": f"mtllib m.mtl\n{corners}{faces}", "m.mtl": f"newmtl m\n{material}\n"}


def dae(old: str = "", new: str = "", image: str = "t.png") -> Files:
    index = " ".join(f"{v} 0 1" for v in (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3))
    text = DAE % {"image": image, "inputs": "".join(SETS), "index": index}
    assert old in text
    return {"a.dae": text.replace(old, new, 1)}


def ply(fields: str = "", rest: str = "", more: str = "", body: str = "") -> Files:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    named = "".join(f"property {field}\n" for field in ("float z", *fields.split(", ")) if field)
    corners = "".join(f"{p} {rest}\n" for p in ("0 0 0", "1 0 0", "0 1 0", "0 0 1"))
    return {"a.ply": f"{head}{named}{more}end_header\n{corners}{body}"}


FACES = "element face 1\nproperty list uchar int vertex_indices\n"


def pcd(field: str, kind: str, value: str) -> Files:
    head = f"VERSION .7\nFIELDS x y z {field}\nSIZE 4 4 4 4\nTYPE F F F {kind}\nCOUNT 1 1 1 1\n"
    rows = "".join(f"{p} {value}\n" for p in ("0 0 0", "1 0 0", "0 1 0", "0 0 1"))
    return {"a.pcd": f"{head}WIDTH 4\nHEIGHT 1\nPOINTS 4\nDATA ascii\n{rows}"}


def stl(head: bytes, attribute: int) -> Files:
    faces = np.zeros(4, [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    faces["v"], faces["a"] = BOX[[[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]]], attribute
    return {"a.stl": head.ljust(80) + np.uint32(4).tobytes() + faces.tobytes()}


def ptx(rest: str) -> Files:
    pose = np.array([[0, -1, 0, 2], [1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    return {"a.ptx": ptx_station(BOX + 0.5, [rest] * 8, pose)}


def mobility(mesh: str) -> Files:
    text = changes.URDF.replace("m.stl", f"textured_objs/{mesh}").replace('"door"', '"link_1"')
    names = "link_1 hinge rotation_door\n"
    door = "v 0 0 -.5\nv .8 0 -.5\nv 0 0 .5\nv 0 .02 0\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    named = {"semantics.txt": names, "textured_objs/a.obj": door}
    door_again = (
        '<visual><geometry><mesh filename="textured_objs/a.obj"/></geometry></visual></link>'
    )
    return {
        "mobility.urdf": text.replace(
            '</link>\n<link name="drawer"', door_again + '\n<link name="drawer"'
        ),
        **named,
    }


ASCII = "solid a\n" + "".join(
    f"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 {k}\n"
    "endloop\nendfacet\n"
    for k in range(4)
)
PTX = "stations in their poses, colours; intensities"
INPUTS: list[tuple[str, str, Files, str]] = [
    ("OBJ", "colour and opacity of materials", obj(), "colours: #ff0000ff; faces: 12"),
    ("OBJ", "colour and opacity of materials", obj("Kd 1 0 0\nd 0.4"), "colours: #ff000066"),
    ("OBJ", "colour and opacity of materials", obj("Kd 1 0 0\nTr 0.6"), "colours: #ff000066"),
    ("OBJ", "textures; other maps", textured_obj("map_Kd t.png"), "colours: #cc6633ff"),
    ("OBJ", "textures; other maps", textured_obj("map_Kd gone.png"), "! 'gone.png' is missing"),
    ("OBJ", "textures; other maps", textured_obj("map_d t.png"), "! opacity map"),
    (
        "OBJ",
        "colours of vertices",
        {"a.obj": "v 0 0 0 0 0 1\nv 1 0 0 0 0 1\nv 0 1 0 0 0 1\nf 1 2 3\n"},
        "colours: #0000ffff",
    ),
    (
        "OBJ",
        "objects and groups named after parts",
        obj(names=("o body", "o door")),
        "parts: body door",
    ),
    ("OBJ", "lines, points, curves", obj(more="l 1 2\n"), "! lines (1)"),
    (
        "OBJ",
        "lines, points, curves",
        obj(more="p 1\ncurv 0 1 1 2\n"),
        "! points (1), curved shapes (1)",
    ),
    ("COLLADA", "up axis and unit", dae(), "box: 0 0 0 1 1 1"),
    ("COLLADA", "up axis and unit", dae("Z_UP", "Y_UP"), "box: 0 -1 0 1 0 1"),
    (
        "COLLADA",
        "up axis and unit",
        dae("0 0 0 1 0 0 0 1 0 0 0 1", "0 0 0 2 0 0 0 1 0 0 0 1"),
        "box: 0 0 0 2 1 1",
    ),
    (
        "COLLADA",
        "up axis and unit",
        dae('<unit meter="1"/><up_axis>Z_UP', '<unit meter="0.5"/><up_axis>X_UP'),
        "box: -0.5 0 0 0 0.5 0.5",
    ),
    ("COLLADA", "diffuse colour or its texture", dae(), "colours: #cc6633ff"),
    ("COLLADA", "diffuse colour or its texture", dae(image="gone.png"), "! 'gone.png' is missing"),
    (
        "COLLADA",
        "lines, skins, morphs",
        dae(
            "</mesh>",
            '<lines count="1"><input semantic="VERTEX" source="#vs" offset="0"/>'
            "<p>0 1</p></lines></mesh>",
        ),
        "! pieces of lines",
    ),
    ("STL", "binary and ASCII", {"a.stl": ASCII + "endsolid a\n"}, "faces: 4"),
    ("STL", "binary and ASCII", stl(b"", 0), "faces: 4"),
    ("STL", "colours", stl(b"COLOR=", 31), "! colours of STL files"),
    ("STL", "colours", stl(b"VisCAM", 31 | 1 << 15), "! colours of STL files"),
    (
        "PLY",
        "colours of vertices and faces",
        ply("uchar red, uchar green, uchar blue", "9 8 7"),
        "colours: #090807ff; points: 4",
    ),
    (
        "PLY",
        "colours of vertices and faces",
        ply(
            more=FACES + "property uchar red\nproperty uchar green\nproperty uchar blue\n",
            body="3 0 1 2 9 8 7\n",
        ),
        "colours: #090807ff; faces: 1",
    ),
    (
        "PLY",
        "textures by comments",
        ply("float s, float t", "0.3 0.3", "comment TextureFile t.png\n" + FACES, "3 0 1 2\n"),
        "colours: #cc6633ff",
    ),
    (
        "PLY",
        "textures by comments",
        ply("float s, float t", "0.3 0.3", "comment TextureFile gone.png\n" + FACES, "3 0 1 2\n"),
        "! gone.png",
    ),
    ("PLY", "intensities, edges, other elements", ply("float intensity", "5"), "! intensities"),
    (
        "PLY",
        "intensities, edges, other elements",
        ply(more="element edge 1\nproperty int vertex1\n", body="0\n"),
        "! edge (1)",
    ),
    ("PCD", "colours", pcd("rgb", "U", str(0x090807)), "colours: #090807ff; points: 4"),
    ("PCD", "colours", pcd("rgb", "F", "nan"), "! colours are 'nan'"),
    ("PCD", "intensities", pcd("intensity", "F", "5"), "! intensities"),
    (
        "text",
        "points and colours by columns",
        {"a.xyz": "".join(f"{p} 9 8 7\n" for p in ("0 0 0", "1 0 0", "0 1 0", "0 0 1"))},
        "colours: #090807ff; points: 4",
    ),
    ("PTX", PTX, ptx(""), "points: 8; box: 0.9 1.5 0.5 1.5 2.3 1.7"),
    ("PTX", PTX, ptx("0.5 9 8 7"), "! intensities"),
    (
        "PartNet-Mobility",
        "meshes of links, names of parts",
        mobility("a.obj"),
        "parts: base rotation_door drawer",
    ),
    (
        "PartNet-Mobility",
        "meshes that aren't there",
        mobility("gone.obj"),
        "! 'gone.obj' of link 'link_1' isn't there",
    ),
]
SURVEYS: dict[tuple[str, str], tuple[str, str]] = {  # names of inputs that are read, and of others
    ("LAS, LAZ", "coordinate systems: GeoTIFF keys and WKT, feet, other heights"): (
        "plain, ground, synthetic, feet, survey feet, kilometres, heights, text",
        "fathoms, from the centre, text without unit",
    ),
    ("LAS, LAZ", "points flagged as withheld, classes of noise"): (
        "",
        "withheld, low noise, high noise",
    ),
    ("LAS, LAZ", "colours of 8 and 16 bits; intensities"): (
        "colours, colours of 8 bits",
        "intensity",
    ),
    ("E57", "poses of stations, invalid points"): ("plain, place, turn, invalid", ""),
    ("E57", "colours by their limits; intensities"): ("colours", "intensity"),
}


def plain(asset: Asset) -> Facts:
    shown = asset.mesh or asset.cloud
    assert shown is not None
    out: Facts = {"box": asset.bounds.ravel().tolist(), "parts": " ".join(asset.part_names)}
    out["faces" if asset.mesh else "points"] = asset.element_count
    if asset.mesh is not None:
        out["colours"] = sorted(set(map(tuple, face_colors(asset.mesh).tolist())))
    elif asset.cloud is not None and asset.cloud.colors is not None:
        out["colours"] = sorted({(*c, 255) for c in map(tuple, asset.cloud.colors.tolist())})
    return out


@pytest.mark.parametrize(("format", "what", "files", "says"), INPUTS)
def test_inputs_of_the_table(
    format: str, what: str, files: Files, says: str, tmp_path: Path
) -> None:
    Image.new("RGB", (4, 4), (204, 102, 51)).save(tmp_path / "t.png")
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    asset = open_asset(tmp_path / next(iter(files)))
    if says.startswith("! "):
        assert says[2:] in " | ".join(asset.warnings)
    else:
        assert all(w.startswith("unit: metres;") for w in asset.warnings)
        found = plain(asset)
        assert {k: v for k, v in stated(says).items() if not same(v, found.get(k))} == {}


def table() -> Table:
    out: Table = {}
    for what, (read, told) in USD_ROWS.items():
        out["USD", what] = {bool(r) for r, names in ((True, read), (False, told)) if names}
    for format in ("URDF", "SDF", "MJCF", "glTF, GLB"):
        topic = ""
        for line in getattr(changes, f"{format[:4].upper()}_ROWS").strip("\n").split("\n"):
            if line.startswith("# "):
                topic = line[2:]
            elif " => " in line or "! " in line:
                out.setdefault((format, topic), set()).add("! " not in line)
    for format, what, _, says in INPUTS:
        out.setdefault((format, what), set()).add(not says.startswith("! "))
    return out | {
        row: {bool(r) for r, n in zip((True, False), names, strict=True) if n}
        for row, names in SURVEYS.items()
    }


def lines() -> Iterator[str]:
    for (format, what), read in table().items():
        state = "read; what isn't is told" if len(read) > 1 else "read" if True in read else "told"
        yield f"| {format} | {what} | {state} |"


def test_the_document_has_the_table() -> None:
    text = DOCUMENT.read_text()
    start = text.index(BEGIN) + len(BEGIN)
    assert text[start : text.index(END, start)].split("\n") == list(lines())


def test_every_input_of_surveys_has_a_row() -> None:
    named = [n for names in SURVEYS.values() for each in names for n in each.split(", ") if n]
    assert sorted(named) == sorted([*LAS_ROWS, *E57_ROWS])
