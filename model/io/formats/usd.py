"""USD meshes and primitive shapes with their looks, read through usd-core.

Units (``metersPerUnit``) and the up axis come from the stage. Of what changes over time the
earliest values count. The colour of a material and its texture are kept: of preview surfaces, and
by their names of MDL and MaterialX. What is invisible or a guide is passed over.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh import creation

from model.core.errors import InputFileError
from model.core.geometry import Material, affine
from model.core.packages import require
from model.core.textures import MOST_BYTES, TextureError, decode, left_out, to_srgb
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    WORLD_FROM_UP,
    Loaded,
    along_seams,
    check_count,
    check_indices,
    join,
    size_of,
    triangulate,
    unpictured,
)
from model.io.robot_xml import counted

FloatArray = npt.NDArray[np.float64]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SHAPES = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone")
OPEN_SECONDS = 30.0
"""For starting pxr, on a busy machine, and a small stage."""
_BYTES_A_SECOND = 5e6  # a tenth of what it opens
_INPUTS = {
    "diffuseColor": "diffuseColor diffuse_texture base_color_texture diffuse_color_constant "
    "base_color base_color_factor diffuse_reflection_color diffuse_color glass_color",
    "opacity": "opacity geometry_opacity",
    "metallic": "metallic metallic_constant metalness base_metalness",
    "roughness": "roughness reflection_roughness_constant specular_roughness",
    "normal": "normal normalmap_texture",
    "emissiveColor": "emissiveColor",
    "occlusion": "occlusion ao_texture",
    "metallic and roughness": "ORM_texture metallic_texture reflectionroughness_texture",
}
"""Names that a surface's inputs have: those of UsdPreviewSurface, then of MDL and MaterialX."""
_FACTORS = ("diffuse_tint", "base", "base_weight")
_MOVES = {"texture_scale": [(1, 1)], "texture_translate": [(0, 0)], "texture_rotate": [0]}
"""MDL's inputs that move a texture, and what leaves it in its place."""
_COORDINATES, _MOST_MOVES = "st texcoord in", 8
_GREY = (0.58, 0.58, 0.58)
_SCHEMAS = ("PhysxJoint", "PhysxMimicJoint", "NewtonMimic", "MjcEqualityJoint", "Semantics")
"""Applied schemas that usd-core doesn't know and a reader does, without ``API`` behind."""
_STATED = re.compile(r"holeIndices|(physics|drive|limit|state|physx\w*|newton|mjc):")
_READ = re.compile(
    r"physics:(rigidBodyEnabled|collisionEnabled|jointEnabled|excludeFromArticulation|axis|mass|"
    r"density|(lower|upper)Limit|coneAngle[01]Limit|local(Pos|Rot)[01]|centerOfMass|diagonalInertia|"
    r"principalAxes|approximation|gravity\w+)|drive:\w+:physics:(damping|maxForce|type)|"
    r"physxJoint:(jointFriction|maxJointVelocity)|newton:mimic(Coef[01]|Enabled)|"
    r"physxMimicJoint:\w+:(gearing|offset|referenceJointAxis)|mjc:coef[01]|"
    r"limit:(trans|rot)[XYZ]:physics:(low|high)"
)
"""Attributes of physics that a reader knows."""
_AMOUNT = re.compile(r"physics:(mass|density)|.*:(damping|jointFriction)")
MOST = 1e12
"""Amounts are below it, and none is below 0."""
_UNREAD = {
    "subdivisionScheme": ("catmullClark", "loop"),
    "physics:approximation": ("boundingCube", "boundingSphere"),
}
"""Values of attributes that are read otherwise."""


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
    prims = list(stage.prims())
    shapes = [prim for prim in prims if stage.is_shape(prim)]
    if not shapes:
        raise InputFileError(stage.path, "there is no mesh on its stage", "export its objects")
    found = [stage.shape_of(prim).moved(stage.world(prim)) for prim in shapes]
    named: list[tuple[Any, int]] = []
    for prim, made in zip(shapes, found, strict=True):
        held, count = stage.body_of(prim) or prim, len(made.faces)
        if named and named[-1][0] == held:
            count += named.pop()[1]
        named.append((held, count))
    whole = join(found)
    pieces = tuple((str(held.GetName()), count) for held, count in named if count)
    remarks = stage.unread(prims, joints=True)
    top, paths = stage.stage.GetDefaultPrim(), [prim.GetPath() for prim in shapes]
    apart = [path for path in paths if not (top and path.HasPrefix(top.GetPath()))]
    if top and len(apart) < len(paths):
        said = f"beside the default prim {str(top.GetName())!r} stands"
        remarks += beside(said, apart, top.GetPath())
    return replace(whole, pieces=pieces, warnings=(*whole.warnings, *remarks))


def beside(said: str, paths: Iterable[Any], top: Any) -> list[str]:
    """A remark that names the prims beside ``top``, or below it, that hold ``paths``, with their
    number; nothing without paths."""
    depths = ((p, p.GetCommonPrefix(top).pathElementCount) for p in paths)
    found = Counter(str(path.GetPrefixes()[depth].name) for path, depth in depths)
    return [f"{said}: " + ", ".join(f"{name} ({n})" for name, n in found.items())] * bool(found)


class _Look(NamedTuple):
    """A material, the primvar that has its colour, that of its texture's coordinates, and scale,
    turn in degrees and shift of these, one after the other."""

    material: Material
    shown: str = ""
    st: str = "st"
    moves: Sequence[Any] = ()


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
            what = f"has up axis {self.up!r} and {self.unit} metres a unit"
            raise InputFileError(path, what, "y or z up, above 0")
        check_count(path, nodes=self._count(self.stage.GetPseudoRoot(), {}))
        self.turn = affine(WORLD_FROM_UP[self.up])
        self._time: Any = self._usd.TimeCode.EarliestTime()
        self._places = self._geom.XformCache(self._time)
        self._remarks: dict[str, None] = {}
        self._made: dict[Any, _Look | None] = {}
        self._images: dict[str, Image.Image | None] = {}
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
        """An attribute's earliest value, or the default of its schema; None without either."""
        return prim.GetAttribute(name).Get(self._time)

    def walk(self, below: Any = None) -> Iterator[tuple[Any, bool]]:
        """Each prim, with instances opened, and True where it can be seen."""
        every = self._usd.TraverseInstanceProxies(self._usd.PrimDefaultPredicate)
        root = self.stage.GetPseudoRoot() if below is None else below
        walk = iter(self._usd.PrimRange(root, every))
        for prim in walk:
            if prim.IsA(self._geom.PointInstancer):
                walk.PruneChildren()
            image = self._geom.Imageable(prim)
            shown = not image or image.ComputeVisibility(self._time) != "invisible"
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

    def is_shape(self, prim: Any) -> bool:
        """True for the primitive shapes, and for a mesh that isn't empty."""
        full = bool(self.get(prim, "points") or self.get(prim, "faceVertexCounts"))
        return prim.GetTypeName() in SHAPES or (full and prim.GetTypeName() == "Mesh")

    def is_unread(self, prim: Any) -> bool:
        """True if a prim draws something that isn't read: copies, curves, points, skeletons."""
        if self.is_shape(prim):
            return False
        copies = prim.IsA(self._geom.PointInstancer) or prim.GetTypeName() == "SkelRoot"
        return copies or prim.IsA(self._geom.Gprim)

    def unread(self, prims: Iterable[Any], *, joints: bool = False) -> list[str]:
        """Remarks on shapes, schemas and values that no reader knows, joints where asked, missing
        files, looks."""
        found, moving = Counter[str](), 0
        for prim in prims:
            known = bool(prim.GetPrimTypeInfo().GetSchemaTypeName()) or not prim.GetTypeName()
            joint = joints and prim.IsA(self._physics.Joint)
            found[str(prim.GetTypeName())] += not known or joint or self.is_unread(prim)
            found.update(self._unknown(prim))
            moving += sum(a.ValueMightBeTimeVarying() for a in prim.GetAuthoredAttributes())
        lost = (re.search(r"asset @(.+?)@", str(e)) for e in self.stage.GetCompositionErrors())
        places = dict.fromkeys(os.path.relpath(m[1], self.path.parent) for m in lost if m)
        states = {p: "not read" if (self.path.parent / p).exists() else "missing" for p in places}
        out = [f"{state}: {name!r} and what it holds" for name, state in states.items()]
        if moving:
            out.append(f"animation isn't read: of {moving} values over time the earliest count")
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
        joint, kind = prim.IsA(self._physics.Joint), prim.GetPrimDefinition()
        for attribute in prim.GetAuthoredAttributes():
            name, value = str(attribute.GetName()), attribute.Get(self._time)
            usual = kind.GetAttributeFallbackValue(name)
            if name in _UNREAD:
                unread = value in _UNREAD[name]
            elif _READ.fullmatch(name) and not (joint and "collision" in name):
                unread = _AMOUNT.fullmatch(name) and value is not None and not 0 <= value < MOST
            else:
                unread = _STATED.match(name) and name.partition(":")[0].lower() not in theirs
                some = usual is not None or (len(value) if np.ndim(value) else bool(value))
                unread = unread and some and str(value) != str(usual)
            if unread:
                yield name

    def world(self, prim: Any) -> FloatArray:
        """(4, 4) world_from_prim in metres, +z up, of points in metres, +z up."""
        out = np.asarray(self._places.GetLocalToWorldTransform(prim), np.float64).T
        out[:3, 3] *= self.unit
        return self.turn @ out @ self.turn.T

    def shape_of(self, prim: Any) -> Loaded:
        """A mesh or a primitive shape in its own frame, metres, +z up."""
        kind = str(prim.GetTypeName())
        made = self._mesh(prim) if kind == "Mesh" else self._primitive(prim, kind)
        if prim.IsInstanceProxy():
            self._repeated += made.faces.size + len(made.vertices)
            check_count(self.path, values=self._repeated)
        return made.moved(self.turn @ np.diag([*[self.unit] * 3, 1.0]))

    def _mesh(self, prim: Any) -> Loaded:
        points = np.asarray(self.get(prim, "points") or np.zeros((0, 3)), np.float64)
        sizes, vertices = (
            np.asarray(self.get(prim, f"faceVertex{name}") or (), np.int64)
            for name in ("Counts", "Indices")
        )
        if points.ndim != 2 or not len(points) or (sizes < 0).any() or sizes.sum() != len(vertices):
            raise InputFileError(
                self.path, f"{prim.GetPath()}: its faces and points don't fit together"
            )
        check_indices(self.path, vertices, len(points), sizes=sizes)
        corners, polygons = triangulate(self.path, vertices, sizes, points)
        if self.get(prim, "orientation") == "leftHanded":
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
            indices = self.get(subset.GetPrim(), "indices") or ()
            which[np.isin(polygons, np.asarray(indices))] = len(looks)
            looks.append(self._look(subset.GetPrim()))
        uv = self._uv(prim, looks, which, at)
        colors = self._colors(prim, looks, which, at)
        values = [v for v in (uv, colors) if v is not None]
        points, faces, values = along_seams(points, faces, values)
        return Loaded(
            points,
            faces,
            colors=None if colors is None else values[-1],
            uv=None if uv is None else values[0].astype(np.float32),
            face_material=which,
            materials=tuple(look.material for look in looks),
        )

    def _uv(self, prim: Any, looks: list[_Look], which: Any, at: Any) -> Any | None:
        """(T, 3, 2); textures without coordinates give way to their mean colour."""
        out = None
        for i, look in enumerate(looks):
            if look.material.texture is None:
                continue
            st = self._primvar(prim, look.st, 2, at)
            if st is None:
                looks[i] = look._replace(material=unpictured(look.material))
                said = f"coordinates {look.st!r} of a texture are missing"
                self._remarks[f"{prim.GetPath()}: {said}"] = None
                continue
            for scale, turn, shift in look.moves:
                turned = Rotation.from_euler("z", -(turn or 0.0), degrees=True).as_matrix()
                st = st * (scale or (1, 1)) @ turned[:2, :2] + (shift or (0, 0))
            out = np.where((which == i)[:, None, None], st, 0.0 if out is None else out)
        return out

    def _colors(self, prim: Any, looks: list[_Look], which: Any, at: Any) -> Any | None:
        """(T, 3, 4) sRGB colours of the mesh' own, else of the materials."""
        shown = next((look.shown for look in looks if look.shown), "")
        linear = self._primvar(prim, shown, 3, at) if shown else None
        if linear is None:
            return None
        alpha = self._primvar(prim, "displayOpacity", 1, at)
        alpha = np.ones((*which.shape, 3, 1)) if alpha is None else alpha
        colors = to_srgb(np.concatenate([linear, alpha], axis=2).reshape(-1, 4))
        own = np.array([look.shown == shown for look in looks])[which]
        base = np.array([look.material.base_color for look in looks], np.uint8)[which]
        return np.where(own[:, None, None], colors.reshape(-1, 3, 4), base[:, None])

    def _primvar(self, prim: Any, name: str, width: int, at: Any) -> Any | None:
        """(T, 3, width) at the corners; None where there is none, or it doesn't fit: remarked."""
        primvar = self._geom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
        said = primvar.ComputeFlattened(self._time) if primvar else None
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

    def _look(self, prim: Any) -> _Look:
        """The material that is bound to a prim, else the prim's own colour."""
        bind = self._shade.MaterialBindingAPI(prim).ComputeBoundMaterial
        bound = bind("preview")[0] or bind("full")[0]
        key = bound.GetPath() if bound else None
        if bound and key not in self._made:
            of, name = bound.ComputeSurfaceSource, str(bound.GetPrim().GetName())
            surface = of()[0] or of("mdl")[0] or of("mtlx")[0]
            self._made[key] = self._surface(name, surface) if surface else None
            if not surface:
                self._remarks[f"material {name!r}: not read"] = None
        if (made := self._made.get(key)) is not None:
            return made
        name, shown = str(prim.GetName()), self.get(prim, "primvars:displayColor")
        if shown is None or len(shown) != 1:
            return _Look(Material(name), "displayColor")
        opacity = self.get(prim, "primvars:displayOpacity") or (1.0,)
        return _Look(Material(name, _rgba(shown[0], opacity[0])))

    def _surface(self, name: str, shader: Any) -> _Look:
        node, shown = shader.GetPrim(), ""
        inputs = {key: self._input(node, names) for key, names in _INPUTS.items()}
        color, opacity = inputs["diffuseColor"], inputs["opacity"]
        if self._value(node, "enable_opacity"):
            opacity = self._value(node, "opacity_constant")
        if (least := self._value(node, "opacityThreshold")) and isinstance(opacity, float):
            opacity = float(opacity >= least)
        read = {"diffuseColor", "opacity" if opacity == color else ""}
        lost = [f"{k} map" for k, v in inputs.items() if k not in read and self._file(v)]
        light = inputs["emissiveColor"]
        if lost := lost + ["emission"] * bool(np.ndim(light) == 1 and np.any(light)):
            self._remarks[left_out(lost)] = None
        look, plain = _Look(Material(name)), color
        if self._file(color) is not None:
            look, plain = self._textured(look, node, color, opacity == color)
        elif np.ndim(color) != 1:
            shown, plain = str(self._input(color, "varname geomprop") or ""), None
        if plain is None and not shown:
            shown = "displayColor"
            unread = color is not None or shader.GetIdAttr().Get() != "UsdPreviewSurface"
            if unread and not self._file(color):
                self._remarks[f"material {name!r}: its colour isn't read"] = None
        rgb = np.array(_GREY if plain is None else plain[:3], np.float64)
        for tint in (self._value(node, key) for key in _FACTORS):
            if np.asarray(tint).dtype.kind == "f" and np.shape(tint) in ((), (3,)):
                rgb *= np.asarray(tint)
        shares = (opacity, inputs["metallic"], inputs["roughness"])
        known = (v if isinstance(v, int | float) and 0 <= v <= 1 else None for v in shares)
        alpha, metallic, roughness = known
        base = _rgba(rgb, 1.0 if alpha is None else alpha)
        made = replace(look.material, base_color=base, metallic=metallic, roughness=roughness)
        return look._replace(material=made, shown=shown)

    def _textured(self, look: _Look, node: Any, color: Any, alpha: bool) -> tuple[_Look, Any]:
        """With the texture of ``color``, and the colour that it is multiplied with; a texture that
        can't be used leaves its fallback, or None."""
        texture = self._picture(self._file(color))
        if texture is None:
            fallback = self._value(color, "fallback")
            return look, fallback or self._value(node, "diffuse_color_constant")
        texture = texture if alpha or texture.mode == "RGB" else texture.convert("RGB")
        material = replace(look.material, texture=texture)
        moves, at = list[Any](), self._input(color, _COORDINATES)
        for _ in range(_MOST_MOVES):
            known = isinstance(at, self._usd.Prim) and self._shade.Shader(at).GetIdAttr().Get()
            if known != "UsdTransform2d":
                break
            names = ("scale", "rotation", "translation")
            moves.insert(0, [self._value(at, name) for name in names])
            at = self._input(at, _COORDINATES)
        left = (self._value(node, key) not in (None, *usual) for key, usual in _MOVES.items())
        if any(left) or self._input(at, _COORDINATES) is not None:
            said = f"material {material.name!r}: what moves its texture isn't read"
            self._remarks[said] = None
        st = str(self._input(at, "varname geomprop") or "st")
        return _Look(material, st=st, moves=moves), self._value(color, "scale") or (1.0,) * 3

    def _value(self, node: Any, name: str) -> Any:
        """The value of a node's input, wherever it comes from, or the node that gives it."""
        slot = self._shade.Shader(node).GetInput(name) if isinstance(node, self._usd.Prim) else None
        for attribute in self._shade.Utils.GetValueProducingAttributes(slot) if slot else ():
            output = self._shade.Output.IsOutput(attribute)
            return attribute.GetPrim() if output else attribute.Get(self._time)
        return None

    def _input(self, node: Any, names: str) -> Any:
        """The first of a node's inputs that says something."""
        values = (self._value(node, name) for name in names.split())
        return next((v for v in values if v is not None and getattr(v, "path", "-")), None)

    def _file(self, value: Any) -> Any | None:
        """The image that an input or its node names."""
        value = self._value(value, "file") if isinstance(value, self._usd.Prim) else value
        return value if hasattr(value, "resolvedPath") else None

    def _picture(self, said: Any) -> Image.Image | None:
        """An image of the stage's folder, or of a package there, read once; None, with a remark,
        where it lies elsewhere or can't be read."""
        name = Path(said.path.replace("\\", "/")).name  # exporters write paths of their own machine
        at = said.resolvedPath or str(self.path.parent / name)
        if at in self._images:
            return self._images[at]
        try:
            outer = Path(self._ar.SplitPackageRelativePathOuter(at)[0]).resolve()
            inside = outer.is_relative_to(self.path.parent.resolve()) and outer.is_file()
            found = inside and self._ar.GetResolver().OpenAsset(self._ar.ResolvedPath(at))
            if not found or found.GetSize() > MOST_BYTES:
                raise TextureError(f"{said.path!r} can't be read in the stage's folder")
            self._images[at] = decode(bytes(found.GetBuffer()), f"texture {name}")
        except TextureError as error:
            self._images[at] = None
            self._remarks[f"texture not used: {error}"] = None
        return self._images[at]


def _rgba(linear: Any, alpha: float) -> tuple[int, int, int, int]:
    """sRGB in 0..255 of linear light."""
    r, g, b, a = to_srgb(np.array([[*linear, alpha]], np.float64))[0].tolist()
    return r, g, b, a
