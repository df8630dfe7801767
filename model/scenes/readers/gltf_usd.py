"""glTF scenes and USD stages: files whose nodes or prims are objects.

A GLB or GLTF file is in metres, +y up, by the standard. Wrappers that hold everything are passed
through; the nodes below them are the objects, each with all that hangs on it. ``extras`` of a node
may hold ``category`` and ``description``.

In USD stages prims of kind ``component`` are objects, else the prims below what holds everything.
Units (``metersPerUnit``) and the up axis come from the stage. Meshes and the primitive shapes are
read with their looks. What is invisible or a guide (collision shapes) is passed over.

Two to twelve meshes or shapes on one object are its parts.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import affine
from model.io.formats.gltf import Gltf, consistent, joined, node_matrix, open_gltf
from model.io.formats.loaded import Loaded
from model.io.formats.usd import USD_SUFFIXES, UsdStage, sound_stage
from model.io.geometry_files import turned_up
from model.io.write import packed
from model.scenes.readers.lisdf import readable
from model.scenes.scene import (
    FloatArray,
    Scene,
    SceneFrame,
    SceneObject,
    SceneObjectError,
    SceneProblem,
)
from model.scenes.unpacking import Unpacked, Unpacker, placed_frame
from model.scenes.values import MAX_OBJECTS, Place, collect, maybe_text, shown

_UP = turned_up("y")
_MAX_NODE_DEPTH = 512


class GltfSceneReader:
    """Nodes of the default scene."""

    name = "gltf"
    description = "GLB and GLTF files whose nodes are objects"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        return path.suffix.lower() in (".glb", ".gltf")

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        gltf = open_gltf(path)
        with consistent(path):
            entries = _objects(gltf)
            make = partial(_node_object, path.name)
            objects, problems = collect(entries, make, lambda e: maybe_text(e[0].get("name")))
        return Scene(path.stem, path, self.name, objects, problems, SceneFrame("y"))

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        gltf = open_gltf(scene.path)
        made = Unpacker(folder)
        with consistent(scene.path):
            parents = {int(place[1]): parent for place, (_, parent) in _objects(gltf)}
        for obj in scene.objects:
            index = int(obj.place[1])
            # Geometry is read object by object, so that a broken one doesn't affect the others.
            made.add(obj.asset or obj.id, f"node_{index}", _pieces_of(gltf, index, parents[index]))
        return made.result()


def with_articulation(path: Path, said: dict[int, Any]) -> bytes:
    """The file's bytes with ``extras.articulation`` on nodes, geometry untouched.

    Args:
        said: node → its entries to add.
    """
    gltf = open_gltf(path)
    for index, entry in said.items():
        node = gltf.tree["nodes"][index]
        extras = node.get("extras")
        node["extras"] = {**(extras if isinstance(extras, dict) else {}), "articulation": entry}
    text = json.dumps(gltf.tree, separators=(",", ":"), ensure_ascii=False)
    return text.encode() if gltf.binary is None else packed(text, gltf.binary)


def _objects(gltf: Gltf) -> list[tuple[Place, tuple[dict[str, Any], FloatArray]]]:
    """Place, node and (4, 4) world_from_parent of each object, +y up as in the file."""
    nodes: list[dict[str, Any]] = gltf.tree.get("nodes") or []
    solid = _with_geometry(gltf, nodes)
    level = [i for i in reversed(gltf.roots()) if i in solid]
    parent = np.eye(4)
    for _ in range(_MAX_NODE_DEPTH):
        if len(level) != 1 or "mesh" in nodes[level[0]]:
            break
        below = [c for c in nodes[level[0]].get("children") or [] if c in solid]
        if len(below) < 2 and (not below or "mesh" in nodes[below[0]]):
            break  # a single object with its meshes
        parent = parent @ node_matrix(nodes[level[0]])
        level = below
    if not level:
        raise InputFileError(gltf.path, "there is no mesh in its scene", "export its objects")
    return [(("nodes", i), (nodes[i], parent)) for i in level]


def _with_geometry(gltf: Gltf, nodes: list[dict[str, Any]]) -> set[int]:
    """Nodes with a mesh on them or below."""
    gltf.check_tree()
    order: list[int] = []
    stack = list(gltf.roots())
    while stack:
        index = stack.pop()
        order.append(index)
        if len(order) > len(nodes):
            raise InputFileError(gltf.path, "its nodes form a cycle", "export it again")
        stack.extend(nodes[index].get("children") or [])
    out: set[int] = set()
    for index in reversed(order):
        node = nodes[index]
        if "mesh" in node or any(c in out for c in node.get("children") or []):
            out.add(index)
    return out


def _node_object(file: str, place: Place, entry: tuple[dict[str, Any], FloatArray]) -> SceneObject:
    node, parent = entry
    world = _UP @ (parent @ _matrix(node)) @ _UP.T
    name = maybe_text(node.get("name")) or f"node {place[1]}"
    return _object(name, world, f"{file}#{place[1]}", place, node.get("extras"))


def _object(
    name: str, world: FloatArray, asset: str, place: Place, said: Any, category: str | None = None
) -> SceneObject:
    """An object that stands at (4, 4) ``world``; ``said`` may hold its category and description."""
    pose, scale, _ = placed_frame(world)
    extra = said if isinstance(said, dict) else {}
    return SceneObject(
        id=name,
        description=maybe_text(extra.get("description")) or readable(name),
        world_from_object=pose,
        scale=scale,
        asset=asset,
        category=maybe_text(extra.get("category")) or category,
        place=place,
    )


def _matrix(node: dict[str, Any]) -> FloatArray:
    turn = node.get("rotation")
    try:
        if turn is not None and float(np.linalg.norm(np.asarray(turn, np.float64))) < 1e-9:
            raise SceneObjectError(f"its quaternion {shown(turn)} is zero; one of length 1 is due")
        return node_matrix(node)
    except (TypeError, ValueError) as error:
        raise SceneObjectError(f"its transform can't be read: {error}") from None


def _pieces_of(
    gltf: Gltf, index: int, parent: FloatArray
) -> Callable[[], list[tuple[str | None, Loaded]]]:
    def pieces() -> list[tuple[str | None, Loaded]]:
        nodes = gltf.tree["nodes"]
        _, _, rest = placed_frame(_UP @ (parent @ _matrix(nodes[index])) @ _UP.T)
        start = affine(rest @ _UP[:3, :3])
        out: list[tuple[str | None, Loaded]] = []
        stack = [(index, start)]
        while stack:
            number, world = stack.pop()
            node = nodes[number]
            if "mesh" in node:
                name = maybe_text(node.get("name"))
                own, places = gltf.meshes_of(node, world)
                if "skin" in node:  # its joints stand in the scene, not below this node
                    places = [start @ np.linalg.inv(parent @ _matrix(nodes[index]))]
                out += [(name, p.moved(at)) for at in places for p in _solid(own)]
            below = [(c, world @ node_matrix(nodes[c])) for c in node.get("children") or []]
            stack += reversed(below)
        return out

    return pieces


def _solid(primitives: list[Loaded]) -> list[Loaded]:
    """A mesh as one piece: its primitives are materials, not parts."""
    return [joined(primitives)] if primitives else []


_MAX_PRIM_DEPTH = 256


class UsdStageReader:
    """``.usd``, ``.usda``, ``.usdc`` and ``.usdz``."""

    name = "usd"
    description = "USD stages"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        return path.suffix.lower() in USD_SUFFIXES

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        with sound_stage(path):
            stage = _Stage(path)
            entries = [((str(p.GetPath()),), p) for p in stage.objects()]
            make = partial(_prim_object, stage)
            objects, problems = collect(entries, make, lambda p: str(p.GetName()))
            problems += tuple(
                SceneProblem(str(p.GetPath()), f"prims of type {p.GetTypeName()} are not read")
                for p in stage.prims()
                if stage.is_unread(p)
            )
        frame = SceneFrame(stage.up, stage.unit)
        return Scene(path.stem, path, self.name, objects, problems, frame)

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        stage = _Stage(scene.path)
        made = Unpacker(folder)
        for n, obj in enumerate(scene.objects):
            prim = stage.stage.GetPrimAtPath(obj.place[0])
            made.add(obj.asset or obj.id, f"prim_{n}", stage.pieces_of(prim))
        return made.result()


def articulation_layer(source: Path, target: Path, said: dict[str, Any]) -> None:
    """A layer over ``source`` that says in custom data what became of its prims.

    Args:
        target: file to write; it refers to ``source`` by a relative path.
        said: path of a prim → its entries to add.
    """
    import os

    usd, sdf = (import_module(f"pxr.{n}") for n in ("Usd", "Sdf"))
    layer: Any = sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths.append(Path(os.path.relpath(source, target.parent)).as_posix())
    below: Any = sdf.Layer.FindOrOpen(str(source))
    stage: Any = usd.Stage.Open(below)
    for key in ("upAxis", "metersPerUnit"):
        if stage.HasAuthoredMetadata(key):
            layer.pseudoRoot.SetInfo(key, stage.GetMetadata(key))
    if stage.HasDefaultPrim():
        layer.defaultPrim = stage.GetDefaultPrim().GetName()
    for path, entry in said.items():
        spec: Any = sdf.CreatePrimInLayer(layer, path)
        spec.specifier = sdf.SpecifierOver
        spec.customData = {"artiworld": {k: str(v) for k, v in entry.items()}}
    layer.Export(str(target))


class _Stage(UsdStage):
    """A stage with the prims that are objects."""

    def objects(self) -> list[Any]:
        """Prims that are objects."""
        shapes = [p for p in self.prims() if self.is_shape(p)]
        if not shapes:
            raise InputFileError(self.path, "there is no mesh on its stage", "export its objects")
        if len(shapes) > MAX_OBJECTS * 64:
            raise InputFileError(self.path, f"has {len(shapes)} meshes", "cut the stage")
        solid: set[Any] = set()
        for shape in shapes:
            at = shape
            while at and at.GetPath() not in solid:
                solid.add(at.GetPath())
                at = at.GetParent()
        found: list[Any] = []
        walk = iter(self._usd.PrimRange(self.stage.GetPseudoRoot()))
        for prim in walk:
            if prim.GetPath() in solid and self._usd.ModelAPI(prim).GetKind() == "component":
                found.append(prim)
                walk.PruneChildren()
        return found or self._below_wrappers(solid)

    def _below_wrappers(self, solid: set[Any]) -> list[Any]:
        level = [self.stage.GetPseudoRoot()]
        for _ in range(_MAX_PRIM_DEPTH):
            if len(level) != 1 or self.is_shape(level[0]):
                break
            below = [
                c
                for c in level[0].GetFilteredChildren(self._usd.PrimIsDefined)
                if c.GetPath() in solid
            ]
            lone = len(below) == 1 and self.is_shape(below[0])
            if not below or (lone and not level[0].IsPseudoRoot()):
                break
            level = below
        return level

    def pieces_of(self, prim: Any) -> Callable[[], list[tuple[str | None, Loaded]]]:
        """Its shapes in the frame of its asset."""

        @sound_stage(self.path)
        def pieces() -> list[tuple[str | None, Loaded]]:
            world = self.world(prim)
            _, _, rest = placed_frame(world)
            start = affine(rest)
            back = start @ np.linalg.inv(world)
            out: list[tuple[str | None, Loaded]] = []
            for shape in self.prims(prim):
                if self.is_shape(shape):
                    move = start if shape == prim else back @ self.world(shape)
                    out.append((str(shape.GetName()), self.shape_of(shape).moved(move)))
            return out

        return pieces


def _prim_object(stage: _Stage, place: Place, prim: Any) -> SceneObject:
    asset = f"{stage.path.name}#{prim.GetPath()}"
    world, said = stage.world(prim), prim.GetCustomData()
    return _object(str(prim.GetName()), world, asset, place, said, _semantic(prim))


def _semantic(prim: Any) -> str | None:
    """Isaac's label of a prim."""
    said = {str(a.GetName()): a for a in prim.GetAttributes()}
    named = (n for n in said if n.startswith("semantic:") and n.endswith("semanticData"))
    return next((maybe_text(said[n].Get()) for n in named), None)
