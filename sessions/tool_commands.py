"""Commands of tools, and about the source; see :mod:`sessions.commands`.

Several kinds of edits in one step, elements that are left out or cut out of a scan, and the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from model.core.asset import UpAxis
from model.core.errors import CommandError
from model.segmentation.prompts import BASE, Click
from sessions.checks import (
    NAME_LIMIT,
    PATH_LIMIT,
    check_count,
    check_part,
    check_pose,
    check_ref,
    check_unit_scale,
    clean_field,
    name_field,
)
from sessions.document import (
    CropRecord,
    Document,
    FaceCut,
    LeftOut,
    ObjectFrame,
    PartInfo,
    Placement,
    Position,
    RegionRef,
    as_record,
)
from sessions.part_commands import add_prompt, with_part, with_prompts, without_part
from sessions.state import Command, Context, JobResult

UP_AXES: tuple[UpAxis, ...] = get_args(UpAxis)


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
        name_field(self, "name", "the part's name")
        if self.like is not None:
            check_part(self.like)


@dataclass(frozen=True)
class ApplyTool(Command, kind="apply_tool"):
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
        clean_field(self, "tool", NAME_LIMIT, "tool")
        check_count(self.replaces, "replaces")
        for part in self.delete:
            check_part(part)
            if part == BASE:
                raise CommandError("part 0 is the base and can't be deleted")

    def describe(self) -> str:
        parts = sorted({r.part for r in self.regions})
        whose = "" if not parts else f", part {parts[0]}"
        return self.tool + (whose if len(parts) < 2 else f", {len(parts)} parts")

    def edit(self, document: Document, context: Context) -> Document:
        have = len(document.prompts)
        if self.replaces > have:
            raise CommandError(
                f"{self.tool} replaces {self.replaces} prompts, but there are {have}"
            )
        before = document
        if self.replaces:
            document = replace(document, prompts=document.prompts[: -self.replaces])
        for part in self.delete:
            if document.part(part) is not None:
                document = without_part(document, part, context)
        for r in self.regions:
            if document.part(r.part) is None:
                document = with_part(document, PartInfo(r.part, r.name, r.like))
            region = RegionRef(r.part, r.elements, r.positive, r.count, self.tool)
            document = add_prompt(document, region)
        return before if document is before else with_prompts(document, document.prompts)


@dataclass(frozen=True)
class CutFaces(Command, kind="cut_faces", words="{tool} through faces"):
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
        clean_field(self, "tool", NAME_LIMIT, "tool")

    def edit(self, document: Document, context: Context) -> Document:
        bare = replace(document, prompts=(), face_cuts=(*document.face_cuts, self.cut))
        return ApplyTool(self.tool, self.regions).edit(bare, context)


@dataclass(frozen=True)
class SetFrame(Command, kind="set_frame", words="read with {up_axis} up, scale {unit_scale:g}"):
    """Set the up axis and metres per unit of the source. Restarts the annotation.

    Earlier versions gave it; now :class:`Prepare` says more.
    """

    up_axis: UpAxis
    unit_scale: float

    def __post_init__(self) -> None:
        if self.up_axis not in UP_AXES:
            raise CommandError(f"up_axis must be one of {', '.join(UP_AXES)}, got {self.up_axis!r}")
        check_unit_scale(self.unit_scale, "unit_scale")

    def edit(self, document: Document, context: Context) -> Document:
        read = self.up_axis, self.unit_scale
        if (document.up_axis, document.unit_scale) == read:
            return document
        after = replace(_afresh(document), up_axis=read[0], unit_scale=read[1])
        return replace(after, joint_edits=0)


@dataclass(frozen=True)
class LeaveOut(Command, kind="leave_out"):
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
        clean_field(self, "what", NAME_LIMIT, "what is left out")

    @property
    def record(self) -> LeftOut | None:
        """The elements that are left out then; None for none."""
        return None if self.elements is None else as_record(LeftOut, self)

    def describe(self) -> str:
        return f"leave out {self.what}" if self.elements else "leave nothing out"

    def edit(self, document: Document, context: Context) -> Document:
        if self.record == document.left_out:
            return document
        return replace(_afresh(document), left_out=self.record)


@dataclass(frozen=True)
class Prepare(Command, kind="prepare", words="{what}"):
    """Level, size and clean the source. Restarts the annotation.

    Attributes:
        unit_scale: metres per unit of the source.
        frame: the object's frame in that of the source as it is read.
        leave_out: what is left out from now on.
        what: human-readable summary of the change.
        resizes: the size alone changes: parts and joints stay, at the new size.
    """

    unit_scale: float
    frame: ObjectFrame
    leave_out: LeaveOut
    what: str
    resizes: bool = False

    def __post_init__(self) -> None:
        check_unit_scale(self.unit_scale, "unit_scale")
        clean_field(self, "what", NAME_LIMIT, "what was changed")

    def edit(self, document: Document, context: Context) -> Document:
        left_out = self.leave_out.record
        after = replace(document, unit_scale=self.unit_scale, frame=self.frame, left_out=left_out)
        if after == document:
            return document
        if self.resizes and left_out == document.left_out:
            before = document.unit_scale * document.frame.scale
            return _resized(after, document, self.unit_scale * self.frame.scale / before)
        return replace(_afresh(after), joint_edits=0)


@dataclass(frozen=True)
class CropOut(CropRecord, Command, kind="crop_out", words="cut out {name}"):
    """Record an object that was cut out of this scan."""

    def __post_init__(self) -> None:
        clean_field(self, "name", NAME_LIMIT, "the object's name")
        clean_field(self, "path", PATH_LIMIT, "the object's path")
        check_ref(self.elements, "elements")
        check_count(self.count)
        check_pose(self.position, self.wxyz)

    def edit(self, document: Document, context: Context) -> Document:
        crop = as_record(CropRecord, self)
        if crop in document.crops:
            return document
        return replace(document, crops=(*document.crops, crop))


@dataclass(frozen=True)
class Placed(Placement, JobResult, kind="placed"):
    """Record the place of this object in the scan that it was cut out of. No undo step."""

    def __post_init__(self) -> None:
        clean_field(self, "scene", PATH_LIMIT, "the scan's path")
        clean_field(self, "scene_sha256", NAME_LIMIT, "the digest")
        check_ref(self.elements, "elements")
        check_pose(self.position, self.wxyz)

    def describe(self) -> str:
        return f"placed in {self.scene.rpartition('/')[2]}"

    def edit(self, document: Document, context: Context) -> Document:
        placement = as_record(Placement, self)
        if placement == document.placement:
            return document
        return replace(document, placement=placement)


def _resized(after: Document, before: Document, ratio: float) -> Document:
    """Return ``after`` with the parts and joints of ``before``, ``ratio`` times as large."""
    grown = np.diag([ratio, ratio, ratio, 1.0])

    def place(at: Position) -> Position:
        x, y, z = (ratio * float(v) for v in at)
        return x, y, z

    cuts = tuple(
        replace(cut, planes=tuple(replace(p, point=place(p.point)) for p in cut.planes))
        for cut in before.face_cuts
    )
    prompts = tuple(
        replace(p, position=place(p.position)) if isinstance(p, Click) else p
        for p in before.prompts
    )
    after = replace(
        after,
        prompts=prompts,
        face_cuts=cuts,
        prediction=None if before.prediction is None else before.prediction.moved(grown),
        tree=None if before.tree is None else before.tree.moved(grown),
    )
    segmentation = before.segmentation
    if segmentation is not None and before.segmentation_current:
        after = replace(after, segmentation=replace(segmentation, prompts_key=after.key))
    return after


def _afresh(document: Document) -> Document:
    """Return it without all that refers to elements, whose numbers changed."""
    return replace(
        document,
        prompts=(),
        face_cuts=(),
        segmentation=None,
        prediction=None,
        prediction_for=None,
        tree=None,
        locked=frozenset(),
    )
