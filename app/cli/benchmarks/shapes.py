"""Shapes that the benchmarks measure with, and small valid files of every format that can be read,
which ``artiworld bench faults`` damages.
"""

from __future__ import annotations

import io
import json
import random
import re
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import Material, Mesh, PointCloud, merged
from model.io.write import write_cloud, write_mesh

Array = npt.NDArray[np.float64]


def chest(drawers: int) -> SegmentedObject:
    """A chest with ``drawers`` drawers in columns of four, each an open box with a handle."""
    columns = -(-drawers // 4)
    rows = -(-drawers // columns)
    wide, high, deep = 0.5, 0.2, 0.45
    size = np.array([deep, columns * wide, rows * high])
    wall = 0.015
    low = np.array([-deep / 2, -size[1] / 2, 0.0])
    wide_all, high_all = float(size[1]), float(size[2])
    walls = [
        _box(low, (-wall, -wall, -wall), (deep, wide_all + wall, 0.0)),
        _box(low, (-wall, -wall, high_all), (deep, wide_all + wall, high_all + wall)),
        _box(low, (-wall, -wall, 0.0), (deep, 0.0, high_all)),
        _box(low, (-wall, wide_all, 0.0), (deep, wide_all + wall, high_all)),
        _box(low, (-wall, 0.0, 0.0), (0.0, wide_all, high_all)),
    ]
    parts = [Part("link_0", mesh=merged(walls))]
    gap, thin = 0.004, 0.01
    x, y, z = deep - gap, wide - 2 * gap, high - 2 * gap
    for i in range(drawers):
        at = np.add(low, (gap, (i // rows) * wide + gap, (i % rows) * high + gap))
        boxes = [
            _box(at, (0.0, 0.0, 0.0), (x, y, thin)),
            _box(at, (0.0, 0.0, 0.0), (x, thin, z)),
            _box(at, (0.0, y - thin, 0.0), (x, y, z)),
            _box(at, (0.0, 0.0, 0.0), (thin, y, z)),
            _box(at, (x - thin, 0.0, 0.0), (x, y, z)),
            _box(at, (x, y / 2 - 0.06, z / 2 - 0.008), (x + 0.03, y / 2 + 0.06, z / 2 + 0.008)),
        ]
        parts.append(Part(f"link_{i + 1}", mesh=merged(boxes), name="drawer"))
    return SegmentedObject("chest", tuple(parts), "cabinet")


def _box(at: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]) -> Mesh:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    vertices = at + np.asarray(low) + corner * np.subtract(high, low)
    return Mesh(vertices, np.array(faces, np.int32))


def grid_box(cells: int, center: Array, size: Array) -> Mesh:
    """A box whose six sides are grids of ``cells`` × ``cells`` squares."""
    line = np.linspace(-0.5, 0.5, cells + 1)
    u, v = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    grid = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    vertices, triangles = [], []
    for axis in range(3):
        for end in (-0.5, 0.5):
            side = np.empty((len(u), 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = end, u, v
            triangles.append((grid if end > 0 else grid[:, ::-1]) + sum(map(len, vertices)))
            vertices.append(center + side * size)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))


URDF = """<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="body"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="2"/><inertia ixx="1"
ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial><visual><origin xyz="0 0 0"/><geometry>
<mesh filename="a.obj" scale="1 1 1"/></geometry></visual><collision><geometry><box size="1 1 1"/>
</geometry></collision></link><link name="door"><visual><origin xyz="0.5 0 0" rpy="0 0 1"/>
<geometry><box size="0.1 1 1"/></geometry><material name="red"/></visual></link>
<link name="knob"><visual><geometry><cylinder radius="0.1" length="0.2"/></geometry></visual></link>
<joint name="hinge" type="revolute"><origin xyz="0.5 0 0" rpy="0 0 0"/><parent link="body"/>
<child link="door"/><axis xyz="0 0 1"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>
<dynamics damping="0.1" friction="0.1"/></joint><joint name="turn" type="continuous">
<origin quat_xyzw="0 0 0 1" xyz="0 0 1"/><parent link="door"/><child link="knob"/>
<axis xyz="1 0 0"/><mimic joint="hinge" multiplier="2" offset="0"/></joint></robot>"""
MJCF = """<mujoco model="m"><compiler angle="radian" meshdir="."/><default><geom rgba="1 0 0 1"/>
</default><asset><mesh name="a" file="a.obj"/><texture name="t" type="2d" file="texture.png"/>
<material name="x" texture="t" rgba="1 1 1 1"/><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/>
</asset><worldbody><body name="body"><geom type="mesh" mesh="a" material="x"/>
<frame pos="0 0 1" euler="0 0 1"><body name="door"><joint name="hinge" axis="0 0 1" range="0 1"/>
<geom type="box" size="1 1 1" mass="2"/><body name="b"><joint name="s" type="slide" range="0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 1" size="0.1"/></body></body></frame></body>
<replicate count="2" offset="1 0 0"><body><geom size="1"/></body></replicate></worldbody>
<equality><joint joint1="s" joint2="hinge" polycoef="0 1"/></equality></mujoco>"""
SDF = """<sdf version="1.9"><world name="w"><frame name="f"><pose>1 0 0 0 0 0</pose></frame>
<include name="c"><uri>a/a.obj</uri><pose relative_to="f" degrees="true">0 0 0 0 0 90</pose>
<static>true</static><scale>1.0</scale></include><model name="box"><static>1</static>
<pose>0 0 0 0 0 0</pose><link name="l"><pose>0 0 1 0 0 0</pose><collision name="c"><geometry><box>
<size>1 1 1</size></box></geometry></collision></link></model></world></sdf>"""
USDA = """#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 0.01
)
def Xform "World" {
    def Xform "box" (kind = "component") {
        double3 xformOp:translate = (1, 2, 3)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Mesh "m" {
            point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
            int[] faceVertexCounts = [3, 3, 3, 3]
            int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
            color3f[] primvars:displayColor = [(1, 0, 0)]
        }
    }
    def Cylinder "c" {
        double radius = 2
        double height = 3
    }
}
"""
STL = (
    "solid a\n"
    + "".join(
        f"facet normal 0 0 1\nouter loop\nvertex {i} 0 0\nvertex {i} 1 0\nvertex {i} 0 1\nendloop\n"
        "endfacet\n"
        for i in range(4)
    )
    + "endsolid a\n"
)
_PLACE = {"x": 1.0, "y": 0.5, "z": 2.0}
SCENES: dict[str, object] = {
    "own.json": {"artiworld_scene": 1, "name": "w", "objects": [{
        "id": "c", "description": "cabinet", "asset": "a", "position": [1, 2, 0.5],
        "scale": [1, 1, 1], "quaternion_wxyz": [1, 0, 0, 0], "anchor": "center"}]},
    "holodeck.json": {"proceduralParameters": {}, "rooms": [{"id": "r", "roomType": "kitchen"}],
        "walls": [], "objects": [{"assetId": "a", "id": "c-0 (kitchen)", "kinematic": True,
        "roomId": "r", "position": _PLACE, "rotation": {"x": 0, "y": 40.0, "z": 0}}]},
    "mesatask.json": {"item_placement_zone": [0, 1, 0, 1], "objects": [{"instance": "c_1",
        "retrieved_uid": "a", "position": [1, 2, 0.5], "rotation": [0, 0, 0, 1],
        "size": [0.6, 0.5, 0.8], "scale_factor": [1, 1, 1]}]},
    "layout.json": [{"id": 7, "category": "cabinet", "model_uid": "set/a",
        "bbox": [1, 2, 0.5, 0.62, 0.5, 0.8, 0, 0, 0.7]}],
    "physcene.json": {"ThreedFront": {"a": [{"path": "3D-FUTURE-model/a/raw_model.obj",
        "scale": 1.0, "size": [0.62, 0.8, 0.5], "label": "Cabinet", "query_label": "cabinet",
        "query_size": [0.31, 0.4, 0.25], "theta": 0.7, "position": [1, 0.5, -2],
        "centroid": [0, 0, 0]}]}, "GPN": {}},
}  # fmt: skip
OPTISCENE = (
    'Place [{"object": "cabinet", "bounding box": [{"h": 0.8, "w": 0.62, "d": 0.5}]}].\n'
    '[Design] It stands.\n{"room type": "kitchen", "objects": [{"object": "cabinet", '
    '"asset": "a", "rotate": [{"angle": 0.7}], "coordinates": [{"x": 1, "y": 2, "z": 0.1}]}]}\n'
    "Done."
)


@dataclass(frozen=True)
class FaultSample:
    """One valid source.

    Attributes:
        name: of its format.
        files: name → content; each may be damaged.
        main: the file that is opened.
        is_scene: whether it is read as a scene.
    """

    name: str
    files: dict[str, bytes]
    main: str
    is_scene: bool = False


def fault_samples() -> list[FaultSample]:
    """The samples, without those whose packages aren't installed."""
    with tempfile.TemporaryDirectory(prefix="artiworld-faults-") as folder:
        return [*_meshes(Path(folder)), *_clouds(Path(folder)), *_models(Path(folder)), *_scenes()]


def _textured() -> Mesh:
    plain = grid_box(2, np.zeros(3), np.ones(3))
    pixels = np.random.default_rng(0).integers(0, 255, (8, 8, 3), np.uint8)
    skin = Material("skin", (255, 255, 255, 255), Image.fromarray(pixels))
    uv = np.asarray(plain.vertices[:, :2], np.float32)
    return Mesh(plain.vertices, plain.faces, np.zeros(len(plain.faces), np.int32), (skin,), uv)


def _written(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def _meshes(root: Path) -> Iterator[FaultSample]:
    for suffix in ("obj", "glb", "ply", "stl"):
        folder = root / suffix
        folder.mkdir()
        write_mesh(_textured(), folder / f"a.{suffix}")
        yield FaultSample(suffix, _written(folder), f"a.{suffix}")
    glb = _written(root / "glb")["a.glb"]
    size = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + size])
    tree["buffers"][0]["uri"] = "b.bin"
    beside = {"a.gltf": json.dumps(tree).encode(), "b.bin": glb[28 + size :]}
    yield FaultSample("gltf", beside, "a.gltf")
    yield FaultSample("gltf scene", beside, "a.gltf", is_scene=True)
    yield FaultSample("stl text", {"a.stl": STL.encode()}, "a.stl")
    obj = _written(root / "obj")
    for name, packing in (("zip", zipfile.ZIP_DEFLATED), ("zip bzip2", zipfile.ZIP_BZIP2)):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", packing) as archive:
            for file, data in obj.items():
                archive.writestr(zipfile.ZipInfo(f"a/{file}"), data, packing)
        yield FaultSample(name, {"a.zip": out.getvalue()}, "a.zip")
    if find_spec("collada") is not None:
        import trimesh

        made = trimesh.Trimesh(_textured().vertices, _textured().faces, process=False)
        made.export(root / "a.dae")
        yield FaultSample("dae", {"a.dae": (root / "a.dae").read_bytes()}, "a.dae")


def _clouds(root: Path) -> Iterator[FaultSample]:
    rng = np.random.default_rng(1)
    points = rng.random((40, 3)).astype(np.float32)
    colors = rng.integers(0, 255, (40, 3), np.uint8)
    write_cloud(PointCloud(points, colors=colors), root / "cloud.ply")
    yield FaultSample("ply cloud", {"a.ply": (root / "cloud.ply").read_bytes()}, "a.ply")
    rows = "\n".join(
        " ".join(f"{v:.4g}" for v in (*p, *c)) for p, c in zip(points, colors, strict=True)
    )
    head = "ply\nformat ascii 1.0\nelement vertex 40\n"
    head += "".join(f"property float {c}\n" for c in "xyz")
    head += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    yield FaultSample(
        "ply text", {"a.ply": f"{head}{rows}\n3 0 1 2\n4 0 1 2 3\n".encode()}, "a.ply"
    )
    yield FaultSample("xyz", {"a.xyz": rows.encode()}, "a.xyz")
    pose = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    body = "\n".join(" ".join(f"{v:.4g}" for v in (*p, 0.5)) for p in points)
    yield FaultSample("ptx", {"a.ptx": f"40\n1\n{pose}{body}\n".encode()}, "a.ptx")
    table = "x;y;z;r;g;b\n" + rows.replace(" ", ";").replace(".", ",")
    yield FaultSample("csv", {"a.csv": table.encode()}, "a.csv")
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 40\nHEIGHT 1\nPOINTS 40\nDATA {}\n"
    text = "\n".join(" ".join(map(str, p)) for p in points)
    for style, body in (("ascii", text.encode()), ("binary", points.tobytes())):
        yield FaultSample(f"pcd {style}", {"a.pcd": head.format(style).encode() + body}, "a.pcd")
    out = io.BytesIO()
    np.savez_compressed(out, points=points, colors=colors, confidence=points[:, 0])
    yield FaultSample("npz", {"a.npz": out.getvalue()}, "a.npz")
    if find_spec("laspy") is not None:
        import laspy

        las = laspy.create(point_format=3)
        las.x, las.y, las.z = points.T.astype(np.float64)
        for name in ("a.las", "a.laz"):
            las.write(str(root / name))
            yield FaultSample(name[2:], {name: (root / name).read_bytes()}, name)
    if find_spec("pye57") is not None:
        import pye57

        file = pye57.E57(str(root / "a.e57"), mode="w")
        x, y, z = points.T.astype(np.float64)
        file.write_scan_raw({"cartesianX": x, "cartesianY": y, "cartesianZ": z})
        file.close()
        yield FaultSample("e57", {"a.e57": (root / "a.e57").read_bytes()}, "a.e57")


def _models(root: Path) -> Iterator[FaultSample]:
    beside = _written(root / "obj")
    picture = next(data for name, data in beside.items() if name.endswith(".png"))
    yield FaultSample("urdf", {**beside, "a.urdf": URDF.encode()}, "a.urdf")
    if find_spec("mujoco") is not None:
        files = {**beside, "texture.png": picture, "a.xml": MJCF.encode()}
        yield FaultSample("mjcf", files, "a.xml")
    if find_spec("pxr") is not None:
        layer: Any = import_module("pxr.Sdf").Layer.CreateAnonymous(".usda")
        layer.ImportFromString(USDA)
        layer.Export(str(root / "a.usdc"))
        binary = {"a.usdc": (root / "a.usdc").read_bytes()}
        for name, files in (("usda", {"a.usda": USDA.encode()}), ("usdc", binary)):
            yield FaultSample(name, files, f"a.{name}")
            yield FaultSample(f"{name} scene", files, f"a.{name}", is_scene=True)


def _scenes() -> Iterator[FaultSample]:
    for name, content in SCENES.items():
        yield FaultSample(
            f"scene {name}", {name: json.dumps(content).encode()}, name, is_scene=True
        )
    yield FaultSample("scene sdf", {"a.sdf": SDF.encode()}, "a.sdf", is_scene=True)
    yield FaultSample("scene optiscene", {"a.txt": OPTISCENE.encode()}, "a.txt", is_scene=True)


TOKENS = (*b'-1 0 1e12 99999999999999999999 nan 1e400 null true [] {} ""'.split(), b"/", b"\n")
TOKENS += (b"\0", b"\xff\xfe", *b'" < > &lt; ../ \xf0\x9f\x9a\xaa'.split())


def damaged(data: bytes, rng: random.Random) -> bytes:
    """``data`` with one to three damages."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if not out:
            break
        at, size = rng.randrange(len(out)), rng.randint(1, 64)
        match rng.randrange(7):
            case 0:
                del out[at:]
            case 1:
                for _ in range(rng.randint(1, 8)):
                    out[rng.randrange(len(out))] = rng.randrange(256)
            case 2:
                out[min(at, rng.randint(0, 400))] = rng.randrange(256)
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = rng.choice(TOKENS) * rng.choice((1, 1, 1, 1000))
            case 5:
                out[at:at] = out[at : at + size]
            case _:
                _replace_word(out, rng)
    return bytes(out)


def _replace_word(out: bytearray, rng: random.Random) -> None:
    """Put a token or another word of the file in the place of a number or name."""
    words = [m.span() for m in re.finditer(rb"[\w.+-]+", bytes(out[: 1 << 16]))]
    if words:
        start, end = rng.choice(words)
        first, last = rng.choice(words)
        out[start:end] = rng.choice((rng.choice(TOKENS), bytes(out[first:last])))
