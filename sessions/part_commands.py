"""Commands about prompts, parts and their labels; see :mod:`sessions.commands`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from model.core.errors import CommandError
from model.core.tree import KinematicTree, with_fixed, without_link
from model.segmentation.prompts import BASE, MAX_PARTS, Click
from sessions.checks import NAME_LIMIT, check_count, check_part, check_ref, clean_field, name_field
from sessions.document import Document, PartInfo, RegionRef, SegmentationRecord, as_record
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
    """

    click: Click
    answer: RecordSegmentation | None = None

    def describe(self) -> str:
        return f"{'add' if self.click.positive else 'negative'} click, part {self.click.part}"

    def edit(self, document: Document, context: Context) -> Document:
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
    """Name a part: door, drawer, lid, …, or None for no name."""

    part: int
    name: str | None

    def __post_init__(self) -> None:
        check_part(self.part)
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
            named = [p for p in document.parts if p.name is None and first in (p.id, p.like)]
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
