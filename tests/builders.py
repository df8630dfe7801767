"""Small objects with known parts, and waiting."""

from __future__ import annotations

import io
import json
import struct
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.asset import Asset
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.simulated.primitives import block


def wait_until(condition: Callable[[], Any], what: str = "a state", seconds: float = 300.0) -> Any:
    """Poll until ``condition()`` is true and return its value; far longer than it takes."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, f"{seconds:.0f} s passed without: {what}"
        time.sleep(0.02)
    return value


@dataclass(frozen=True)
class Labelled:
    """An asset with the true label of each element."""

    asset: Asset
    labels: npt.NDArray[np.int16]


CABINET = (
    # part, low, high, colour: a body, two doors that stand 2 cm proud, and a knob on each
    (0, (0.0, 0.0, 0.0), (1.0, 0.5, 0.8), (180, 140, 100)),
    (1, (0.02, -0.02, 0.05), (0.49, 0.0, 0.75), (200, 160, 120)),
    (2, (0.51, -0.02, 0.05), (0.98, 0.0, 0.75), (200, 160, 120)),
    (1, (0.40, -0.06, 0.35), (0.44, -0.02, 0.39), (60, 60, 60)),
    (2, (0.56, -0.06, 0.35), (0.60, -0.02, 0.39), (60, 60, 60)),
)


def box(low: Any, high: Any) -> trimesh.Trimesh:
    """An axis-parallel box between two corners."""
    return trimesh.creation.box(bounds=[low, high])


def joined(*pieces: trimesh.Trimesh) -> Mesh:
    """Several bodies as one mesh."""
    whole = trimesh.util.concatenate(pieces)
    return Mesh(np.asarray(whole.vertices), np.asarray(whole.faces, np.int32))


def boxes(*spans: tuple[Any, Any]) -> Mesh:
    """One mesh of boxes between two corners each."""
    return joined(*(box(low, high) for low, high in spans))


def part(link: str, *pieces: trimesh.Trimesh, name: str | None = None) -> Part:
    """A part of several bodies."""
    return Part(link, joined(*pieces), name=name)


def linked(joints: Sequence[Joint], *parts: Part, name: str = "linked") -> ArticulatedObject:
    """An object of parts and joints; links without a part are helpers."""
    ends = (link for j in joints for link in (j.parent, j.child))
    links = dict.fromkeys([*(p.link for p in parts), *ends])
    return ArticulatedObject(name, parts, KinematicTree(tuple(links), tuple(joints)))


def two(joint: Joint, base: Part, moving: Part) -> ArticulatedObject:
    """An object of two parts, ``link_0`` and ``link_1``."""
    return linked((joint,), base, moving, name="two")


def slide(name: str, child: str, upper: float, way: float = 1.0, **more: Any) -> Joint:
    """A joint of ``link_0`` or ``base`` that slides along x from 0 to ``upper``."""
    parent = more.pop("parent", "link_0")
    return Joint(name, "prismatic", parent, child, (way, 0, 0), lower=0, upper=upper, **more)


def read_glb(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON of a GLB and its binary chunk."""
    assert data[:4] == b"glTF" and int.from_bytes(data[8:12], "little") == len(data)
    end = 20 + int.from_bytes(data[12:16], "little")
    return json.loads(data[20:end]), data[end + 8 :]


def write_glb(path: Path, tree: dict[str, Any], binary: bytes = b"") -> Path:
    """A GLB of a JSON and a binary chunk, which is left out where it's empty."""
    text = json.dumps({"asset": {"version": "2.0"}, **tree}).encode()
    text += b" " * (-len(text) % 4)
    if binary:
        binary = struct.pack("<I4s", len(binary), b"BIN\0") + binary
    size = 20 + len(text) + len(binary)
    head = struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
    path.write_bytes(head + text + binary)
    return path


def ply_head(count: int, *fields: str, faces: int = 0, more: str = "", style: str = "ascii") -> str:
    """A PLY's header: the number of vertices and their fields as "type name name …" (x, y and z
    by themselves), that of triangles or polygons and what they have more."""

    def properties(groups: Sequence[str]) -> list[str]:
        split = (group.split() for group in groups)
        return [f"property {kind} {name}" for kind, *names in split for name in names]

    rows = ["ply", f"format {style} 1.0", "comment made elsewhere", f"element vertex {count}"]
    rows += properties(fields or ("float x y z",))
    if faces:
        rows += [f"element face {faces}", "property list uchar int vertex_indices"]
        rows += properties([more] if more else [])
    return "\n".join([*rows, "end_header", ""])


def mesh_of(triangles: npt.NDArray) -> Mesh:
    """(N, 3, 3) triangles as a mesh; none share a vertex."""
    faces = np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)
    return Mesh(triangles.reshape(-1, 3), faces)


def blocks(*spans: tuple[Any, Any]) -> tuple[Mesh, npt.NDArray]:
    """One mesh of boxes between two corners each, and the number of the box of each face."""
    made = [block(low, high) for low, high in spans]
    return mesh_of(np.concatenate(made)), np.repeat(np.arange(len(made)), [len(b) for b in made])


CUPBOARD_DOOR = Joint(
    "door", "revolute", "link_0", "link_1", (0, 0, -1), (-0.3, -0.003, 0.2), lower=0, upper=1.5
)
"""The true joint of :func:`write_cupboard`; about (0, 0, 1) the door swings into the shelf."""


def write_cupboard(folder: Path) -> Path:
    """A folder of two parts: a carcass with a shelf, and a door before it."""
    folder.mkdir()
    w = 0.02
    boards = [
        box([-0.3, 0, 0], [0.3, 0.3, w]),
        box([-0.3, 0, 0.4 - w], [0.3, 0.3, 0.4]),
        box([-0.3, 0, 0], [-0.3 + w, 0.3, 0.4]),
        box([0.3 - w, 0, 0], [0.3, 0.3, 0.4]),
        box([-0.3, 0.3 - w, 0], [0.3, 0.3, 0.4]),
        box([-0.3, 0.005, 0.2], [0.3, 0.3, 0.2 + w]),
    ]
    trimesh.util.concatenate(boards).export(folder / "link_0.ply")
    box([-0.3, -w - 0.003, 0], [0.3, -0.003, 0.4]).export(folder / "link_1.ply")
    return folder


def subdivide(triangles: npt.NDArray, times: int) -> npt.NDArray:
    """Each triangle into four, ``times`` times."""
    for _ in range(times):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return triangles


def cabinet_mesh(times: int = 3) -> Labelled:
    """The cabinet as one mesh without any part information."""
    triangles = [subdivide(block(low, high), times) for _, low, high, _ in CABINET]
    labels = np.repeat([p for p, *_ in CABINET], [len(t) for t in triangles]).astype(np.int16)
    return Labelled(Asset("cabinet", mesh=mesh_of(np.concatenate(triangles))), labels)


def cabinet_cloud(count: int = 20_000, seed: int = 0, noise: float = 0.0) -> Labelled:
    """The cabinet's outside sampled as a coloured cloud."""
    rng = np.random.default_rng(seed)
    points, labels, colors = [], [], []
    triangles = np.concatenate([block(low, high) for _, low, high, _ in CABINET])
    part = np.repeat(np.arange(len(CABINET)), 12)
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    chosen = rng.choice(len(triangles), 2 * count, p=area / area.sum())
    u, v = rng.random((2, len(chosen), 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    t = triangles[chosen]
    points = t[:, 0] + u * (t[:, 1] - t[:, 0]) + v * (t[:, 2] - t[:, 0])
    hidden = np.zeros(len(points), bool)
    for _, low, high, _ in CABINET:
        hidden |= ((points > np.array(low) + 1e-6) & (points < np.array(high) - 1e-6)).all(1)
    # The doors' backs and the body behind them touch: nobody can scan them.
    hidden |= (
        (np.abs(points[:, 1]) < 1e-6)
        & ((points[:, 2] > 0.05) & (points[:, 2] < 0.75))
        & (np.abs(points[:, 0] - 0.255) < 0.235)
    )
    hidden |= (
        (np.abs(points[:, 1]) < 1e-6)
        & ((points[:, 2] > 0.05) & (points[:, 2] < 0.75))
        & (np.abs(points[:, 0] - 0.745) < 0.235)
    )
    keep = np.nonzero(~hidden)[0][:count]
    labels = np.array([p for p, *_ in CABINET], np.int16)[part[chosen[keep]]]
    colors = np.array([c for *_, c in CABINET], np.uint8)[part[chosen[keep]]]
    points = points[keep] + rng.normal(0, noise, (len(keep), 3))
    return Labelled(Asset("cabinet", cloud=PointCloud(points, colors=colors)), labels)


def zip_of_objects(count: int, seed: int = 0) -> bytes:
    """A zip of so many meshes, each with a file beside it."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(count):
            archive.writestr(f"p{i}.obj", f"v 0 0 {seed}\nv 1 0 {i}\nv 0 1 0\nf 1 2 3\n" * 50)
            archive.writestr(f"maps/p{i}.mtl", "newmtl a\n")
    return out.getvalue()
