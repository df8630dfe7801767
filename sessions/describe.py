"""Human-readable descriptions of commands."""

from __future__ import annotations

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
    kind_of,
)
from sessions.scene_commands import DecideObjects, PickOut, SetArticulable
from sessions.tool_commands import ApplyTool, CropOut, CutFaces, LeaveOut, Placed


def describe(command: Command) -> str:  # noqa: C901  # one case for each kind of command
    """Return what the command does, in a few words for an undo button or a list of edits."""
    match command:
        case AddClick(click=click):
            return f"{'add' if click.positive else 'negative'} click, part {click.part}"
        case AddRegion():
            sign = "add" if command.positive else "remove"
            return f"{sign} {command.tool} of {command.count}, part {command.part}"
        case ApplyTool(tool=tool):
            return _tool_in_words(command, tool)
        case CutFaces(tool=tool):
            return f"{tool} through faces"
        case LeaveOut(elements=elements, what=what):
            return f"leave out {what}" if elements else "leave nothing out"
        case CropOut(name=name):
            return f"cut out {name}"
        case Placed(scene=scene):
            return f"placed in {scene.rpartition('/')[2]}"
        case SetArticulable(object=name, articulable=articulable):
            words = {True: "is", False: "is not", None: "may be"}[articulable]
            return f"{name} {words} articulable"
        case DecideObjects(decision=decision, objects=objects, above=above):
            what = f"{len(objects)} object{'s'[: len(objects) != 1]}"
            return f"{decision} {what}" + ("" if above is None else f" above {100 * above:.0f} %")
        case PickOut(name=name, object=source):
            return f"pick {name} out of {source}"
        case AddPart(part=part) | DeletePart(part=part):
            return f"{'add' if isinstance(command, AddPart) else 'delete'} part {part}"
        case NamePart(part=part, name=name):
            return f"name part {part} {name!r}" if name else f"remove the name of part {part}"
        case SetCategory(category=category):
            return f"category {category!r}" if category else "no category"
        case SetCompletion(complete=complete):
            return "complete the parts" if complete else "leave the parts as scanned"
        case SetFrame():
            return f"read with {command.up_axis} up, scale {command.unit_scale:g}"
        case Prepare(what=what):
            return what
        case SetJoint(joint=joint):
            return f"change joint {joint.name}"
        case SetComposite(child=child, motion=motion):
            words = motion.kind.replace("_", " ").replace("single", "one joint")
            return f"{child} moves by {words}"
        case SetRoot(link=link):
            return f"make {link} the root"
        case ResetJoint(child=child):
            return f"reset the joint of {child}"
        case LockJoint(child=child, locked=locked):
            return f"{'lock' if locked else 'unlock'} the joint of {child}"
        case RecordPrediction():
            return "prediction"
        case RecordSegmentation():
            return "segmentation"
        case Reject(reason=reason):
            return f"reject ({reason.replace('_', ' ')})"
        case AddComment(text=text):
            return f"comment: {text.splitlines()[0][:60]}"
        case ResolveComment(number=number, done=done):
            return f"comment {number} is {'done' if done else 'open'}"
        case ClearPrompts(part=part):
            return "clear all prompts" if part is None else f"clear the prompts of part {part}"
        case RemovePrompt() | Submit() | Accept() | Reopen() | Saved() | Undo() | Redo():
            return kind_of(command).replace("_", " ")


def _tool_in_words(command: ApplyTool, tool: str) -> str:
    parts = sorted({r.part for r in command.regions})
    if not parts:
        return tool
    if len(parts) == 1:
        return f"{tool}, part {parts[0]}"
    return f"{tool}, {len(parts)} parts"
