"""Commands about prompts, parts, their labels and joints; see :mod:`sessions.commands`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from model.core.articulated_object import Prediction
from model.core.composite_joints import Composite, with_composite
from model.core.errors import CommandError
from model.core.joint import Joint
from model.core.tree import (
    KinematicTree,
    holds_part,
    replace_joint,
    with_chain_of,
    with_fixed,
    without_link,
)
from model.segmentation.prompts import BASE, MAX_PARTS, Click
from sessions.checks import NAME_LIMIT, check_count, check_part, check_ref, clean_field, name_field
from sessions.document import Document, PartInfo, RegionRef, SegmentationRecord, as_record
from sessions.review import Action
from sessions.state import Command, Context, JobResult


@dataclass(frozen=True)
class RecordSegmentation(
    SegmentationRecord, JobResult, kind="record_segmentation", words="segmentation"
):
    """A segmenter's result, for the prompts of its key only."""

    def __post_init__(self) -> None:
        check_ref(self.labels, "labels")
        for part, count in self.counts.items():
            if not -1 <= part < MAX_PARTS or count < 0:
                raise CommandError(f"counts: {part} has {count} elements; not a part and a count")

    def edit(self, document: Document, context: Context) -> Document:
        record = as_record(SegmentationRecord, self)
        if self.prompts_key != document.key or record == document.segmentation:
            return document
        return with_new_parts(replace(document, segmentation=record))


@dataclass(frozen=True)
class AddClick(Command, kind="add_click"):
    """A prompt point.

    Attributes:
        click: the point.
        answer: the segmenter's result for the prompts with it; None where that is a command of
            its own.
        name: of the part, where the click makes it; None where it has none yet.
    """

    click: Click
    answer: RecordSegmentation | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        name_field(self, "name", "the part's name")

    def describe(self) -> str:
        named = f" {self.name!r}" if self.name else ""
        kind = "add" if self.click.positive else "negative"
        return f"{kind} click, part {self.click.part}{named}"

    def edit(self, document: Document, context: Context) -> Document:
        if self.name and document.part(self.click.part) is None:
            document = with_part(document, PartInfo(self.click.part, self.name))
        clicked = add_prompt(document, self.click)
        return clicked if self.answer is None else self.answer.edit(clicked, context)


@dataclass(frozen=True)
class AddRegion(RegionRef, Command, kind="add_region"):
    """Elements chosen by box, lasso or brush."""

    def __post_init__(self) -> None:
        check_part(self.part)
        check_ref(self.elements, "elements")
        check_count(self.count)
        clean_field(self, "tool", NAME_LIMIT, "tool")

    def describe(self) -> str:
        return (
            f"{'add' if self.positive else 'remove'} {self.tool} of {self.count}, part {self.part}"
        )

    def edit(self, document: Document, context: Context) -> Document:
        return add_prompt(document, as_record(RegionRef, self))


@dataclass(frozen=True)
class RemovePrompt(Command, kind="remove_prompt"):
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

    def edit(self, document: Document, context: Context) -> Document:
        prompts, total = document.prompts, len(document.prompts)
        end = self.index + self.count
        wrong = self.index if not 0 <= self.index < total else end - 1
        if not 0 <= wrong < total:
            have = f"prompts 0..{total - 1}" if total else "no prompts"
            raise CommandError(f"no prompt {wrong}; there are {have}")
        return with_prompts(document, prompts[: self.index] + prompts[end:])


@dataclass(frozen=True)
class ClearPrompts(Command, kind="clear_prompts"):
    """Remove all prompts of ``part``, or of every part where it is None."""

    part: int | None = None

    def __post_init__(self) -> None:
        if self.part is not None:
            check_part(self.part)

    def describe(self) -> str:
        whose = "all prompts" if self.part is None else f"the prompts of part {self.part}"
        return f"clear {whose}"

    def edit(self, document: Document, context: Context) -> Document:
        kept = tuple(p for p in document.prompts if self.part is not None and p.part != self.part)
        return document if len(kept) == len(document.prompts) else with_prompts(document, kept)


@dataclass(frozen=True)
class AddPart(Command, kind="add_part", words="add part {part}"):
    """A part that has no prompt yet."""

    part: int
    name: str | None = None

    def __post_init__(self) -> None:
        check_part(self.part)
        name_field(self, "name", "the part's name")

    def edit(self, document: Document, context: Context) -> Document:
        if document.part(self.part) is not None:
            free = document.next_part
            raise CommandError(f"part {self.part} exists already; part {free} is free")
        return with_part(document, PartInfo(self.part, self.name))


@dataclass(frozen=True)
class NamePart(Command, kind="name_part", action="adjust"):
    """Name a part: door, drawer, lid, …, or None for no name.

    Attributes:
        others: parts of the same shape, which get the name too where they have none.
    """

    part: int
    name: str | None
    others: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for part in (self.part, *self.others):
            check_part(part)
        name_field(self, "name", "the part's name")

    def describe(self) -> str:
        if not self.name:
            return f"remove the name of part {self.part}"
        return f"name part {self.part} {self.name!r}"

    def edit(self, document: Document, context: Context) -> Document:
        known = _known_part(document, self.part)
        if known.name == self.name:
            return document
        named = [known]
        if known.name is None:
            # A name of one of six equal knobs holds for all that have none yet.
            first = self.part if known.like is None else known.like
            same = (first, *self.others)
            named = [
                p for p in document.parts if p.name is None and (p.id in same or p.like == first)
            ]
        for one in named:
            document = with_part(document, replace(one, name=self.name))
        return document


@dataclass(frozen=True)
class DeletePart(Command, kind="delete_part", words="delete part {part}"):
    """Remove a part with its prompts, its name and its link."""

    part: int

    def __post_init__(self) -> None:
        check_part(self.part)
        if self.part == BASE:
            raise CommandError("part 0 is the base and can't be deleted; clear its prompts instead")

    def edit(self, document: Document, context: Context) -> Document:
        return without_part(document, self.part, context)


@dataclass(frozen=True)
class SetCategory(Command, kind="set_category", action="adjust"):
    """Set the object's category, or None."""

    category: str | None

    def __post_init__(self) -> None:
        name_field(self, "category", "the category")

    def describe(self) -> str:
        return f"category {self.category!r}" if self.category else "no category"

    def edit(self, document: Document, context: Context) -> Document:
        if self.category == document.category:
            return document
        return replace(document, category=self.category)


def with_part(document: Document, part: PartInfo) -> Document:
    """Return the document with a part, in place of another one of its number."""
    others = [p for p in document.parts if p.id != part.id]
    return replace(document, parts=tuple(sorted([*others, part], key=lambda p: p.id)))


def without_part(document: Document, part: int, context: Context) -> Document:
    """Return the document without a part, its prompts and its link.

    Raises:
        CommandError: where there is none of that number.
    """
    gone = _known_part(document, part)
    tree = None if document.tree is None else without_link(document.tree, gone.link)
    document = ClearPrompts(part).edit(document, context)
    parts = tuple(p for p in document.parts if p.id != part)
    # Another part may get this number: its copies are copies of the first of them from now on.
    first = next((p.id for p in parts if p.like == part), None)
    parts = tuple(
        replace(p, like=None if p.id == first else first) if p.like == part else p for p in parts
    )
    return replace(document, parts=parts, tree=tree, locked=still_locked(document.locked, tree))


def add_prompt(document: Document, prompt: Click | RegionRef) -> Document:
    """Return the document with one more prompt, and with its part."""
    if document.part(prompt.part) is None:
        document = with_part(document, PartInfo(prompt.part))
    return replace(document, prompts=(*document.prompts, prompt))


def with_prompts(document: Document, prompts: tuple[Click | RegionRef, ...]) -> Document:
    """Return the document with other prompts; without any there are no labels."""
    segmentation = document.segmentation if prompts else None
    return replace(document, prompts=prompts, segmentation=segmentation)


def with_new_parts(document: Document) -> Document:
    """Return the document where parts that the prediction didn't know are fixed to the root, until
    they are predicted.
    """
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
    return replace(document, tree=tree, locked=still_locked(document.locked, tree))


def still_locked(locked: frozenset[str], tree: KinematicTree | None) -> frozenset[str]:
    """Return the locked child links that have a joint in ``tree``."""
    return frozenset() if tree is None else locked & frozenset(tree.joint_of)


def _known_part(document: Document, part: int) -> PartInfo:
    found = document.part(part)
    if found is None:
        ids = ", ".join(str(p.id) for p in document.parts)
        raise CommandError(f"no part {part}; there are {ids}")
    return found


Edited = tuple[KinematicTree, frozenset[str]]
"""A tree, and the child links of its locked joints."""


@dataclass(frozen=True)
class RecordPrediction(Command, kind="record_prediction", words="prediction"):
    """A predictor's result.

    Attributes:
        prediction: the answer; without a tree it changes no joint.
        segmentation: reference of the labels that it was made for.
    """

    prediction: Prediction
    segmentation: str

    def __post_init__(self) -> None:
        check_ref(self.segmentation, "segmentation")

    @property
    def action(self) -> Action:
        return "adjust" if self.prediction.tree is None else "predict"

    def edit(self, document: Document, context: Context) -> Document:
        if document.segmentation is None:
            # The parts were deleted during the prediction.
            return document
        after = replace(document, prediction=self.prediction, joint_edits=0)
        tree = self.prediction.tree
        if tree is None:
            return after
        locked = still_locked(document.locked, tree)
        after = replace(after, prediction_for=self.segmentation, tree=tree, locked=locked)
        return with_new_parts(after)


class JointEdit(Command, action="adjust"):
    """An edit of the tree, or of its locks."""

    def edit(self, document: Document, context: Context) -> Document:
        tree = document.tree
        if tree is None:
            raise CommandError("there is no kinematic tree to edit; predict it first")
        after, locked = self._edited(document, tree)
        if (after, locked) == (tree, document.locked):
            return document
        edits = document.joint_edits + (after != tree)
        return replace(document, tree=after, locked=locked, joint_edits=edits)

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        """Return the tree after it, and the child links locked then."""
        raise NotImplementedError


@dataclass(frozen=True)
class SetJoint(JointEdit, kind="set_joint", words="change joint {joint.name}"):
    """Replace the joint of ``joint.child``: type, axis, origin, limits, name or parent.

    Attributes:
        others: joints of other parts, replaced in the same step.
    """

    joint: Joint
    others: tuple[Joint, ...] = ()

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        for joint in (self.joint, *self.others):
            tree = replace_joint(tree, joint)
        return tree, document.locked


@dataclass(frozen=True)
class SetComposite(JointEdit, kind="set_composite"):
    """Let the part ``child`` move by one joint, or by a chain of several.

    Attributes:
        child: link of the part.
        motion: kind, and the pitch of a screw.
    """

    child: str
    motion: Composite

    def describe(self) -> str:
        words = self.motion.kind.replace("_", " ").replace("single", "one joint")
        return f"{self.child} moves by {words}"

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        after = with_composite(tree, self.child, self.motion, holds_part)
        return after, still_locked(document.locked, after)


@dataclass(frozen=True)
class SetRoot(JointEdit, kind="set_root", words="make {link} the root"):
    """Make ``link`` the root; the joints on the path to the former root are reversed."""

    link: str

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        after, turned = tree.rerooted(self.link), tree.path_to_root(self.link)
        parents = {tree.joint_of[c].parent for c in turned if c in document.locked}
        return after, (document.locked - frozenset(turned)) | parents


@dataclass(frozen=True)
class ResetJoint(JointEdit, kind="reset_joint", words="reset the joint of {child}"):
    """Reset the joint of ``child`` to the predicted one."""

    child: str

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        prediction = document.prediction
        joint = None if prediction is None else prediction.joint(self.child)
        if prediction is None or joint is None:
            raise CommandError(f"no joint was predicted for {self.child!r}")
        if prediction.tree is not None:
            tree = with_chain_of(tree, prediction.tree, self.child)
        return replace_joint(tree, joint), document.locked


@dataclass(frozen=True)
class LockJoint(JointEdit, kind="lock_joint"):
    """Lock or unlock the joint of ``child``: the next prediction keeps a locked joint."""

    child: str
    locked: bool

    def describe(self) -> str:
        return f"{'lock' if self.locked else 'unlock'} the joint of {self.child}"

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        one = frozenset({self.child})
        if self.child not in tree.joint_of:
            known = ", ".join(tree.joint_of)
            raise CommandError(f"no joint moves a link {self.child!r}; links with a joint: {known}")
        return tree, document.locked | one if self.locked else document.locked - one
