"""USD stages: prims of kind ``component`` are objects, else the prims below what holds everything.

Units (``metersPerUnit``) and the up axis come from the stage. Meshes and the primitive shapes are
read, with the colour that is shown or that a preview surface has; textures are not. Two to twelve
shapes on one object are its parts. What is invisible or a guide (collision shapes) is passed over.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import affine
from model.io.formats.loaded import Loaded
from model.io.formats.usd import SHAPES, USD_SUFFIXES, UsdStage, sound_stage
from model.scenes.readers.lisdf import readable
from model.scenes.scene import Scene, SceneFrame, SceneObject, SceneProblem
from model.scenes.unpacking import Unpacked, Unpacker, placed_frame
from model.scenes.values import MAX_OBJECTS, Place, collect, maybe_text

_MAX_DEPTH = 256


class UsdStageReader:
    """``.usd``, ``.usda``, ``.usdc`` and ``.usdz``."""

    name = "usd"
    description = "USD stages"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        return path.suffix.lower() in USD_SUFFIXES

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        with sound_stage(path):
            stage = _Stage(path)
            entries = [((str(p.GetPath()),), p) for p in stage.objects()]
            make = partial(_object, stage)
            objects, problems = collect(entries, make, lambda p: str(p.GetName()))
            problems += tuple(
                SceneProblem(str(p.GetPath()), f"prims of type {p.GetTypeName()} are not read")
                for p in stage.prims() if stage.is_unread(p)
            )  # fmt: skip
        frame = SceneFrame(stage.up, stage.unit)
        return Scene(path.stem, path, self.name, objects, problems, frame)

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.embedded.GeometryReader`."""
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
        shapes = [p for p in self.prims() if p.GetTypeName() in ("Mesh", *SHAPES)]
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
        walk = iter(self.usd.PrimRange(self.stage.GetPseudoRoot()))
        for prim in walk:
            if prim.GetPath() in solid and self.usd.ModelAPI(prim).GetKind() == "component":
                found.append(prim)
                walk.PruneChildren()
        return found or self._below_wrappers(solid)

    def _below_wrappers(self, solid: set[Any]) -> list[Any]:
        level = [self.stage.GetPseudoRoot()]
        for _ in range(_MAX_DEPTH):
            if len(level) != 1 or level[0].GetTypeName() in ("Mesh", *SHAPES):
                break
            below = [c for c in level[0].GetFilteredChildren(self.usd.PrimIsDefined)
                     if c.GetPath() in solid]  # fmt: skip
            lone = len(below) == 1 and below[0].GetTypeName() in ("Mesh", *SHAPES)
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
            into = self.turn.copy()
            into[:3, :3] *= self.unit
            out: list[tuple[str | None, Loaded]] = []
            for shape in self.prims(prim):
                kind = shape.GetTypeName()
                if kind == "Mesh" or kind in SHAPES:
                    made = self.mesh_of(shape) if kind == "Mesh" else self.primitive_of(shape, kind)
                    same = shape == prim
                    move = start if same else back @ self.world(shape)
                    out.append((str(shape.GetName()), made.moved(move @ into)))
            return out

        return pieces


def _object(stage: _Stage, place: Place, prim: Any) -> SceneObject:
    world = stage.world(prim)
    pose, scale, _ = placed_frame(world)
    name = str(prim.GetName())
    data = prim.GetCustomData()
    extra = data if isinstance(data, dict) else {}
    category = maybe_text(extra.get("category")) or _semantic(prim)
    return SceneObject(
        id=name,
        description=maybe_text(extra.get("description")) or readable(name),
        world_from_object=pose,
        scale=scale,
        asset=f"{stage.path.name}#{prim.GetPath()}",
        category=category,
        place=place,
    )


def _semantic(prim: Any) -> str | None:
    """Isaac's label of a prim."""
    for attribute in prim.GetAttributes():
        name = attribute.GetName()
        if name.startswith("semantic:") and name.endswith("semanticData"):
            return maybe_text(attribute.Get())
    return None
