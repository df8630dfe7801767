"""Every edit as a small frozen value with a JSON form.

A command holds a decision of a person (or the result of a job), not its effect on the state, which
is in :mod:`sessions.edits`. Stored commands are kept for good: a kind or a field is never renamed,
and new fields have defaults.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast, get_args

from model.core import codec
from model.core.articulated_object import Prediction
from model.core.asset import UpAxis
from model.core.composite_joints import Composite
from model.core.errors import CommandError
from model.core.joint import Joint
from model.segmentation.prompts import BASE, MAX_PARTS, Click
from sessions.checks import (
    NAME_LIMIT,
    check_count,
    check_finite,
    check_part,
    check_ref,
    check_unit_scale,
    clean_name,
    clean_text,
    put_field,
)
from sessions.review import REJECT_REASONS, RejectReason
from sessions.scene_commands import DecideObjects, PickOut, SetArticulable
from sessions.tool_commands import ApplyTool, CropOut, CutFaces, LeaveOut, ObjectFrame, Placed

COMMENT_LIMIT = 2000
NOTE_LIMIT = 500
UP_AXES: tuple[UpAxis, ...] = get_args(UpAxis)


@dataclass(frozen=True)
class AddClick:
    """A prompt point."""

    click: Click


@dataclass(frozen=True)
class AddRegion:
    """Elements chosen by box, lasso or brush.

    Attributes:
        part: the part they belong to.
        elements: reference of the stored (K,) int64 array.
        positive: False where they don't belong to the part.
        count: K, for display.
        tool: display name of the tool that chose them.
    """

    part: int
    elements: str
    positive: bool = True
    count: int = 0
    tool: str = "box"

    def __post_init__(self) -> None:
        check_part(self.part)
        check_ref(self.elements, "elements")
        check_count(self.count)
        put_field(self, "tool", clean_text(self.tool, NAME_LIMIT, "tool"))


@dataclass(frozen=True)
class RemovePrompt:
    """Remove prompts that belong together, such as a click and another mask for it.

    Attributes:
        index: of the first one; counts all the prompts in the order they were given.
        count: how many from there on.
    """

    index: int
    count: int = 1

    def __post_init__(self) -> None:
        if self.count < 1:
            raise CommandError(f"count must be 1 or more, got {self.count}")


@dataclass(frozen=True)
class ClearPrompts:
    """Remove all prompts of ``part``, or of every part where it is None."""

    part: int | None = None

    def __post_init__(self) -> None:
        if self.part is not None:
            check_part(self.part)


@dataclass(frozen=True)
class AddPart:
    """A part that has no prompt yet."""

    part: int
    name: str | None = None

    def __post_init__(self) -> None:
        check_part(self.part)
        put_field(self, "name", clean_name(self.name, "the part's name"))


@dataclass(frozen=True)
class NamePart:
    """Name a part: door, drawer, lid, …, or None for no name."""

    part: int
    name: str | None

    def __post_init__(self) -> None:
        check_part(self.part)
        put_field(self, "name", clean_name(self.name, "the part's name"))


@dataclass(frozen=True)
class DeletePart:
    """Remove a part with its prompts, its name and its link."""

    part: int

    def __post_init__(self) -> None:
        check_part(self.part)
        if self.part == BASE:
            raise CommandError("part 0 is the base and can't be deleted; clear its prompts instead")


@dataclass(frozen=True)
class SetCategory:
    """Set the object's category, or None."""

    category: str | None

    def __post_init__(self) -> None:
        put_field(self, "category", clean_name(self.category, "the category"))


@dataclass(frozen=True)
class SetFrame:
    """Set the up axis and metres per unit of the source. Restarts the annotation.

    Earlier versions gave it; now :class:`Prepare` says more.
    """

    up_axis: UpAxis
    unit_scale: float

    def __post_init__(self) -> None:
        if self.up_axis not in UP_AXES:
            raise CommandError(f"up_axis must be one of {', '.join(UP_AXES)}, got {self.up_axis!r}")
        check_unit_scale(self.unit_scale, "unit_scale")


@dataclass(frozen=True)
class Prepare:
    """Level, size and clean the source. Restarts the annotation.

    Attributes:
        unit_scale: metres per unit of the source.
        frame: the object's frame in that of the source as it is read.
        leave_out: what is left out from now on.
        what: human-readable summary of the change.
    """

    unit_scale: float
    frame: ObjectFrame
    leave_out: LeaveOut
    what: str

    def __post_init__(self) -> None:
        check_unit_scale(self.unit_scale, "unit_scale")
        put_field(self, "what", clean_text(self.what, NAME_LIMIT, "what was changed"))


@dataclass(frozen=True)
class RecordSegmentation:
    """A segmenter's result. Amends the present document; no undo step.

    Attributes:
        prompts_key: :func:`sessions.document.prompts_key` of the prompts that it answers.
        labels: reference of the stored (E,) int16 labels.
        segmenter: who answered.
        seconds: how long it took.
        counts: label → number of elements, -1 is unassigned.
    """

    prompts_key: str
    labels: str
    segmenter: str
    seconds: float
    counts: Mapping[int, int]

    def __post_init__(self) -> None:
        check_ref(self.labels, "labels")
        for part, count in self.counts.items():
            if not -1 <= part < MAX_PARTS or count < 0:
                raise CommandError(f"counts: {part} has {count} elements; not a part and a count")


@dataclass(frozen=True)
class RecordPrediction:
    """A predictor's result.

    Attributes:
        prediction: the answer; without a tree it changes no joint.
        segmentation: reference of the labels that it was made for.
    """

    prediction: Prediction
    segmentation: str

    def __post_init__(self) -> None:
        check_ref(self.segmentation, "segmentation")


@dataclass(frozen=True)
class SetJoint:
    """Replace the joint of ``joint.child``: type, axis, origin, limits, name or parent."""

    joint: Joint


@dataclass(frozen=True)
class SetComposite:
    """Let the part ``child`` move by one joint, or by a chain of several.

    Attributes:
        child: link of the part.
        motion: kind, and the pitch of a screw.
    """

    child: str
    motion: Composite


@dataclass(frozen=True)
class SetRoot:
    """Make ``link`` the root; the joints on the path to the former root are reversed."""

    link: str


@dataclass(frozen=True)
class ResetJoint:
    """Reset the joint of ``child`` to the predicted one."""

    child: str


@dataclass(frozen=True)
class LockJoint:
    """Lock or unlock the joint of ``child``: the next prediction keeps a locked joint."""

    child: str
    locked: bool


@dataclass(frozen=True)
class SetCompletion:
    """Turn the completion of unscanned geometry in the asset on or off."""

    complete: bool


@dataclass(frozen=True)
class Accept:
    """Accept the object.

    Attributes:
        comment: human-readable.
        note_problems: the known warnings and errors.
        override: reason for accepting it despite errors, else "".
        decided_at: when the decision about a whole scene was made that this carries out, else "".
    """

    comment: str = ""
    note_problems: tuple[str, ...] = ()
    override: str = ""
    decided_at: str = ""

    def __post_init__(self) -> None:
        put_field(
            self, "comment", clean_text(self.comment, COMMENT_LIMIT, "the comment", lines=True)
        )
        notes = tuple(clean_text(n[:NOTE_LIMIT], NOTE_LIMIT, "a note") for n in self.note_problems)
        put_field(self, "note_problems", notes)
        put_field(self, "override", clean_text(self.override, COMMENT_LIMIT, "the reason"))
        put_field(self, "decided_at", clean_text(self.decided_at, NAME_LIMIT, "the time"))


@dataclass(frozen=True)
class Submit:
    """Hand the object in for review.

    Attributes:
        comment: for the reviewer.
    """

    comment: str = ""

    def __post_init__(self) -> None:
        put_field(
            self, "comment", clean_text(self.comment, COMMENT_LIMIT, "the comment", lines=True)
        )


@dataclass(frozen=True)
class Reject:
    """Reject the object: it goes back to its annotator.

    Attributes:
        reason, comment: why.
        decided_at: as in :class:`Accept`.
        joint: child link of the joint that the comment is about, else "".
        place: (3,) what the comment is about, metres, object frame; None: no place.
        listed: whether the comment is one of those that the annotator ticks off, too.
    """

    reason: RejectReason
    comment: str = ""
    decided_at: str = ""
    joint: str = ""
    place: tuple[float, float, float] | None = None
    listed: bool = False

    def __post_init__(self) -> None:
        if self.reason not in REJECT_REASONS:
            allowed = ", ".join(REJECT_REASONS)
            raise CommandError(f"reason must be one of {allowed}, got {self.reason!r}")
        put_field(
            self, "comment", clean_text(self.comment, COMMENT_LIMIT, "the comment", lines=True)
        )
        put_field(self, "decided_at", clean_text(self.decided_at, NAME_LIMIT, "the time"))
        put_field(self, "joint", clean_text(self.joint, NAME_LIMIT, "the joint"))
        check_finite(self.place or (), "place")


@dataclass(frozen=True)
class AddComment:
    """A comment of a reviewer, for the annotator to deal with.

    Attributes:
        text: human-readable.
        joint, place: what it is about; see :class:`Reject`.
    """

    text: str
    joint: str = ""
    place: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        text = clean_text(self.text, COMMENT_LIMIT, "the comment", lines=True)
        if not text:
            raise CommandError("the comment is empty; say what should change")
        put_field(self, "text", text)
        put_field(self, "joint", clean_text(self.joint, NAME_LIMIT, "the joint"))
        check_finite(self.place or (), "place")


@dataclass(frozen=True)
class ResolveComment:
    """Mark a comment, by its number from 1, as done or as open again."""

    number: int
    done: bool = True


@dataclass(frozen=True)
class Reopen:
    """Reopen an accepted or rejected object."""

    comment: str = ""

    def __post_init__(self) -> None:
        put_field(
            self, "comment", clean_text(self.comment, COMMENT_LIMIT, "the comment", lines=True)
        )


@dataclass(frozen=True)
class Saved:
    """The asset was written to ``folder``. Amends the present document; no undo step."""

    folder: str


@dataclass(frozen=True)
class Undo:
    """Undo the last step."""


@dataclass(frozen=True)
class Redo:
    """Redo the step that was undone last."""


Command = (
    AddClick
    | AddRegion
    | ApplyTool
    | CutFaces
    | LeaveOut
    | CropOut
    | Placed
    | SetArticulable
    | DecideObjects
    | PickOut
    | RemovePrompt
    | ClearPrompts
    | AddPart
    | NamePart
    | DeletePart
    | SetCategory
    | SetFrame
    | Prepare
    | RecordSegmentation
    | RecordPrediction
    | SetJoint
    | SetComposite
    | SetRoot
    | ResetJoint
    | LockJoint
    | SetCompletion
    | Submit
    | Accept
    | Reject
    | AddComment
    | ResolveComment
    | Reopen
    | Saved
    | Undo
    | Redo
)

KINDS: Mapping[str, type[Command]] = {
    "add_click": AddClick,
    "add_region": AddRegion,
    "apply_tool": ApplyTool,
    "cut_faces": CutFaces,
    "leave_out": LeaveOut,
    "crop_out": CropOut,
    "placed": Placed,
    "set_articulable": SetArticulable,
    "decide_objects": DecideObjects,
    "pick_out": PickOut,
    "remove_prompt": RemovePrompt,
    "clear_prompts": ClearPrompts,
    "add_part": AddPart,
    "name_part": NamePart,
    "delete_part": DeletePart,
    "set_category": SetCategory,
    "set_frame": SetFrame,
    "prepare": Prepare,
    "record_segmentation": RecordSegmentation,
    "record_prediction": RecordPrediction,
    "set_joint": SetJoint,
    "set_composite": SetComposite,
    "set_root": SetRoot,
    "reset_joint": ResetJoint,
    "lock_joint": LockJoint,
    "set_completion": SetCompletion,
    "submit": Submit,
    "accept": Accept,
    "reject": Reject,
    "add_comment": AddComment,
    "resolve_comment": ResolveComment,
    "reopen": Reopen,
    "saved": Saved,
    "undo": Undo,
    "redo": Redo,
}
"""All commands by their stored name."""

_KIND_OF: Mapping[type[Command], str] = {cls: kind for kind, cls in KINDS.items()}


def kind_of(command: Command) -> str:
    """Return the command's stored name."""
    return _KIND_OF[type(command)]


def to_json(command: Command) -> dict[str, Any]:
    """Return ``command`` as JSON data, its name under ``kind``.

    Raises:
        CommandError: where a number is NaN or infinite.
    """
    kind = kind_of(command)
    try:
        return {"kind": kind, **codec.write(command, kind)}
    except codec.CodecError as error:
        raise CommandError(str(error)) from error


def from_json(data: object) -> Command:
    """Return the command that :func:`to_json` wrote.

    Raises:
        CommandError: naming the field and the value, or the unknown kind.
    """
    if not isinstance(data, dict):
        raise CommandError(f"a command must be an object, got {str(data)[:80]!r}")
    fields = cast(dict[str, object], data)
    kind = fields.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise CommandError(
            f"unknown command {str(kind)[:80]!r}; a newer version of ArtiWorld may have written it"
        )
    rest = {key: value for key, value in fields.items() if key != "kind"}
    try:
        return codec.read(KINDS[kind], rest, kind)
    except codec.CodecError as error:
        raise CommandError(str(error)) from error
