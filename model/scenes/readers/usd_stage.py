"""USD stages: prims of kind ``component`` are objects, else the prims below what holds everything.

Units (``metersPerUnit``) and the up axis come from the stage. Meshes and the primitive shapes are
read, with the colour that is shown or that a preview surface has; textures are not. Two to twelve
shapes on one object are its parts. What is invisible or a guide (collision shapes) is passed over.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import ConfigurationError, InputFileError
from model.core.installing import install_command
from model.core.mesh import Material
from model.io.formats.loaded import Loaded, check_indices, colors_from
from model.io.formats.srgb import to_srgb
from model.io.formats.triangulate import triangulate
from model.io.geometry_files import turned_up
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
from model.scenes.values import MAX_OBJECTS, Place, collect, maybe_text

_MAX_DEPTH = 256
_SHAPES = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone")


class UsdStageReader:
    """``.usd``, ``.usda``, ``.usdc`` and ``.usdz``."""

    name = "usd"
    description = "USD stages"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        return path.suffix.lower() in (".usd", ".usda", ".usdc", ".usdz")

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.protocol.SceneReader`."""
        stage = _Stage(path)
        entries = [((str(p.GetPath()),), p) for p in stage.objects()]
        make = partial(_object, stage)
        objects, problems = collect(entries, make, lambda p: str(p.GetName()))
        problems += tuple(
            SceneProblem(str(p.GetPath()), "point instancers are not read")
            for p in stage.prims() if p.GetTypeName() == "PointInstancer"
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
        said: path of a prim → what is said of it.
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


class _Stage:
    """An open stage with pxr's modules."""

    def __init__(self, path: Path) -> None:
        if find_spec("pxr") is None:
            how = install_command("artiworld[usd]")
            raise ConfigurationError(f"USD needs the package usd-core: {how}")
        self.usd, self.geom, self.shade, tf = (
            import_module(f"pxr.{n}") for n in ("Usd", "UsdGeom", "UsdShade", "Tf")
        )
        if not path.is_file():
            raise InputFileError(path, "no such file", "check the path")
        try:
            self.stage: Any = self.usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            first = str(error).strip().splitlines()[-1][:200]
            raise InputFileError(path, f"is no USD stage: {first}", "export it again") from None
        self.path = path
        self.up: Any = str(self.geom.GetStageUpAxis(self.stage)).lower()
        self.unit = float(self.geom.GetStageMetersPerUnit(self.stage))
        if self.up not in ("y", "z") or not (0 < self.unit < 1e6):
            raise InputFileError(
                path, f"has up axis {self.up!r} and {self.unit} metres a unit", "y or z up, above 0"
            )
        self.turn = turned_up(self.up)
        self.places = self.geom.XformCache()

    def prims(self, below: Any = None) -> Iterator[Any]:
        """What can be seen, instances opened; purposes for machines left out."""
        every = self.usd.TraverseInstanceProxies(self.usd.PrimDefaultPredicate)
        root = self.stage.GetPseudoRoot() if below is None else below
        walk = iter(self.usd.PrimRange(root, every))
        for prim in walk:
            image = self.geom.Imageable(prim)
            if image and (
                image.GetVisibilityAttr().Get() == "invisible"
                or image.GetPurposeAttr().Get() in ("guide", "proxy")
            ):
                walk.PruneChildren()
                continue
            yield prim

    def objects(self) -> list[Any]:
        """Prims that are objects."""
        shapes = [p for p in self.prims() if p.GetTypeName() in ("Mesh", *_SHAPES)]
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
            if len(level) != 1 or level[0].GetTypeName() in ("Mesh", *_SHAPES):
                break
            below = [c for c in level[0].GetFilteredChildren(self.usd.PrimIsDefined)
                     if c.GetPath() in solid]  # fmt: skip
            lone = len(below) == 1 and below[0].GetTypeName() in ("Mesh", *_SHAPES)
            if not below or (lone and not level[0].IsPseudoRoot()):
                break
            level = below
        return level

    def world(self, prim: Any) -> FloatArray:
        """(4, 4) world_from_prim in metres, +z up, of points in metres, +z up."""
        out = np.asarray(self.places.GetLocalToWorldTransform(prim), np.float64).T
        out[:3, 3] *= self.unit
        return self.turn @ out @ self.turn.T

    def pieces_of(self, prim: Any) -> Callable[[], list[tuple[str | None, Loaded]]]:
        """Its shapes in the frame of its asset."""

        def pieces() -> list[tuple[str | None, Loaded]]:
            world = self.world(prim)
            _, _, rest = placed_frame(world)
            start = np.eye(4)
            start[:3, :3] = rest
            back = start @ np.linalg.inv(world)
            into = self.turn.copy()
            into[:3, :3] *= self.unit
            out: list[tuple[str | None, Loaded]] = []
            for shape in self.prims(prim):
                kind = shape.GetTypeName()
                if kind == "Mesh" or kind in _SHAPES:
                    made = self._mesh(shape) if kind == "Mesh" else self._primitive(shape, kind)
                    same = shape == prim
                    move = start if same else back @ self.world(shape)
                    out.append((str(shape.GetName()), made.moved(move @ into)))
            return out

        return pieces

    def _mesh(self, prim: Any) -> Loaded:
        mesh = self.geom.Mesh(prim)
        points = np.asarray(mesh.GetPointsAttr().Get() or np.zeros((0, 3)), np.float64)
        sizes = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or (), np.int64)
        corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or (), np.int64)
        if points.ndim != 2 or not len(points) or (sizes < 0).any() or sizes.sum() != len(corners):
            raise SceneObjectError(f"{prim.GetPath()}: its faces and points don't fit together")
        check_indices(self.path, corners[:, None], len(points))
        triangles, _ = triangulate(corners, sizes, points)
        faces = corners[triangles]
        if mesh.GetOrientationAttr().Get() == "leftHanded":
            faces = faces[:, ::-1]
        return self._coloured(prim, points, faces)

    def _primitive(self, prim: Any, kind: str) -> Loaded:
        from trimesh import creation

        made = getattr(self.geom, kind)(prim)
        if kind == "Cube":
            shape = creation.box(extents=[float(made.GetSizeAttr().Get())] * 3)
        elif kind == "Sphere":
            shape = creation.icosphere(subdivisions=3, radius=float(made.GetRadiusAttr().Get()))
        else:
            radius, height = (float(a.Get()) for a in (made.GetRadiusAttr(), made.GetHeightAttr()))
            build = {"Cylinder": creation.cylinder, "Capsule": creation.capsule,
                     "Cone": creation.cone}[kind]  # fmt: skip
            shape = build(radius=radius, height=height)
            if kind != "Cylinder":  # theirs stand on, or begin at, the origin
                shape.apply_translation(-shape.bounds.mean(0))
        points = np.asarray(shape.vertices, np.float64)
        axis = "Z" if kind in ("Cube", "Sphere") else str(made.GetAxisAttr().Get())
        points = points[:, {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[axis]]
        return self._coloured(prim, points, np.asarray(shape.faces, np.int64))

    def _coloured(self, prim: Any, points: FloatArray, faces: Any) -> Loaded:
        shown = self.geom.Gprim(prim).GetDisplayColorAttr().Get()
        linear = np.asarray(shown if shown else (), np.float64).reshape(-1, 3)
        if len(linear) == len(points) and len(points) > 1:
            return Loaded(points, faces, colors=colors_from(to_srgb(np.clip(linear, 0, 1))))
        one = self._input(prim, "diffuseColor")
        if one is None and len(linear):
            one = linear[0]
        if one is None or not np.isfinite(one).all():
            return Loaded(points, faces)
        rgb = to_srgb(np.clip(np.asarray([one], np.float64), 0, 1))[0]
        color = (int(rgb[0]), int(rgb[1]), int(rgb[2]), 255)
        metallic, roughness = self._shine(prim)
        material = Material(str(prim.GetName()), color, None, metallic, roughness)
        return Loaded(points, faces, face_material=np.zeros(len(faces), np.int32),
                      materials=(material,))  # fmt: skip

    def _shine(self, prim: Any) -> list[float | None]:
        """Metallic and roughness of the bound preview surface."""
        found = [self._input(prim, name) for name in ("metallic", "roughness")]
        return [float(v) if isinstance(v, int | float) and 0 <= v <= 1 else None for v in found]

    def _input(self, prim: Any, name: str) -> Any:
        """A plain value of the bound preview surface, or None."""
        bound, _ = self.shade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        if not bound:
            return None
        surface = bound.ComputeSurfaceSource()[0]
        slot = surface.GetInput(name) if surface else None
        return slot.Get() if slot and not slot.HasConnectedSource() else None


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
