"""USD meshes and primitive shapes with their looks, read through usd-core.

Units (``metersPerUnit``) and the up axis come from the stage. Of a preview surface the colour and
its texture are kept, of other looks the colour that is shown. What is invisible or a guide is
passed over.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from trimesh import creation

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.packages import require
from model.core.textures import MOST_BYTES, TextureError, decode, left_out, to_srgb
from model.geometry.topology import same_points
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_count,
    check_indices,
    join,
    size_of,
    triangulate,
)
from model.io.robot_xml import counted

FloatArray = npt.NDArray[np.float64]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SHAPES = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone")
OPEN_SECONDS = 30.0
"""For starting pxr, on a busy machine, and a small stage."""
_BYTES_A_SECOND = 5e6  # a tenth of what it opens
_INPUTS = "diffuseColor opacity metallic roughness normal emissiveColor occlusion".split()
WORLD_FROM_UP = {
    "y": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
    "z": np.eye(4),
}
_SCHEMAS = ("PhysxJoint", "PhysxMimicJoint", "NewtonMimic", "Semantics")
"""Applied schemas that usd-core doesn't know and a reader does, without ``API`` behind."""
_STATED = re.compile(r"holeIndices|(physics|drive|limit|state|physx\w*|newton|mjc):")
_READ = re.compile(
    r"physics:(rigidBodyEnabled|collisionEnabled|jointEnabled|excludeFromArticulation|axis|mass|"
    r"(lower|upper)Limit|coneAngle[01]Limit|local(Pos|Rot)[01]|centerOfMass|diagonalInertia|"
    r"principalAxes|approximation|gravity\w+)|drive:\w+:physics:(damping|maxForce|type)|"
    r"physxJoint:(jointFriction|maxJointVelocity)|newton:mimic(Coef[01]|Enabled)|"
    r"physxMimicJoint:\w+:(gearing|offset|referenceJointAxis)"
)
"""Attributes of physics that a reader knows."""


def _said(error: Exception) -> str:
    """The last line of what pxr says, which fails to be text where the file is none."""
    try:
        return str(error).strip().splitlines()[-1][:200]
    except UnicodeDecodeError:
        return "it holds bytes that are no text"


@contextmanager
def sound_stage(path: Path) -> Iterator[None]:
    """Say in words what a stage that may hold anything anywhere makes pxr and numpy fail at."""
    try:
        yield
    except (RuntimeError, ValueError, TypeError, OverflowError, IndexError, KeyError) as error:
        what = f"the stage inside is inconsistent ({type(error).__name__}: {_said(error)})"
        raise InputFileError(path, what, "export it again") from None


def read_usd(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """The visible geometry of a stage, metres, +z up; pieces are named after their bodies.

    Raises:
        InputFileError: where it is no stage, too large, or has no mesh.
        ConfigurationError: where usd-core isn't installed.
    """
    with sound_stage(path):
        return _read(UsdStage(path, max_bytes))


def _check_binary(path: Path) -> None:
    """Open a binary stage in another process first: a damaged one may crash pxr, or hold it for
    ever.

    Raises:
        InputFileError: where it does.
    """
    with path.open("rb") as file:
        head = file.read(8)
    if not head.startswith((b"PXR-USDC", b"PK")):
        return
    code = "import sys; from pxr import Usd; Usd.Stage.Open(sys.argv[1])"
    seconds = OPEN_SECONDS + path.stat().st_size / _BYTES_A_SECOND
    command = [sys.executable, "-c", code, str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        what = f"can't be opened within {seconds:.0f} s"
        raise InputFileError(path, what, "it is damaged; export it again") from None
    if done.returncode < 0:  # errors are told by who opens it here
        raise InputFileError(path, "crashes pxr", "it is damaged; export it again")


def _read(stage: UsdStage) -> Loaded:
    found: list[Loaded] = []
    named: list[tuple[Any, int]] = []
    for prim in stage.prims():
        made = stage.shape_of(prim)
        if made is None:
            continue
        found.append(made.moved(stage.world(prim) @ stage.into))
        held, count = stage.body_of(prim) or prim, len(made.faces)
        if named and named[-1][0] == held:
            count += named.pop()[1]
        named.append((held, count))
    if not found:
        raise InputFileError(stage.path, "there is no mesh on its stage", "export its objects")
    whole = join(found)
    pieces = tuple((str(held.GetName()), count) for held, count in named if count)
    remarks = stage.unread(stage.prims(), joints=True)
    return replace(whole, pieces=pieces, warnings=(*whole.warnings, *remarks))


class UsdStage:
    """An open stage with pxr's modules; geometry comes out in metres, +z up."""

    def __init__(self, path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self._usd, self._geom, self._physics, self._shade, self._ar, tf = (
            require(f"pxr.{n}", "artiworld[usd]", "USD")
            for n in ("Usd", "UsdGeom", "UsdPhysics", "UsdShade", "Ar", "Tf")
        )
        size_of(path, max_bytes)
        _check_binary(path)
        try:
            self.stage: Any = self._usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            what = f"is no USD stage: {_said(error)}"
            raise InputFileError(path, what, "export it again") from None
        self.path = path
        self.up: Any = str(self._geom.GetStageUpAxis(self.stage)).lower()
        self.unit = float(self._geom.GetStageMetersPerUnit(self.stage))
        if self.up not in ("y", "z") or not (0 < self.unit < 1e6):
            raise InputFileError(
                path, f"has up axis {self.up!r} and {self.unit} metres a unit", "y or z up, above 0"
            )
        check_count(path, nodes=self._count(self.stage.GetPseudoRoot(), {}))
        self.turn = WORLD_FROM_UP[self.up]
        self.into = self.turn @ np.diag([self.unit, self.unit, self.unit, 1.0])
        self._places = self._geom.XformCache()
        self._remarks: dict[str, None] = {}
        self._made: dict[Any, tuple[Material, str]] = {}
        self._repeated = 0  # corners and points in instances

    def _count(self, root: Any, known: dict[Any, int]) -> int:
        """Prims at and below one, with those in instances, which are counted and not opened."""
        path = root.GetPath()
        if path not in known:
            known[path], walk = 0, iter(self._usd.PrimRange(root))
            for prim in walk:
                inside = self._count(prim.GetPrototype(), known) if prim.IsInstance() else 0
                known[path] += 1 + inside
                if prim.IsA(self._geom.PointInstancer):
                    walk.PruneChildren()
        return known[path]

    def get(self, prim: Any, name: str) -> Any:
        """An attribute's value, or the default of its schema; None without either."""
        return prim.GetAttribute(name).Get()

    def walk(self, below: Any = None) -> Iterator[tuple[Any, bool]]:
        """Each prim, with instances opened, and True where it can be seen."""
        every = self._usd.TraverseInstanceProxies(self._usd.PrimDefaultPredicate)
        root = self.stage.GetPseudoRoot() if below is None else below
        walk = iter(self._usd.PrimRange(root, every))
        for prim in walk:
            if prim.IsA(self._geom.PointInstancer):
                walk.PruneChildren()
            image = self._geom.Imageable(prim)
            shown = not image or image.ComputeVisibility() != "invisible"
            yield prim, shown and not (image and image.ComputePurpose() in ("guide", "proxy"))

    def prims(self, below: Any = None) -> Iterator[Any]:
        """Visible prims, with instances opened."""
        return (prim for prim, seen in self.walk(below) if seen)

    def is_body(self, prim: Any) -> bool:
        """True if it moves as one body: it has the schema, which isn't switched off."""
        has = prim.HasAPI(self._physics.RigidBodyAPI) and not prim.IsA(self._physics.Joint)
        return has and self.get(prim, "physics:rigidBodyEnabled") is not False

    def body_of(self, prim: Any) -> Any | None:
        """The body that holds a prim: itself, or the nearest above."""
        while prim and not self.is_body(prim):
            prim = prim.GetParent()
        return prim or None

    def is_unread(self, prim: Any) -> bool:
        """True if a prim draws something that isn't read: copies, curves, points, skeletons."""
        if prim.GetTypeName() in ("Mesh", *SHAPES):
            return False
        copies = prim.IsA(self._geom.PointInstancer) or prim.GetTypeName() == "SkelRoot"
        return copies or prim.IsA(self._geom.Gprim)

    def unread(self, prims: Iterable[Any], *, joints: bool = False) -> list[str]:
        """Remarks on shapes, schemas and values that no reader knows, joints where asked, missing
        files, looks."""
        found = Counter[str]()
        for prim in prims:
            known = bool(prim.GetPrimTypeInfo().GetSchemaTypeName()) or not prim.GetTypeName()
            joint = joints and prim.IsA(self._physics.Joint)
            found[str(prim.GetTypeName())] += not known or joint or self.is_unread(prim)
            found.update(self._unknown(prim))
        lost = (re.search(r"asset @(.+?)@", str(e)) for e in self.stage.GetCompositionErrors())
        missing = dict.fromkeys(os.path.relpath(m[1], self.path.parent) for m in lost if m)
        out = [f"missing: {name!r} and what it holds" for name in missing]
        return [*out, *counted(found), *self._remarks]

    def _unknown(self, prim: Any) -> Iterator[str]:
        """Schemas and values of a prim that no reader knows; values of unknown schemas go with
        them."""
        theirs: set[str] = set()
        for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
            plain = str(name).partition(":")[0]
            registered = self._usd.SchemaRegistry().FindAppliedAPIPrimDefinition(plain)
            if registered is None and plain.removesuffix("API") not in _SCHEMAS:
                theirs.add(plain.removesuffix("API").lower())
                yield f"schema {plain}"
        for attribute in prim.GetAuthoredAttributes():
            name = str(attribute.GetName())
            if attribute.ValueMightBeTimeVarying():
                yield "animation"
            stated = _STATED.match(name) and name.partition(":")[0].lower() not in theirs
            if not stated or _READ.fullmatch(name):
                continue
            value = attribute.Get()
            usual = prim.GetPrimDefinition().GetAttributeFallbackValue(name)
            if str(value) != str(usual) and (len(value) if np.ndim(value) else bool(value)):
                yield name

    def world(self, prim: Any) -> FloatArray:
        """(4, 4) world_from_prim in metres, +z up, of points in metres, +z up."""
        out = np.asarray(self._places.GetLocalToWorldTransform(prim), np.float64).T
        out[:3, 3] *= self.unit
        return self.turn @ out @ self.turn.T

    def shape_of(self, prim: Any) -> Loaded | None:
        """A mesh or a primitive shape in its own frame and unit; None for any other prim."""
        kind = str(prim.GetTypeName())
        if kind not in ("Mesh", *SHAPES):
            return None
        made = self._mesh(prim) if kind == "Mesh" else self._primitive(prim, kind)
        if prim.IsInstanceProxy():
            self._repeated += made.faces.size + len(made.vertices)
            check_count(self.path, values=self._repeated)
        return made

    def _mesh(self, prim: Any) -> Loaded:
        mesh = self._geom.Mesh(prim)
        points = np.asarray(mesh.GetPointsAttr().Get() or np.zeros((0, 3)), np.float64)
        sizes = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or (), np.int64)
        vertices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or (), np.int64)
        if points.ndim != 2 or not len(points) or (sizes < 0).any() or sizes.sum() != len(vertices):
            raise InputFileError(
                self.path, f"{prim.GetPath()}: its faces and points don't fit together"
            )
        check_indices(self.path, vertices, len(points), sizes=sizes)
        corners, polygons = triangulate(self.path, vertices, sizes, points)
        if mesh.GetOrientationAttr().Get() == "leftHanded":
            corners = corners[:, ::-1]
        return self._dressed(prim, points, vertices[corners], corners, polygons)

    def _primitive(self, prim: Any, kind: str) -> Loaded:
        if kind == "Cube":
            shape = creation.box(extents=[float(self.get(prim, "size"))] * 3)
        elif kind == "Sphere":
            shape = creation.icosphere(subdivisions=3, radius=float(self.get(prim, "radius")))
        else:
            radius, height = (float(self.get(prim, name)) for name in ("radius", "height"))
            shape = getattr(creation, kind.lower())(radius=radius, height=height)
            if kind != "Cylinder":  # trimesh's stand on, or begin at, the origin
                shape.apply_translation(-shape.bounds.mean(0))
        axis = "Z" if kind in ("Cube", "Sphere") else str(self.get(prim, "axis"))
        turned = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[axis]
        points, faces = np.asarray(shape.vertices, np.float64)[:, turned], np.asarray(shape.faces)
        return self._dressed(prim, points, faces, faces, np.zeros(len(faces), np.int64))

    # Looks

    def _dressed(
        self, prim: Any, points: FloatArray, faces: Any, corners: Any, polygons: Any
    ) -> Loaded:
        """(T, 3) triangles of points, corners and (T,) ``polygons`` of the file with their looks;
        vertices are doubled along seams."""
        at = {"constant": 0 * faces, "uniform": np.tile(polygons[:, None], 3), "vertex": faces}
        at |= {"varying": faces, "faceVarying": corners}
        looks, which = [self._look(prim)], np.zeros(len(faces), np.int32)
        bind = self._shade.MaterialBindingAPI(prim).GetMaterialBindSubsets
        for subset in bind() if prim.IsA(self._geom.Mesh) else ():
            which[np.isin(polygons, np.asarray(subset.GetIndicesAttr().Get() or ()))] = len(looks)
            looks.append(self._look(subset.GetPrim()))
        base = np.array([look.base_color for look, _ in looks], np.uint8)[which]
        shown = next((name for _, name in looks if name == "displayColor"), "")
        linear = self._primvar(prim, shown, 3, at) if shown else None
        colors = None
        if linear is not None:
            alpha = self._primvar(prim, "displayOpacity", 1, at)
            alpha = np.ones((*faces.shape, 1)) if alpha is None else alpha
            colors = to_srgb(np.concatenate([linear, alpha], axis=2).reshape(-1, 4))
            own = np.array([name == shown for _, name in looks])[which]
            colors = np.where(own[:, None, None], colors.reshape(-1, 3, 4), base[:, None])
        named = next((name for look, name in looks if look.texture is not None), "")
        uv = self._primvar(prim, named, 2, at) if named else None
        for i, (look, name) in enumerate(looks):
            if look.texture is not None and (uv is None or name != named):
                looks[i] = replace(look, texture=None), name
                said = f"coordinates {name!r} of a texture are missing, or a second set"
                self._remarks[f"{prim.GetPath()}: {said}"] = None
        values = [v.reshape(-1, v.shape[2]) for v in (uv, colors) if v is not None]
        if values:
            flat = faces.reshape(-1)
            first, inverse = same_points(np.column_stack([flat, *values]))
            points, faces = points[flat[first]], inverse.reshape(-1, 3)
            values = [v[first] for v in values]
        return Loaded(
            points,
            faces,
            colors=None if colors is None else values[-1],
            uv=None if uv is None else values[0].astype(np.float32),
            face_material=which,
            materials=tuple(look for look, _ in looks),
        )

    def _primvar(self, prim: Any, name: str, width: int, at: Any) -> Any | None:
        """(T, 3, width) at the corners; None where there is none, or it doesn't fit: remarked."""
        primvar = self._geom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
        said = primvar.ComputeFlattened() if primvar else None
        if said is None or not len(said):
            return None
        values, kind = np.asarray(said, np.float64), str(primvar.GetInterpolation())
        values = values.reshape(len(values), -1)
        if kind == "constant" and len(values) > 1:  # by their number, where nothing is said
            most = {int(at[k].max(initial=0)) + 1: k for k in ("faceVarying", "uniform", "vertex")}
            kind = most.get(len(values), kind)
        if kind not in at or at[kind].max(initial=0) >= len(values) or values.shape[1] < width:
            self._remarks[f"{prim.GetPath()}: its primvar {name!r} doesn't fit: left out"] = None
            return None
        return values[at[kind]][..., :width]

    def _look(self, prim: Any) -> tuple[Material, str]:
        """The material that is bound to a prim, and the primvar of its texture's coordinates;
        "displayColor" where the mesh has its colour."""
        bound = self._shade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        surface = bound.ComputeSurfaceSource()[0].GetPrim() if bound else None
        shown = self._geom.Gprim(prim).GetDisplayColorAttr().Get()
        if not surface and shown is not None and len(shown) == 1:
            opacity = self._geom.Gprim(prim).GetDisplayOpacityAttr().Get() or (1.0,)
            r, g, b, a = to_srgb(np.array([[*shown[0], opacity[0]]]))[0].tolist()
            return Material(str(prim.GetName()), (r, g, b, a)), ""
        if not surface:
            if bound:
                self._remarks[f"material {str(bound.GetPrim().GetName())!r}: not read"] = None
            return Material(str(prim.GetName())), "displayColor"
        if bound.GetPath() in self._made:
            return self._made[bound.GetPath()]
        name, texture, shown = str(bound.GetPrim().GetName()), None, "displayColor"
        said = {key: self._value(surface, key) for key in _INPUTS}
        color, opacity = said["diffuseColor"], said["opacity"]
        maps = [k for k, v in said.items() if self._value(v, "file") is not None and v != color]
        if maps:
            self._remarks[left_out(f"{k} map" for k in maps)] = None
        if isinstance(color, self._usd.Prim):
            file, st = self._value(color, "file"), self._value(color, "varname")
            if file is not None:
                texture, st = self._picture(file), self._value(color, "st")
                if (before := self._value(st, "in")) is not None:
                    self._remarks[f"material {name!r}: what moves its texture isn't read"] = None
                    st = before
                st = self._value(st, "varname") or "st"
            if texture is not None and opacity != color and texture.mode != "RGB":
                texture = texture.convert("RGB")
            if st is None or (texture is None and st != shown):
                self._remarks[f"material {name!r}: the node of its colour isn't read"] = None
                texture, st = None, shown
            shown, color = st, None if texture is None else self._value(color, "scale") or (1,) * 3
        share = [
            float(v) if isinstance(v, int | float) and 0 <= v <= 1 else None
            for v in (said[key] for key in _INPUTS[1:4])
        ]
        one = np.array([[*(color or (0.58,) * 3)[:3], 1.0 if share[0] is None else share[0]]])
        r, g, b, a = to_srgb(one)[0].tolist()
        made = Material(name, (r, g, b, a), texture, share[1], share[2])
        shown = shown if color is None or texture is not None else ""
        self._made[bound.GetPath()] = made, shown
        return made, shown

    def _value(self, node: Any, name: str) -> Any:
        """The value of a node's input, wherever it comes from, or the node that gives it."""
        slot = self._shade.Shader(node).GetInput(name) if isinstance(node, self._usd.Prim) else None
        for attribute in self._shade.Utils.GetValueProducingAttributes(slot) if slot else ():
            output = self._shade.Output.IsOutput(attribute)
            return attribute.GetPrim() if output else attribute.Get()
        return None

    def _picture(self, said: Any) -> Any | None:
        """An image of the stage's folder, or of a package there; None, with a remark, where it
        lies elsewhere or can't be read."""
        at, name = said.resolvedPath or said.path, Path(said.path).name
        try:
            outer = Path(self._ar.SplitPackageRelativePathOuter(at)[0]).resolve()
            inside = outer.is_relative_to(self.path.parent.resolve()) and outer.is_file()
            found = inside and self._ar.GetResolver().OpenAsset(self._ar.ResolvedPath(at))
            if not found or found.GetSize() > MOST_BYTES:
                raise TextureError(f"{said.path!r} can't be read in the stage's folder")
            return decode(bytes(found.GetBuffer()), f"texture {name}")
        except TextureError as error:
            self._remarks[f"texture not used: {error}"] = None
            return None
