"""Uses of tools with their results, so that replaying needs no segmenter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.errors import CommandError
from model.core.geometry import affine, quaternion_wxyz, uniform_scale
from model.geometry.splitting import Plane
from model.segmentation.prompts import BASE
from sessions.checks import (
    NAME_LIMIT,
    PATH_LIMIT,
    check_count,
    check_part,
    check_pose,
    check_ref,
    check_unit_scale,
    clean_name,
    clean_text,
    put_field,
)


@dataclass(frozen=True)
class ToolRegion:
    """Elements that a tool adds to a part, or removes from it.

    Attributes:
        part: the part; it is added where it isn't there.
        elements: reference of the stored (K,) int64 array.
        positive: False where they don't belong to the part.
        count: K, for display.
        name: of the part, where it is new.
        like: where it is new, the part of which it is another one.
    """

    part: int
    elements: str
    positive: bool = True
    count: int = 0
    name: str | None = None
    like: int | None = None

    def __post_init__(self) -> None:
        check_part(self.part)
        check_ref(self.elements, "elements")
        check_count(self.count)
        put_field(self, "name", clean_name(self.name, "the part's name"))
        if self.like is not None:
            check_part(self.like)


@dataclass(frozen=True)
class ApplyTool:
    """The changes of one use of a tool, as one step.

    Attributes:
        tool: display name: cut, merge, split, mirror, same shape, …
        regions: gains and losses of the parts, in order.
        replaces: how many of the last prompts these regions take the place of.
        delete: parts that are gone after it.
    """

    tool: str
    regions: tuple[ToolRegion, ...]
    replaces: int = 0
    delete: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        put_field(self, "tool", clean_text(self.tool, NAME_LIMIT, "tool"))
        check_count(self.replaces, "replaces")
        for part in self.delete:
            check_part(part)
            if part == BASE:
                raise CommandError("part 0 is the base and can't be deleted")


@dataclass(frozen=True)
class FaceCut:
    """Faces that are split along planes, so that a border needs no edges.

    Attributes:
        elements: reference of the stored (K,) int64 faces, as they are numbered before this cut.
        planes: one after another on what is inside of those before; see
            :func:`model.geometry.splitting.split_faces`.
    """

    elements: str
    planes: tuple[Plane, ...]

    def __post_init__(self) -> None:
        check_ref(self.elements, "elements")
        if not self.planes:
            raise CommandError("a cut needs a plane")


@dataclass(frozen=True)
class CutFaces:
    """A cut that splits faces, which renumbers all faces.

    So regions of the present parts, by the new numbers, replace the prompts.

    Attributes:
        tool: display name: cut, rectangle.
        cut: the split faces.
        regions: what each part holds afterwards.
    """

    tool: str
    cut: FaceCut
    regions: tuple[ToolRegion, ...]

    def __post_init__(self) -> None:
        put_field(self, "tool", clean_text(self.tool, NAME_LIMIT, "tool"))


@dataclass(frozen=True)
class ObjectFrame:
    """The object's frame in that of the source: scale, then rotation, then shift.

    Attributes:
        position: (3,) metres, where the source's origin lies in the object's frame.
        wxyz: the rotation from the source's frame to the object's, a unit quaternion.
        scale: of the object against the source.
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    scale: float = 1.0

    def __post_init__(self) -> None:
        check_pose(self.position, self.wxyz)
        check_unit_scale(self.scale, "scale")

    @property
    def object_from_read(self) -> npt.NDArray[np.float64]:
        """(4, 4) from the source as it was read."""
        w, x, y, z = self.wxyz
        return affine(self.scale * Rotation.from_quat([x, y, z, w]).as_matrix(), self.position)

    def then(self, matrix: npt.NDArray[np.float64]) -> ObjectFrame:
        """The frame after a further (4, 4) rotation, uniform scale and shift of the object."""
        whole, scale = matrix @ self.object_from_read, self.scale * uniform_scale(matrix[:3, :3])
        px, py, pz = whole[:3, 3].tolist()
        return ObjectFrame((px, py, pz), quaternion_wxyz(whole / scale), scale)


SOURCE_FRAME = ObjectFrame()
"""The frame of the source itself."""


@dataclass(frozen=True)
class LeaveOut:
    """Leave out elements of the source, such as a room's floor and walls.

    This renumbers the rest, so the annotation restarts.

    Attributes:
        elements: reference of the stored (K,) int64 elements of the whole source; None: nothing is
            left out.
        count: K, for display.
        what: human-readable kind of the elements.
    """

    elements: str | None
    count: int = 0
    what: str = "floor and walls"

    def __post_init__(self) -> None:
        if self.elements is not None:
            check_ref(self.elements, "elements")
        check_count(self.count)
        put_field(self, "what", clean_text(self.what, NAME_LIMIT, "what is left out"))


@dataclass(frozen=True)
class CropOut:
    """Record an object that was cut out of this scan.

    Attributes:
        name: of the new object.
        path: its file.
        elements: reference of the stored (K,) int64 elements of the whole source.
        count: K, for display.
        position: (3,) metres, where the new object's origin lies in this scan's frame.
        wxyz: its orientation there, a unit quaternion.
    """

    name: str
    path: str
    elements: str
    count: int
    position: tuple[float, float, float]
    wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        put_field(self, "name", clean_text(self.name, NAME_LIMIT, "the object's name"))
        put_field(self, "path", clean_text(self.path, PATH_LIMIT, "the object's path"))
        check_ref(self.elements, "elements")
        check_count(self.count)
        check_pose(self.position, self.wxyz)


@dataclass(frozen=True)
class Placed:
    """Record the place of this object in the scan that it was cut out of. No undo step.

    Attributes:
        scene: path of the scan.
        scene_sha256: of the scan's file.
        elements: reference of the scan's (K,) int64 elements that it is made of.
        position, wxyz: as in :class:`CropOut`.
    """

    scene: str
    scene_sha256: str
    elements: str
    position: tuple[float, float, float]
    wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        put_field(self, "scene", clean_text(self.scene, PATH_LIMIT, "the scan's path"))
        put_field(self, "scene_sha256", clean_text(self.scene_sha256, NAME_LIMIT, "the digest"))
        check_ref(self.elements, "elements")
        check_pose(self.position, self.wxyz)
