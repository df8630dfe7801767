"""The :class:`Scene`: objects and where they stand, whatever file they came from.

Here are the protocols of its readers and of finders of articulable objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np
import numpy.typing as npt

from model.core.errors import ArtiworldError

FloatArray = npt.NDArray[np.float64]
Anchor = Literal["origin", "center", "base"]
Base = Literal["fixed", "free"]
ANCHORS: tuple[Anchor, ...] = get_args(Anchor)
BASES: tuple[Base, ...] = get_args(Base)
FARTHEST = 1e5
"""Metres from the origin: beyond, single precision can't tell a hinge from its neighbour."""


class SceneObjectError(ArtiworldError):
    """An object of a scene that can't be used; the rest of the scene goes on without it."""


@dataclass(frozen=True)
class SceneFrame:
    """Coordinate frame of the file; everything in a :class:`Scene` is metres, right-handed, +z up.

    Attributes:
        up_axis: of the file.
        unit_scale: metres per unit of the file.
        left_handed: as Unity has it.
    """

    up_axis: Literal["y", "z"] = "z"
    unit_scale: float = 1.0
    left_handed: bool = False


@dataclass(frozen=True)
class SceneProblem:
    """Something in the file that was not taken as it is.

    Attributes:
        object: id of the object, or its place in the file where it has none.
        reason: what is wrong and what would be right.
        skipped: whether the object was left out.
    """

    object: str
    reason: str
    skipped: bool = True

    @property
    def text(self) -> str:
        """The reason, and first of all whether the object was left out."""
        return f"left out: {self.reason}" if self.skipped else self.reason


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One rigid object in a scene.

    A vertex v of the asset (metres, +z up, as :func:`model.io.open_asset.open_asset` gives it)
    stands at ``world_from_object @ (scale * (v - anchor point))``.

    Attributes:
        id: unique within the scene.
        description: human-readable.
        category: what it is, where the file tells it, or None.
        world_from_object: (4, 4) rigid pose, metres, world +z up.
        scale: (3,) factors on the asset's axes, its own frame; the first one is negative where the
            object is mirrored, all others are positive (:func:`upright`).
        asset: id of the asset in the file's own words, or None.
        room: where it is, or None.
        anchor: which point of the asset sits at the pose: its ``origin``, its bounding box'
            ``center``, or the middle of that box' bottom (``base``); a scan's box is without its
            stray points.
        fit: (3,) metres that the asset's box is stretched to before ``scale``, or None.
        static: whether the file says that it stands still; None where it says nothing.
        box: (3,) full sizes in metres of an object that is a plain box without an asset, or None.
        place: where the object is in the file, for writing back.
        obstacle: whether it stops what moves into it; the leftovers of a scan don't.
        base: whether its base may move, where the scene says so; None as its kind demands. What
            was scanned stays where it was.
        solid: whether it has collision shapes in the written scene.
    """

    id: str
    description: str
    world_from_object: FloatArray
    scale: FloatArray
    asset: str | None = None
    category: str | None = None
    room: str | None = None
    anchor: Anchor = "origin"
    fit: tuple[float, float, float] | None = None
    static: bool | None = None
    box: tuple[float, float, float] | None = None
    place: tuple[str | int, ...] = ()
    obstacle: bool = True
    base: Base | None = None
    solid: bool = True

    def __post_init__(self) -> None:
        pose = _array(self.world_from_object, (4, 4), "world_from_object")
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-6 or (
            np.linalg.det(pose[:3, :3]) < 0
        ):
            raise SceneObjectError("its rotation is none (a rigid rotation is needed)")
        if np.abs(pose[:3, 3]).max() > FARTHEST:
            raise SceneObjectError(
                f"it stands at {pose[:3, 3].tolist()} m; {FARTHEST:.0f} m from the origin at most"
            )
        scale = _array(self.scale, (3,), "scale")
        if not scale[0] or (scale[1:] <= 0).any():
            raise SceneObjectError(f"scale {scale.tolist()} must be three numbers other than 0")
        for name in ("fit", "box"):
            size = getattr(self, name)
            if size is not None and (_array(size, (3,), name) <= 0).any():
                raise SceneObjectError(f"size {list(size)} must be three positive numbers")
        object.__setattr__(self, "world_from_object", pose)
        object.__setattr__(self, "scale", scale)

    def placed(self, bounds: npt.ArrayLike) -> Placement:
        """Placement of an asset with the (2, 3) ``bounds`` (metres, its own frame)."""
        low, high = np.asarray(bounds, np.float64)
        factor = self.scale.copy()
        if self.fit is not None:
            extent = high - low
            # A sheet without thickness can't be stretched along it.
            factor *= np.where(extent > 1e-9, np.asarray(self.fit) / np.maximum(extent, 1e-9), 1.0)
        point = {
            "origin": np.zeros(3),
            "center": (low + high) / 2,
            "base": np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]),
        }[self.anchor]
        world = self.world_from_object.copy()
        world[:3, 3] -= world[:3, :3] @ (factor * point)
        return Placement(world, factor)


@dataclass(frozen=True, eq=False)
class Placement:
    """Vertex v of the asset stands at ``world_from_asset @ (scale * v)``.

    Attributes:
        world_from_asset: (4, 4) rigid, metres.
        scale: (3,) factors on the asset's own axes; the first one is negative of a mirrored object.
    """

    world_from_asset: FloatArray
    scale: FloatArray


def upright(turn: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same (3, 3) rotation and (3,) scale with at most the first factor negative.

    Two mirrors are half a turn, and one or three are a mirror along x and a turn: so the asset
    itself stays the right way up, which predictors count on, and is mirrored in one way only.
    """
    first = np.array([np.sign(scale).prod(), 1.0, 1.0])
    return turn @ np.diag(np.sign(scale) * first), np.abs(scale) * first


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene as it was read.

    Attributes:
        name: short display name.
        path: the file.
        reader: name of who read it.
        objects: ids are unique.
        problems: human-readable remarks on content left out or changed.
        frame: the file's coordinate frame, for writing back.
    """

    name: str
    path: Path
    reader: str
    objects: tuple[SceneObject, ...]
    problems: tuple[SceneProblem, ...] = ()
    frame: SceneFrame = SceneFrame()


def _array(value: Any, shape: tuple[int, ...], what: str) -> FloatArray:
    out = np.array(value, dtype=np.float64)
    if out.shape != shape or not np.isfinite(out).all():
        raise SceneObjectError(f"{what} must be {'x'.join(map(str, shape))} finite numbers")
    out.flags.writeable = False
    return out


@runtime_checkable
class SceneReader(Protocol):
    """One kind of scene file."""

    name: str
    description: str

    def recognises(self, path: Path, head: bytes) -> bool:
        """True if the file is of this kind, by its name and its first 64 KiB."""
        ...

    def read(self, path: Path) -> Scene:
        """Read it; a broken object is reported in ``problems`` and left out, the rest goes on.

        Raises:
            InputFileError: where the file as a whole is no scene of this kind.
        """
        ...


@dataclass(frozen=True)
class ObjectDescription:
    """A finder's input for one object.

    Attributes:
        description: human-readable.
        category: or None.
        size: (x, y, z) metres, or None where nobody knows.
    """

    description: str
    category: str | None = None
    size: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Decision:
    """Decision whether an object can be articulated.

    Attributes:
        articulable: yes or no.
        parts: kinds of moving parts to expect.
        reason: human-readable.
        kind: recognised kind of object, or None.
        base: whether its base belongs to the world (``fixed``) or is free to move; None where
            nobody knows.
        confidence: 0..1.
    """

    articulable: bool
    parts: tuple[str, ...] = ()
    reason: str = ""
    kind: str | None = None
    base: str | None = None
    confidence: float = 1.0


@runtime_checkable
class ArticulableFinder(Protocol):
    """Says which objects can be articulated, into which parts, and why ("a language model decides
    which objects can be articulated", ArtiWorld, pipeline step 1)."""

    name: str

    def find(self, objects: Sequence[ObjectDescription]) -> list[Decision]:
        """One decision an object, in their order."""
        ...
