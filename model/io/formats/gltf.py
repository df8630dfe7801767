"""glTF 2.0: GLB files, and GLTF files with their buffers and images."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.textures import left_out, to_srgb
from model.io.formats.gltf_data import (
    Array,
    GltfBuffers,
    GltfMaterials,
    Json,
    as_dict,
    extension,
)
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_count,
    check_indices,
    join,
    read_bytes,
    with_plain_colors,
)

_UNREADABLE = {
    "KHR_draco_mesh_compression": "Draco compression",
    "EXT_meshopt_compression": "meshopt compression",
}
_READ = {
    *"EXT_mesh_gpu_instancing KHR_mesh_quantization KHR_texture_transform".split(),
    *"KHR_lights_punctual KHR_xmp KHR_xmp_json_ld KHR_animation_pointer".split(),
    *"EXT_texture_webp".split(),
}
"""Extensions that are read, or that change no shape."""
_LOOKS = "KHR_materials_"
"""Begins the names of extensions that change no shape."""


def read_gltf(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read the default scene of a GLB or GLTF file, node transforms applied.

    Raises:
        InputFileError: where it is not glTF 2.0, cut off, or names files outside its folder.
    """
    gltf = open_gltf(path, max_bytes)
    with consistent(path):
        return gltf.scene()


def open_gltf(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Gltf:
    """The tree of a GLB or GLTF file; meshes are read when they are asked for.

    Raises:
        InputFileError: where it is not glTF 2.0 or cut off.
    """
    data = read_bytes(path, max_bytes)
    tree, binary = _glb(path, data) if data[:4] == b"glTF" else (_json(path, data), None)
    version = str(as_dict(tree.get("asset")).get("version", ""))
    if not version.startswith("2"):
        why = f"is glTF version {version or 'unknown'!r}"
        raise InputFileError(path, why, "glTF 2.0 is read; export it again")
    needed = _listed(tree, "extensionsRequired")
    meshes = (_listed(as_dict(mesh), "primitives") for mesh in _listed(tree, "meshes"))
    holding = (*_listed(tree, "bufferViews"), *(p for primitives in meshes for p in primitives))
    used = (name for each in holding for name in as_dict(as_dict(each).get("extensions")))
    for name in [*needed, *(name for name in used if name in _UNREADABLE)]:
        if isinstance(name, str) and name in _UNREADABLE:
            what = f"uses {_UNREADABLE[name]} ({name})"
            raise InputFileError(path, what, "export it without compression")
        if not _is_read(name):
            what = f"needs the extension {name!r}, which is not read"
            raise InputFileError(path, what, "export it without")
    return Gltf(path, tree, binary, max_bytes)


def _listed(tree: Json, key: str) -> list[Any]:
    """The list in an entry; empty for anything else."""
    value = tree.get(key)
    return value if isinstance(value, list) else []


def _is_read(extension: Any) -> bool:
    return str(extension) in _READ or str(extension).startswith(_LOOKS)


@contextmanager
def consistent(path: Path) -> Iterator[None]:
    """Say in words what a tree that may hold anything anywhere makes fail."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"the glTF inside is inconsistent ({type(error).__name__}: {error})"
        raise InputFileError(path, what, "export it again") from None


def _glb(path: Path, data: bytes) -> tuple[Json, bytes]:
    length = int.from_bytes(data[8:12], "little")
    if len(data) < 20 or length > len(data):
        what = f"is {len(data)} bytes long instead of {length}"
        raise InputFileError(path, what, "the file is cut off; download or export it again")
    at, tree, binary = 12, None, b""
    while at + 8 <= length:
        size = int.from_bytes(data[at : at + 4], "little")
        kind = data[at + 4 : at + 8]
        if at + 8 + size > length:
            raise InputFileError(path, "a chunk is cut off", "download or export it again")
        chunk = data[at + 8 : at + 8 + size]
        if kind == b"JSON" and tree is None:
            tree = _json(path, chunk)
        elif kind == b"BIN\0" and not binary:
            binary = chunk
        at += 8 + size
    if tree is None:
        raise InputFileError(path, "has no JSON chunk", "export it again")
    return tree, binary


def _json(path: Path, data: bytes) -> Json:
    try:
        tree = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        what = "is damaged or not glTF: what it says of itself can't be read"
        raise InputFileError(path, what, "export or download it again") from None
    if not isinstance(tree, dict):
        raise InputFileError(path, "is not glTF: no object at its top")
    return tree


class Gltf:
    """An open file; a call may raise anything that :func:`consistent` puts into words."""

    def __init__(self, path: Path, tree: Json, binary: bytes | None, max_bytes: int) -> None:
        self.path, self.tree, self.binary = path, tree, binary
        self._buffers = GltfBuffers(path, tree, binary, max_bytes)
        self._materials = GltfMaterials(self._buffers)
        self._meshes: dict[tuple[int, tuple[float, ...], int | None], list[Loaded]] = {}
        self._passed_over = self._copies = 0

    def scene(self) -> Loaded:
        """All meshes of the scene in the root's frame."""
        placed = self.placed()
        pieces = [p for _, primitives in placed for p in primitives]
        if not pieces:
            raise InputFileError(self.path, "there is no mesh in its scene", "export the object")
        counts = ((name, sum(len(p.faces) for p in primitives)) for name, primitives in placed)
        named = tuple((name, count) for name, count in counts if count)
        whole = joined(pieces)
        return replace(whole, warnings=(*whole.warnings, *self.warnings), pieces=named)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about features of the meshes that were left out."""
        warnings = list(dict.fromkeys(self._materials.warnings))
        used = _listed(self.tree, "extensionsUsed")
        unread = sorted({str(e)[:60] for e in used if not _is_read(e)})
        if unread:
            warnings.append(f"ignored: extensions {', '.join(unread[:5])}")
        if animations := len(_listed(self.tree, "animations")):
            warnings.append(f"ignored: animations ({animations})")
        if self._passed_over:
            warnings.append(f"{self._passed_over} pieces of lines are left out")
        if self._materials.left:
            warnings.append(left_out(self._materials.left))
        return tuple(warnings)

    def placed(self) -> list[tuple[str, list[Loaded]]]:
        """Each node with a mesh: its name, or its mesh's, and its primitives in the root's
        frame."""
        out: list[tuple[str, list[Loaded]]] = []
        corners = visited = 0
        stack: list[tuple[int, Array, int]] = [(n, np.eye(4), 0) for n in self.roots()]
        nodes = self.tree.get("nodes") or []
        self.check_tree()
        while stack:
            index, parent, depth = stack.pop()
            node = nodes[index]
            visited += 1
            if depth > len(nodes) or visited > len(nodes):  # a root that is a child, too
                raise InputFileError(self.path, "its nodes form a cycle", "export it again")
            world = parent @ node_matrix(node)
            if "mesh" in node:
                own, places = self.meshes_of(node, world)
                size = sum(p.faces.size + len(p.vertices) for p in own)
                corners += size * len(places)
                check_count(self.path, values=corners)
                name = node.get("name") or self.tree["meshes"][node["mesh"]].get("name")
                for place in places:
                    pieces = [piece.moved(place) for piece in own]
                    out.append((name if isinstance(name, str) else "", pieces))
            stack.extend((c, world, depth + 1) for c in reversed(node.get("children") or []))
        return out

    def roots(self) -> list[int]:
        """Nodes of the default scene, the last one first."""
        scenes = self.tree.get("scenes") or []
        if scenes:
            return list(reversed(scenes[self.tree.get("scene") or 0].get("nodes") or []))
        nodes = self.tree.get("nodes") or []
        children = {c for n in nodes for c in n.get("children") or []}
        return [i for i in reversed(range(len(nodes))) if i not in children]

    def meshes_of(self, node: Json, world: Array) -> tuple[list[Loaded], list[Array]]:
        """A node's primitives, and the pose of each copy.

        The joints place the vertices of a skin, whatever the node's own transform is.

        Args:
            world: (4, 4) of the node.
        """
        own = self.mesh(node["mesh"], node.get("weights"), node.get("skin"))
        return own, [np.eye(4)] if "skin" in node else self._instances(node, world)

    def check_tree(self) -> None:
        """Refuse nodes with two parents: their content could be repeated exponentially."""
        nodes = self.tree.get("nodes") or []
        check_count(self.path, nodes=len(nodes))
        seen: set[int] = set()
        for node in nodes:
            for child in node.get("children") or ():
                if child in seen:
                    what = f"node {child} has two parents or is in a cycle"
                    raise InputFileError(self.path, what, "export it again")
                seen.add(child)

    def _instances(self, node: Json, world: Array) -> list[Array]:
        """World transforms of the copies of a node's mesh (``EXT_mesh_gpu_instancing``)."""
        copies = extension(node, "EXT_mesh_gpu_instancing")
        given = {
            key: self._buffers.accessor(index).astype(np.float64)
            for key, index in as_dict(copies.get("attributes")).items()
            if key in ("TRANSLATION", "ROTATION", "SCALE")
        }
        if not given:
            return [world]
        count = max(map(len, given.values()))
        self._copies += count
        check_count(self.path, nodes=self._copies)
        rows = {key: value.tolist() for key, value in given.items()}
        return [
            world @ node_matrix({key.lower(): value[k] for key, value in rows.items()})
            for k in range(count)
        ]

    def _joint_matrices(self, skin: int) -> Array:
        """(J, 4, 4) joint's global transform times its inverse bind matrix."""
        entry = self.tree["skins"][skin]
        joints = entry["joints"]
        world = self._global_transforms()
        bind = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in entry:
            columns = self._buffers.accessor(entry["inverseBindMatrices"], 16).astype(np.float64)
            bind = columns.reshape(-1, 4, 4).transpose(0, 2, 1)[: len(joints)]
        return np.stack([world[j] for j in joints]) @ bind

    def _global_transforms(self) -> dict[int, Array]:
        nodes = self.tree.get("nodes") or []
        self.check_tree()
        children = {c for n in nodes for c in n.get("children") or ()}
        stack = [(i, np.eye(4)) for i in range(len(nodes)) if i not in children]
        out: dict[int, Array] = {}
        while stack:
            index, parent = stack.pop()
            out[index] = parent @ node_matrix(nodes[index])
            stack.extend((c, out[index]) for c in nodes[index].get("children") or ())
        return out

    def mesh(
        self, index: int, weights: list[float] | None = None, skin: int | None = None
    ) -> list[Loaded]:
        """Its primitives in its own frame, or placed by a skin's joints.

        Args:
            weights: of its morph targets; by default the mesh's own.
            skin: whose joints move it.
        """
        key = (index, tuple(weights or ()), skin)
        if key not in self._meshes:
            own = weights or self.tree["meshes"][index].get("weights") or []
            joints = None if skin is None else self._joint_matrices(skin)
            found, corners = [], 0
            for primitive in self.tree["meshes"][index]["primitives"]:
                piece = self._primitive(primitive, own, joints)
                if piece is None:
                    continue
                found.append(piece)
                corners += piece.faces.size + len(piece.vertices)
                check_count(self.path, values=corners)
            self._meshes[key] = found
        return self._meshes[key]

    def _skinned(self, points: Array, attributes: Json, joints: Array) -> Array:
        """Vertices moved by the weighted joints (glTF 2.0, section 3.7.3.3)."""
        total = np.zeros((len(points), 4, 4))
        for k in range(8):
            if f"JOINTS_{k}" not in attributes:
                break
            index = self._buffers.accessor(attributes[f"JOINTS_{k}"], 4).astype(np.int64)
            weight = self._buffers.accessor(attributes[f"WEIGHTS_{k}"], 4).astype(np.float64)
            total += np.einsum("nk,nkij->nij", weight, joints[index])
        bare = total[:, 3, 3] < 1e-6  # no joint holds them
        total[bare] = np.eye(4)
        return np.einsum("nij,nj->ni", total[:, :3, :3], points) + total[:, :3, 3]

    def _primitive(
        self, primitive: Json, weights: list[float], joints: Array | None
    ) -> Loaded | None:
        mode = primitive.get("mode", 4)
        attributes = primitive["attributes"]
        if "POSITION" not in attributes or mode in (1, 2, 3):
            self._passed_over += 1
            return None
        points = self._buffers.accessor(attributes["POSITION"], 3).astype(np.float64)
        for weight, target in zip(weights, primitive.get("targets") or (), strict=False):
            if weight and "POSITION" in target:
                points = points + weight * self._buffers.accessor(target["POSITION"], 3)
        if joints is not None:
            points = self._skinned(points, attributes, joints)
        order = np.arange(len(points))
        if "indices" in primitive:
            order = self._buffers.accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
        faces = _faces(order, mode)
        check_indices(self.path, faces, len(points))
        colors = uv = None
        if "COLOR_0" in attributes:
            linear = self._buffers.accessor(attributes["COLOR_0"])
            colors = to_srgb(linear)
        material_index = primitive.get("material")
        material = self._materials.material(material_index)
        name = self._materials.uv_set(material_index)
        if material.pictured and name in attributes:
            st = self._buffers.accessor(attributes[name], 2).astype(np.float64)
            st = self._materials.transformed(st, material_index)
            uv = np.nan_to_num(np.column_stack([st[:, 0], 1.0 - st[:, 1]]))
        for value in (colors, uv):
            if value is not None and len(value) != len(points):
                raise InputFileError(self.path, "an attribute is shorter than its positions")
        normals = None
        if not len(faces) and "NORMAL" in attributes:
            normals = self._buffers.accessor(attributes["NORMAL"], 3)
            normals = normals if len(normals) == len(points) else None
        material_of = np.zeros(len(faces), np.int32)
        out = Loaded(points, faces, normals, colors, uv, material_of, (material,))
        return with_plain_colors(out)


def joined(pieces: list[Loaded]) -> Loaded:
    """Triangles and points of a scene; points are left out where there are triangles."""
    solid = [p for p in pieces if len(p.faces)]
    whole = join(solid or pieces)
    points = sum(len(p.vertices) for p in pieces if not len(p.faces)) if solid else 0
    remarks = [f"{points:,} points beside the triangles are left out"] * bool(points)
    return replace(whole, warnings=(*whole.warnings, *remarks))


def _faces(order: Array, mode: int) -> Array:
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if mode == 5 and len(order) >= 3:
        out = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        out[1::2] = out[1::2, ::-1]
        return out
    if mode == 6 and len(order) >= 3:
        return np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    return np.zeros((0, 3), np.int64)


def node_matrix(node: Json) -> Array:
    """(4, 4) parent_from_node, which may scale and shear."""
    if "matrix" in node:
        out = np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = node.get("rotation") or (0.0, 0.0, 0.0, 1.0)
        out = np.eye(4)
        n = x * x + y * y + z * z + w * w
        s = 2.0 / n if n > 1e-12 else 0.0
        out[:3, :3] = [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
        out[:3, :3] *= np.asarray(node.get("scale") or (1.0, 1.0, 1.0), np.float64)
        out[:3, 3] = node.get("translation") or (0.0, 0.0, 0.0)
    if not np.isfinite(out).all():
        raise ValueError("a node's transform is not finite")
    return out
