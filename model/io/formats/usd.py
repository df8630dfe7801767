"""USD meshes and primitive shapes, read through usd-core.

Units (``metersPerUnit``) and the up axis come from the stage. The colour that is shown or that a
preview surface has is kept; textures are not. What is invisible or a guide is passed over.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
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
from model.core.textures import to_srgb
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_indices,
    colors_from,
    join,
    size_of,
    triangulate,
)

FloatArray = npt.NDArray[np.float64]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SHAPES = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone")
MOST_PRIMS = 1_000_000
OPEN_SECONDS = 30.0
"""For starting pxr, on a busy machine, and a small stage."""
_BYTES_A_SECOND = 5e6  # a tenth of what it opens
WORLD_FROM_UP = {
    "y": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
    "z": np.eye(4),
}


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
    """The visible geometry of a stage, metres, +z up.

    Raises:
        InputFileError: where it is no stage, too large, or has no mesh.
        ConfigurationError: where usd-core isn't installed.
    """
    if size_of(path) > max_bytes:
        raise InputFileError(path, "is over the limit of bytes", "thin or cut the scan first")
    with sound_stage(path):
        return _read(UsdStage(path))


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
    try:
        done = subprocess.run(
            [sys.executable, "-c", code, str(path)],
            capture_output=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        what = f"can't be opened within {seconds:.0f} s"
        raise InputFileError(path, what, "it is damaged; export it again") from None
    if done.returncode < 0:  # errors are told by who opens it here
        raise InputFileError(path, "crashes pxr", "it is damaged; export it again")


def _read(stage: UsdStage) -> Loaded:
    found: list[tuple[str, Loaded]] = []
    unread: Counter[str] = Counter()
    for prim in stage.prims():
        if stage.is_unread(prim):
            unread[str(prim.GetTypeName())] += 1
        made = stage.shape_of(prim)
        if made is not None:
            found.append((str(prim.GetName()), made.moved(stage.world(prim) @ stage.into)))
    if not found:
        raise InputFileError(stage.path, "there is no mesh on its stage", "export its objects")
    whole = join([made for _, made in found])
    named = tuple((name, len(made.faces)) for name, made in found if len(made.faces))
    remarks = [f"not read: {kind} ({n})" for kind, n in unread.items()]
    return replace(whole, pieces=named, warnings=(*whole.warnings, *remarks))


class UsdStage:
    """An open stage with pxr's modules; geometry comes out in metres, +z up."""

    def __init__(self, path: Path) -> None:
        self.usd, self.geom, self.shade, tf = (
            require(f"pxr.{n}", "artiworld[usd]", "USD")
            for n in ("Usd", "UsdGeom", "UsdShade", "Tf")
        )
        if not path.is_file():
            raise InputFileError(path, "no such file", "check the path")
        _check_binary(path)
        try:
            self.stage: Any = self.usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            what = f"is no USD stage: {_said(error)}"
            raise InputFileError(path, what, "export it again") from None
        self.path = path
        self.up: Any = str(self.geom.GetStageUpAxis(self.stage)).lower()
        self.unit = float(self.geom.GetStageMetersPerUnit(self.stage))
        if self.up not in ("y", "z") or not (0 < self.unit < 1e6):
            raise InputFileError(
                path, f"has up axis {self.up!r} and {self.unit} metres a unit", "y or z up, above 0"
            )
        self.turn = WORLD_FROM_UP[self.up]
        self.into = self.turn @ np.diag([self.unit, self.unit, self.unit, 1.0])
        self.places = self.geom.XformCache()

    def prims(self, below: Any = None) -> Iterator[Any]:
        """Visible prims, with instances opened; guides and proxies are left out."""
        for walk, prim in self.all_prims(below):
            image = self.geom.Imageable(prim)
            if image and (
                image.GetVisibilityAttr().Get() == "invisible"
                or image.GetPurposeAttr().Get() in ("guide", "proxy")
            ):
                walk.PruneChildren()
                continue
            yield prim

    def all_prims(self, below: Any = None) -> Iterator[tuple[Any, Any]]:
        """Each prim, with instances opened, and the walk, which may leave out its children."""
        every = self.usd.TraverseInstanceProxies(self.usd.PrimDefaultPredicate)
        root = self.stage.GetPseudoRoot() if below is None else below
        walk = iter(self.usd.PrimRange(root, every))
        for number, prim in enumerate(walk):
            if number > MOST_PRIMS:  # instances of instances multiply
                what = f"has more than {MOST_PRIMS:,} prims"
                raise InputFileError(self.path, what, "cut the stage")
            yield walk, prim

    def is_unread(self, prim: Any) -> bool:
        """True if a prim draws something that isn't read: copies, curves, points, skeletons."""
        if prim.GetTypeName() in ("Mesh", *SHAPES):
            return False
        return (
            prim.IsA(self.geom.Gprim)
            or prim.IsA(self.geom.PointInstancer)
            or prim.GetTypeName() == "SkelRoot"
        )

    def world(self, prim: Any) -> FloatArray:
        """(4, 4) world_from_prim in metres, +z up, of points in metres, +z up."""
        out = np.asarray(self.places.GetLocalToWorldTransform(prim), np.float64).T
        out[:3, 3] *= self.unit
        return self.turn @ out @ self.turn.T

    def shape_of(self, prim: Any) -> Loaded | None:
        """A mesh or a primitive shape in its own frame and unit; None for any other prim."""
        kind = str(prim.GetTypeName())
        if kind == "Mesh":
            return self._mesh(prim)
        return self._primitive(prim, kind) if kind in SHAPES else None

    def _mesh(self, prim: Any) -> Loaded:
        mesh = self.geom.Mesh(prim)
        points = np.asarray(mesh.GetPointsAttr().Get() or np.zeros((0, 3)), np.float64)
        sizes = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or (), np.int64)
        corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or (), np.int64)
        if points.ndim != 2 or not len(points) or (sizes < 0).any() or sizes.sum() != len(corners):
            raise InputFileError(
                self.path, f"{prim.GetPath()}: its faces and points don't fit together"
            )
        check_indices(self.path, corners, len(points), sizes=sizes)
        triangles, _ = triangulate(self.path, corners, sizes, points)
        faces = corners[triangles]
        if mesh.GetOrientationAttr().Get() == "leftHanded":
            faces = faces[:, ::-1]
        return self._coloured(prim, points, faces)

    def _primitive(self, prim: Any, kind: str) -> Loaded:
        made = getattr(self.geom, kind)(prim)
        if kind == "Cube":
            shape = creation.box(extents=[float(made.GetSizeAttr().Get())] * 3)
        elif kind == "Sphere":
            shape = creation.icosphere(subdivisions=3, radius=float(made.GetRadiusAttr().Get()))
        else:
            radius, height = (float(a.Get()) for a in (made.GetRadiusAttr(), made.GetHeightAttr()))
            build = {
                "Cylinder": creation.cylinder,
                "Capsule": creation.capsule,
                "Cone": creation.cone,
            }[kind]
            shape = build(radius=radius, height=height)
            if kind != "Cylinder":  # trimesh's stand on, or begin at, the origin
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
        return Loaded(
            points, faces, face_material=np.zeros(len(faces), np.int32), materials=(material,)
        )

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
