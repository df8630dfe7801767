"""All decisions about one object at one moment. Arrays are held by reference, never loaded."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import Prediction
from model.core.asset import UpAxis
from model.core.errors import CommandError
from model.core.geometry import affine, quaternion_wxyz, uniform_scale
from model.core.joint import Joint
from model.core.tree import KinematicTree, holds_part
from model.geometry.splitting import Plane
from model.segmentation.prompts import BASE, MAX_PARTS, UNASSIGNED, Click
from sessions.checks import check_pose, check_ref, check_unit_scale
from sessions.review import CommentRecord, RejectReason, ReviewRecord

Decided = Literal["accept", "reject"]
Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
T = TypeVar("T")


def as_record(record: type[T], command: Any) -> T:
    """Return what a document keeps of a command with the same fields."""
    return record(*(getattr(command, f.name) for f in fields(record)))  # type: ignore[arg-type]


@dataclass(frozen=True)
class RegionRef:
    """A :class:`~model.segmentation.prompts.Region` whose elements are in the store.

    Attributes:
        part: the part.
        elements: reference of the stored (K,) int64 array.
        positive: whether they belong to the part.
        count: K.
        tool: box, lasso, brush, …
    """

    part: int
    elements: str
    positive: bool = True
    count: int = 0
    tool: str = "box"


@dataclass(frozen=True)
class PartInfo:
    """A declared or clicked part. Its link is ``link_<id>``.

    Attributes:
        id, name: its number and its name.
        like: the part that a tool found it to be a copy or a mirror image of, or None.
    """

    id: int
    name: str | None = None
    like: int | None = None

    @property
    def link(self) -> str:
        """Name of its link."""
        return f"link_{self.id}"


@dataclass(frozen=True)
class SegmentationRecord:
    """A segmenter's result.

    Attributes:
        prompts_key: key of its prompts.
        labels: reference of the stored (E,) int16 labels.
        segmenter: name of the segmenter.
        seconds: time it took.
        counts: label → number of elements, -1 is unassigned.
    """

    prompts_key: str
    labels: str
    segmenter: str
    seconds: float
    counts: Mapping[int, int]

    @property
    def parts(self) -> tuple[int, ...]:
        """Ids that own elements, ascending; unassigned elements go to the base."""
        own = {BASE if part == UNASSIGNED else part for part, n in self.counts.items() if n > 0}
        return tuple(sorted(own))


@dataclass(frozen=True)
class SavedRecord:
    """The folder that the asset was written to last."""

    folder: str
    by: str
    at: str


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
class LeftOut:
    """Elements of the source that are left out; see :class:`~sessions.tool_commands.LeaveOut`."""

    elements: str
    count: int
    what: str


@dataclass(frozen=True)
class CropRecord:
    """An object that was cut out of this scan.

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
    position: Position
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Placement:
    """Place of the object in the scan that it was cut out of.

    Attributes:
        scene: path of the scan.
        scene_sha256: of the scan's file.
        elements: reference of the scan's (K,) int64 elements that it is made of.
        position, wxyz: as in :class:`CropRecord`.
    """

    scene: str
    scene_sha256: str
    elements: str
    position: Position
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Picked:
    """A piece of an object of a scene that became an object of its own; the rest stays.

    Attributes:
        object: the object's id in the scene.
        id: of the new object, which no other has.
        name: display name.
        path: file of the new object.
        rest: file of the rest of the old one.
        count: elements of the new one, for display.
        position, wxyz: pose of the new file's origin in the scene; metres, a unit quaternion.
        rest_position, rest_wxyz: of the rest's.
    """

    object: str
    id: str
    name: str
    path: str
    rest: str
    count: int
    position: Position
    wxyz: Quaternion
    rest_position: Position
    rest_wxyz: Quaternion


@dataclass(frozen=True)
class DecisionRecord:
    """A decision about several objects; see :class:`~sessions.scene_commands.DecideObjects`."""

    decision: Decided
    objects: tuple[int, ...]
    above: float | None
    reason: RejectReason
    by: str
    at: str
    looked: bool = False


@dataclass(frozen=True)
class Document:
    """Everything decided about one object.

    Attributes:
        prompts: clicks and regions in the order they were given.
        parts: ascending by id; the base is always there.
        category: the object's category, or None.
        up_axis, unit_scale: how the source is read; None is the format's own up axis.
        segmentation: the last result, maybe of older prompts, or None.
        prediction: the last prediction, unedited.
        prediction_for: reference of the labels that ``tree`` was predicted for.
        tree: the kinematic tree as edited, or None.
        locked: child links whose joints are locked.
        review: the state of review.
        saved: the folder that the asset was written to last, or None.
        annotator: the last person who edited the parts or submitted the object; where it is
            rejected, it goes back there.
        edits: number of steps, without undone ones.
        joint_edits: number of them that edited the tree since the last prediction.
        label: description of the last step.
        left_out: elements of the source that are left out, or None.
        face_cuts: cuts that split the remaining faces, in order.
        crops: objects that were cut out of this scan.
        frame: the object's frame in that of the source as it is read.
        placement: place of the object in the scan that it was cut out of, or None.
        articulable: of a scene: object id → whether it is articulable, where a person decided.
        decided: of a scene: the decisions about its objects, in order.
        picked: of a scene: objects that were picked out of others, in order.
        complete: whether unscanned geometry is completed in the asset; None: it isn't.
        comments: of reviewers, in order.
    """

    prompts: tuple[Click | RegionRef, ...] = ()
    parts: tuple[PartInfo, ...] = (PartInfo(BASE),)
    category: str | None = None
    up_axis: UpAxis | None = None
    unit_scale: float = 1.0
    segmentation: SegmentationRecord | None = None
    prediction: Prediction | None = None
    prediction_for: str | None = None
    tree: KinematicTree | None = None
    locked: frozenset[str] = frozenset()
    review: ReviewRecord = field(default_factory=ReviewRecord)
    saved: SavedRecord | None = None
    annotator: str = ""
    edits: int = 0
    joint_edits: int = 0
    label: str = ""
    left_out: LeftOut | None = None
    face_cuts: tuple[FaceCut, ...] = ()
    crops: tuple[CropRecord, ...] = ()
    placement: Placement | None = None
    articulable: Mapping[str, bool] = field(default_factory=dict)
    decided: tuple[DecisionRecord, ...] = ()
    picked: tuple[Picked, ...] = ()
    frame: ObjectFrame = SOURCE_FRAME
    complete: bool | None = None
    comments: tuple[CommentRecord, ...] = ()

    @cached_property
    def key(self) -> str:
        """:func:`prompts_key` of the document."""
        return prompts_key(self)

    @property
    def segmentation_current(self) -> bool:
        """True if the labels belong to the present prompts. True without either."""
        if self.segmentation is None:
            return not self.prompts
        return self.segmentation.prompts_key == self.key

    @property
    def needs_labels(self) -> bool:
        """True if the segmenter hasn't answered the prompts."""
        return bool(self.prompts) and not self.segmentation_current

    @property
    def prediction_stale(self) -> bool:
        """True if the labels changed since the tree was predicted."""
        if self.tree is None:
            return False
        if self.segmentation is None or not self.segmentation_current:
            return True
        return self.segmentation.labels != self.prediction_for

    @property
    def next_part(self) -> int:
        """The lowest free part id."""
        used = {p.id for p in self.parts}
        return next(i for i in range(MAX_PARTS + 1) if i not in used)

    @property
    def part_names(self) -> dict[int, str]:
        """Part id → name, of the parts that have one."""
        return {p.id: p.name for p in self.parts if p.name}

    @property
    def edited_joints(self) -> tuple[str, ...]:
        """Child links whose joint differs from the predicted one."""
        if self.tree is None or self.prediction is None:
            return ()
        new = self.new_joints
        return tuple(
            j.child
            for j in self.tree.joints
            if self.prediction.joint(j.child) != j and j not in new
        )

    @property
    def new_joints(self) -> tuple[Joint, ...]:
        """Joints of parts that the prediction didn't know: fixed, until predicted or edited."""
        if self.tree is None or self.prediction is None or self.prediction.tree is None:
            return ()
        known = self.prediction.tree.links
        return tuple(
            j
            for j in self.tree.joints
            if j.child not in known and j.name.startswith("fixed_") and j.type == "fixed"
        )

    @property
    def joints_file(self) -> str | None:
        """Name of the file that the joints came from; None where they were predicted."""
        return None if self.prediction is None else self.prediction.file

    @property
    def predicted_confidence(self) -> dict[str, float]:
        """Child link → confidence, 0..1, of predicted joints that are neither edited nor locked."""
        if self.prediction is None:
            return {}
        decided = {*self.edited_joints, *self.locked}
        return {k: v for k, v in self.prediction.confidence.items() if k not in decided}

    @property
    def locked_joints(self) -> tuple[Joint, ...]:
        """The locked joints, which the next prediction keeps."""
        if self.tree is None:
            return ()
        return tuple(j for j in self.tree.joints if j.child in self.locked)

    def likely_joints(self, joint: Joint) -> tuple[Joint, ...]:
        """Joints that the prediction finds likely in place of one of the tree's, likeliest first,
        on the present parent. Empty where helper links take part: their joints belong together."""
        if self.prediction is None or not (holds_part(joint.parent) and holds_part(joint.child)):
            return ()
        return tuple(replace(j, parent=joint.parent) for j in self.prediction.likely(joint.child))

    def part(self, part: int) -> PartInfo | None:
        """Return the part with that id, or None."""
        return next((p for p in self.parts if p.id == part), None)


def prompts_key(document: Document) -> str:
    """Return a digest of the prompts and of their frame, without loading arrays.

    It differs from :meth:`model.segmentation.prompts.Prompts.key`, as it reads the regions'
    references. Recorded results hold the key, so its computation is part of the format.
    """
    digest = hashlib.sha256(repr((document.up_axis, document.unit_scale)).encode())
    if document.frame != SOURCE_FRAME:
        digest.update(repr(document.frame).encode())
    if document.left_out is not None:
        digest.update(document.left_out.elements.encode())
    if document.face_cuts:
        digest.update(repr(document.face_cuts).encode())
    for p in document.prompts:
        if isinstance(p, Click):
            position = tuple(map(float, p.position))
            digest.update(repr(("c", position, p.part, p.positive, p.element)).encode())
        else:
            digest.update(repr(("r", p.part, p.positive, p.elements)).encode())
    return digest.hexdigest()[:24]


def review_problems(document: Document) -> tuple[str, ...]:
    """Return what a person must fix before the object can be accepted.

    Stricter than :func:`acceptance_problems`: also joints predicted for other parts, and empty
    parts.
    """
    problems = acceptance_problems(document)
    if document.tree is None or document.segmentation is None:
        return problems
    if not document.segmentation_current:
        return problems
    if document.prediction_stale:
        problems = ("the parts changed since the prediction: predict again (P)",)
    full = document.segmentation.parts
    empty = [p for p in document.parts if p.id != BASE and p.id not in full]
    named = [p.partition(" ")[0] for p in problems]
    return problems + tuple(
        f"part {p.id}{f' ({p.name})' if p.name else ''} is empty: click on it, or delete it"
        for p in empty
        if p.link not in named
    )


def acceptance_problems(document: Document) -> tuple[str, ...]:
    """Return what prevents every acceptance.

    Stored sessions are replayed through it, so it must never become stricter.
    """
    if document.tree is None:
        return ("there is no kinematic tree yet; predict it first",)
    if document.segmentation is None:
        return ("there are no parts yet; click on them first",)
    if not document.segmentation_current:
        return ("the parts are still being computed; wait a moment",)
    return link_problems(document)


def link_problems(document: Document) -> tuple[str, ...]:
    """Return where the parts and the links of the tree disagree."""
    if document.tree is None or document.segmentation is None:
        return ()
    parts = {f"link_{i}" for i in document.segmentation.parts}
    links = {link for link in document.tree.links if link.startswith("link_")}
    out = [
        f"{link} has points but isn't in the kinematic tree; predict again"
        for link in sorted(parts - links)
    ]
    out += [
        f"{link} is in the kinematic tree but has no points; click on it, or delete the part"
        for link in sorted(links - parts)
    ]
    return tuple(out)
