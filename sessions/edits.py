"""The effect of each command on a document. Pure: the same document where nothing changes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from model.core.composite_joints import with_composite
from model.core.errors import ArtiworldError, CommandError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.segmentation.prompts import BASE, Click
from sessions.commands import (
    Accept,
    AddClick,
    AddComment,
    AddPart,
    AddRegion,
    ClearPrompts,
    Command,
    DeletePart,
    LockJoint,
    NamePart,
    Prepare,
    RecordPrediction,
    RecordSegmentation,
    Redo,
    Reject,
    RemovePrompt,
    Reopen,
    ResetJoint,
    ResolveComment,
    Saved,
    SetCategory,
    SetCompletion,
    SetComposite,
    SetFrame,
    SetJoint,
    SetRoot,
    Submit,
    Undo,
)
from sessions.describe import describe
from sessions.document import (
    CommentRecord,
    CropRecord,
    DecisionRecord,
    Document,
    LeftOut,
    PartInfo,
    Placement,
    RegionRef,
    ReviewRecord,
    SavedRecord,
    SegmentationRecord,
    acceptance_problems,
)
from sessions.review import Action, Role, transition
from sessions.scene_commands import DecideObjects, PickOut, SetArticulable
from sessions.tool_commands import ApplyTool, CropOut, CutFaces, LeaveOut, Placed
from sessions.tree_edits import holds_part, replace_joint, with_chain_of, with_fixed, without_link


@dataclass(frozen=True)
class Context:
    """Author and time of a command.

    Attributes:
        who: the person.
        at: ISO 8601, UTC.
        role: the person's role.
    """

    who: str
    at: str
    role: Role = "reviewer"


def edit(document: Document, command: Command, context: Context) -> Document:
    """Return the document after ``command`` as one step.

    Raises:
        CommandError: where the document doesn't allow it; the message says why.
    """
    try:
        changed, action = _changed(document, command, context)
    except CommandError:
        raise
    except ArtiworldError as error:
        raise CommandError(str(error)) from error
    if changed is document:
        return document
    return _reviewed(document, changed, command, action, context)


def amend(
    document: Document, command: RecordSegmentation | Saved | Placed, context: Context
) -> Document:
    """Return the document with a job's result; not a step that can be undone."""
    if isinstance(command, Saved):
        return replace(document, saved=SavedRecord(command.folder, context.who, context.at))
    if isinstance(command, Placed):
        placement = Placement(
            command.scene, command.scene_sha256, command.elements, command.position, command.wxyz
        )
        return (
            document if placement == document.placement else replace(document, placement=placement)
        )
    if command.prompts_key != document.key:
        return document
    record = SegmentationRecord(
        command.prompts_key, command.labels, command.segmenter, command.seconds, command.counts
    )
    if record == document.segmentation:
        return document
    return _with_new_parts(replace(document, segmentation=record))


def _with_new_parts(document: Document) -> Document:
    """Fix parts that the prediction didn't know to the root, until they are predicted."""
    tree = document.tree
    if tree is None or document.segmentation is None:
        return document
    present = [f"link_{part}" for part in document.segmentation.parts]
    for joint in document.new_joints:
        if joint.child not in present:
            assert tree is not None
            tree = without_link(tree, joint.child)
    for link in present:
        if tree is not None and link not in tree.links:
            tree = with_fixed(tree, link)
    if tree == document.tree:
        return document
    return replace(document, tree=tree, locked=_still_locked(document.locked, tree))


def _changed(  # noqa: C901  # one case for each kind of command
    document: Document, command: Command, context: Context
) -> tuple[Document, Action]:
    match command:
        case AddClick(click=click):
            return _add_prompt(document, click), "annotate"
        case AddRegion():
            region = RegionRef(
                command.part, command.elements, command.positive, command.count, command.tool
            )
            return _add_prompt(document, region), "annotate"
        case ApplyTool():
            return _apply_tool(document, command), "annotate"
        case CutFaces():
            return _cut_faces(document, command), "annotate"
        case LeaveOut():
            return _leave_out(document, command), "annotate"
        case CropOut():
            return _crop_out(document, command), "annotate"
        case SetArticulable():
            return _set_articulable(document, command), "adjust"
        case DecideObjects():
            return _decide_objects(document, command, context), "adjust"
        case PickOut():
            return _pick_out(document, command), "adjust"
        case RemovePrompt(index=index, count=count):
            return _remove_prompts(document, index, count), "annotate"
        case ClearPrompts(part=part):
            return _clear_prompts(document, part), "annotate"
        case AddPart(part=part, name=name):
            if document.part(part) is not None:
                raise CommandError(f"part {part} exists already; part {document.next_part} is free")
            return _with_part(document, PartInfo(part, name)), "annotate"
        case DeletePart(part=part):
            return _delete_part(document, part), "annotate"
        case SetFrame():
            return _set_frame(document, command), "annotate"
        case Prepare():
            return _prepare(document, command), "annotate"
        case NamePart(part=part, name=name):
            return _name_part(document, part, name), "adjust"
        case SetCategory(category=category):
            if category == document.category:
                return document, "adjust"
            return replace(document, category=category), "adjust"
        case SetCompletion(complete=complete):
            if complete is document.complete:
                return document, "adjust"
            return replace(document, complete=complete), "adjust"
        case RecordPrediction():
            return _record_prediction(document, command)
        case SetJoint() | SetComposite() | SetRoot() | ResetJoint() | LockJoint():
            return _edit_tree(document, command), "adjust"
        case Accept():
            problems = acceptance_problems(document)
            if problems:
                raise CommandError("can't accept: " + "; ".join(problems))
            return replace(document), "accept"
        case Submit():
            problems = acceptance_problems(document)
            if problems:
                raise CommandError("can't submit: " + "; ".join(problems))
            return replace(document), "submit"
        case Reject():
            _check_joint(document, command.joint)
            about = command.joint or command.place is not None
            if command.listed and (command.comment or about):
                text = command.comment or command.reason.replace("_", " ")
                return _commented(document, text, command, context), "reject"
            return replace(document), "reject"
        case AddComment(text=text):
            return _commented(document, text, command, context), "comment"
        case ResolveComment(number=number, done=done):
            return _resolved(document, number, done), "resolve"
        case Reopen():
            return replace(document), "reopen"
        case RecordSegmentation() | Saved() | Placed() | Undo() | Redo():
            raise AssertionError(f"{command} is no step")


def _reviewed(
    before: Document, after: Document, command: Command, action: Action, context: Context
) -> Document:
    """Return ``after`` with its review state, counters and author."""
    state = transition(before.review.state, action, context.role)
    review = before.review
    if isinstance(command, (Submit, Accept, Reject, Reopen)):
        review = ReviewRecord(
            state,
            context.who,
            context.at,
            command.reason if isinstance(command, Reject) else None,
            command.comment,
            command.note_problems if isinstance(command, Accept) else (),
            command.override if isinstance(command, Accept) else "",
            command.decided_at if isinstance(command, (Accept, Reject)) else "",
            command.joint if isinstance(command, Reject) else "",
            command.place if isinstance(command, Reject) else None,
        )
    elif state != review.state:
        # The reviewer's comment stays while the annotator corrects the object.
        review = replace(review, state=state, by=context.who, at=context.at)
    joint_edits = before.joint_edits
    if isinstance(command, (RecordPrediction, SetFrame, Prepare)):
        joint_edits = 0
    elif isinstance(command, (SetJoint, SetComposite, SetRoot, ResetJoint)):
        joint_edits += 1
    return replace(
        after,
        review=review,
        annotator=context.who if action in ("annotate", "submit") else before.annotator,
        edits=before.edits + 1,
        joint_edits=joint_edits,
        label=describe(command),
    )


def _commented(
    document: Document, text: str, command: Reject | AddComment, context: Context
) -> Document:
    _check_joint(document, command.joint)
    number = len(document.comments) + 1
    comment = CommentRecord(number, text, command.joint, command.place, context.who, context.at)
    return replace(document, comments=(*document.comments, comment))


def _check_joint(document: Document, joint: str) -> None:
    if joint and (document.tree is None or joint not in document.tree.joint_of):
        raise CommandError(f"the comment is about {joint}, which has no joint here")


def _resolved(document: Document, number: int, done: bool) -> Document:
    comments = document.comments
    if not 1 <= number <= len(comments):
        raise CommandError(f"there is no comment {number}; there are {len(comments)}")
    if comments[number - 1].done is done:
        return document
    changed = replace(comments[number - 1], done=done)
    return replace(document, comments=(*comments[: number - 1], changed, *comments[number:]))


def _with_part(document: Document, part: PartInfo) -> Document:
    others = [p for p in document.parts if p.id != part.id]
    return replace(document, parts=tuple(sorted([*others, part], key=lambda p: p.id)))


def _add_prompt(document: Document, prompt: Click | RegionRef) -> Document:
    if document.part(prompt.part) is None:
        document = _with_part(document, PartInfo(prompt.part))
    return replace(document, prompts=(*document.prompts, prompt))


def _with_prompts(document: Document, prompts: tuple[Click | RegionRef, ...]) -> Document:
    # Without prompts there are no labels.
    segmentation = document.segmentation if prompts else None
    return replace(document, prompts=prompts, segmentation=segmentation)


def _remove_prompts(document: Document, index: int, count: int) -> Document:
    total = len(document.prompts)
    wrong = index if not 0 <= index < total else index + count - 1
    if not 0 <= wrong < total:
        have = f"prompts 0..{total - 1}" if total else "no prompts"
        raise CommandError(f"no prompt {wrong}; there are {have}")
    return _with_prompts(document, document.prompts[:index] + document.prompts[index + count :])


def _clear_prompts(document: Document, part: int | None) -> Document:
    kept = tuple(p for p in document.prompts if part is not None and p.part != part)
    return document if len(kept) == len(document.prompts) else _with_prompts(document, kept)


def _known_part(document: Document, part: int) -> PartInfo:
    found = document.part(part)
    if found is None:
        ids = ", ".join(str(p.id) for p in document.parts)
        raise CommandError(f"no part {part}; there are {ids}")
    return found


def _name_part(document: Document, part: int, name: str | None) -> Document:
    known = _known_part(document, part)
    if known.name == name:
        return document
    named = [known]
    if known.name is None:
        # A name of one of six equal knobs holds for all that have none yet.
        first = part if known.like is None else known.like
        named = [p for p in document.parts if p.name is None and first in (p.id, p.like)]
    for one in named:
        document = _with_part(document, replace(one, name=name))
    return document


def _delete_part(document: Document, part: int) -> Document:
    gone = _known_part(document, part)
    assert part != BASE, "the command refuses the base"
    tree = None if document.tree is None else without_link(document.tree, gone.link)
    document = _clear_prompts(document, part)
    parts = tuple(p for p in document.parts if p.id != part)
    # Another part may get this number: its copies are copies of the first of them from now on.
    first = next((p.id for p in parts if p.like == part), None)
    return replace(
        document,
        parts=tuple(
            replace(p, like=None if p.id == first else first) if p.like == part else p
            for p in parts
        ),
        tree=tree,
        locked=_still_locked(document.locked, tree),
    )


def _still_locked(locked: frozenset[str], tree: KinematicTree | None) -> frozenset[str]:
    return frozenset() if tree is None else locked & frozenset(tree.joint_of)


def _set_frame(document: Document, command: SetFrame) -> Document:
    if (document.up_axis, document.unit_scale) == (command.up_axis, command.unit_scale):
        return document
    return replace(_afresh(document), up_axis=command.up_axis, unit_scale=command.unit_scale)


def _prepare(document: Document, command: Prepare) -> Document:
    after = replace(
        document,
        unit_scale=command.unit_scale,
        frame=command.frame,
        left_out=_left_out(command.leave_out),
    )
    return document if after == document else _afresh(after)


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


def _leave_out(document: Document, command: LeaveOut) -> Document:
    left_out = _left_out(command)
    if left_out == document.left_out:
        return document
    return replace(_afresh(document), left_out=left_out)


def _left_out(command: LeaveOut) -> LeftOut | None:
    if command.elements is None:
        return None
    return LeftOut(command.elements, command.count, command.what)


def _crop_out(document: Document, command: CropOut) -> Document:
    crop = CropRecord(
        command.name,
        command.path,
        command.elements,
        command.count,
        command.position,
        command.wxyz,
    )
    if crop in document.crops:
        return document
    return replace(document, crops=(*document.crops, crop))


def _apply_tool(document: Document, command: ApplyTool) -> Document:
    if command.replaces > len(document.prompts):
        raise CommandError(
            f"{command.tool} replaces {command.replaces} prompts, "
            f"but there are {len(document.prompts)}"
        )
    before = document
    if command.replaces:
        document = replace(document, prompts=document.prompts[: -command.replaces])
    for part in command.delete:
        if document.part(part) is not None:
            document = _delete_part(document, part)
    for r in command.regions:
        if document.part(r.part) is None:
            document = _with_part(document, PartInfo(r.part, r.name, r.like))
        region = RegionRef(r.part, r.elements, r.positive, r.count, command.tool)
        document = _add_prompt(document, region)
    if document is before:
        return before
    return _with_prompts(document, document.prompts)


def _cut_faces(document: Document, command: CutFaces) -> Document:
    bare = replace(document, prompts=(), face_cuts=(*document.face_cuts, command.cut))
    return _apply_tool(bare, ApplyTool(command.tool, command.regions))


def _record_prediction(document: Document, command: RecordPrediction) -> tuple[Document, Action]:
    if document.segmentation is None:
        # The parts were deleted during the prediction.
        return document, "predict"
    tree = command.prediction.tree
    if tree is None:
        return replace(document, prediction=command.prediction), "adjust"
    after = replace(
        document,
        prediction=command.prediction,
        prediction_for=command.segmentation,
        tree=tree,
        locked=_still_locked(document.locked, tree),
    )
    return _with_new_parts(after), "predict"


def _edit_tree(
    document: Document, command: SetJoint | SetComposite | SetRoot | ResetJoint | LockJoint
) -> Document:
    tree = document.tree
    if tree is None:
        raise CommandError("there is no kinematic tree to edit; predict it first")
    if isinstance(command, LockJoint):
        return _lock(document, tree, command)
    locked = document.locked
    if isinstance(command, SetRoot):
        after = tree.rerooted(command.link)
        turned = tree.path_to_root(command.link)
        parents = {tree.joint_of[c].parent for c in turned if c in locked}
        locked = (locked - frozenset(turned)) | parents
    elif isinstance(command, SetComposite):
        after = with_composite(tree, command.child, command.motion, holds_part)
        locked = _still_locked(locked, after)
    else:
        joint = command.joint if isinstance(command, SetJoint) else _predicted(document, command)
        was = document.prediction.tree if document.prediction is not None else None
        if isinstance(command, ResetJoint) and was is not None:
            tree = with_chain_of(tree, was, command.child)
        after = replace_joint(tree, joint)
    if after == document.tree:
        return document
    return replace(document, tree=after, locked=locked)


def _lock(document: Document, tree: KinematicTree, command: LockJoint) -> Document:
    if command.child not in tree.joint_of:
        known = ", ".join(tree.joint_of)
        raise CommandError(f"no joint moves a link {command.child!r}; links with a joint: {known}")
    one = frozenset({command.child})
    locked = document.locked | one if command.locked else document.locked - one
    return document if locked == document.locked else replace(document, locked=locked)


def _predicted(document: Document, command: ResetJoint) -> Joint:
    joint = None if document.prediction is None else document.prediction.joint(command.child)
    if joint is None:
        raise CommandError(f"no joint was predicted for {command.child!r}")
    return joint


def _set_articulable(document: Document, command: SetArticulable) -> Document:
    if document.articulable.get(command.object) is command.articulable:
        return document
    said = {k: v for k, v in document.articulable.items() if k != command.object}
    if command.articulable is not None:
        said[command.object] = command.articulable
    return replace(document, articulable=said)


def _decide_objects(document: Document, command: DecideObjects, context: Context) -> Document:
    if context.role == "annotator":
        raise CommandError("only a reviewer may accept and reject objects")
    record = DecisionRecord(
        command.decision,
        command.objects,
        command.above,
        command.reason,
        context.who,
        context.at,
        command.looked,
    )
    return replace(document, decided=(*document.decided, record))


def _pick_out(document: Document, command: PickOut) -> Document:
    if any(p.id == command.id for p in document.picked):
        raise CommandError(f"{command.id} was picked out already")
    return replace(document, picked=(*document.picked, command))
