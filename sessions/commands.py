"""All commands: those about the review, and by import those of the other modules. Their JSON form.

A command holds a decision of a person, or the result of a job, with its effect on the document, its
words and its stored name. A new one takes a class in the module of its kind, nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

from model.core import codec
from model.core.errors import CommandError
from sessions.checks import NAME_LIMIT, check_finite, clean_field, clean_text, put_field
from sessions.document import (
    CommentRecord,
    Document,
    ReviewRecord,
    SavedRecord,
    acceptance_problems,
)
from sessions.joint_commands import *  # noqa: F403
from sessions.part_commands import *  # noqa: F403
from sessions.review import REJECT_REASONS, RejectReason, ReviewState
from sessions.scene_commands import *  # noqa: F403
from sessions.state import Command, Context, JobResult, Redo, Undo
from sessions.tool_commands import *  # noqa: F403

__all__ = ["NAME_LIMIT", "Command", "Context", "JobResult", "Redo", "Undo"]

KINDS = Command.KINDS
COMMENT_LIMIT = 2000
NOTE_LIMIT = 500


@dataclass(frozen=True)
class SetCompletion(Command, kind="set_completion", action="adjust"):
    """Turn the completion of unscanned geometry in the asset on or off."""

    complete: bool

    def describe(self) -> str:
        return "complete the parts" if self.complete else "leave the parts as scanned"

    def edit(self, document: Document, context: Context) -> Document:
        if self.complete is document.complete:
            return document
        return replace(document, complete=self.complete)


class _Decision(Command):
    """A decision about the whole object, with a comment."""

    comment: str

    def __post_init__(self) -> None:
        clean_field(self, "comment", COMMENT_LIMIT, "the comment", lines=True)

    def edit(self, document: Document, context: Context) -> Document:
        return replace(document)

    def review(self, before: ReviewRecord, state: ReviewState, context: Context) -> ReviewRecord:
        return ReviewRecord(state, context.who, context.at, comment=self.comment)


@dataclass(frozen=True)
class Submit(_Decision, kind="submit", action="submit"):
    """Hand the object in for review.

    Attributes:
        comment: for the reviewer.
    """

    comment: str = ""

    def edit(self, document: Document, context: Context) -> Document:
        return _complete(document, self.kind)


@dataclass(frozen=True)
class Accept(_Decision, kind="accept", action="accept"):
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
        super().__post_init__()
        notes = tuple(clean_text(n[:NOTE_LIMIT], NOTE_LIMIT, "a note") for n in self.note_problems)
        put_field(self, "note_problems", notes)
        clean_field(self, "override", COMMENT_LIMIT, "the reason")
        clean_field(self, "decided_at", NAME_LIMIT, "the time")

    def edit(self, document: Document, context: Context) -> Document:
        return _complete(document, self.kind)

    def review(self, before: ReviewRecord, state: ReviewState, context: Context) -> ReviewRecord:
        return replace(
            super().review(before, state, context),
            problems=self.note_problems,
            override=self.override,
            decided_at=self.decided_at,
        )


@dataclass(frozen=True)
class Reject(_Decision, kind="reject", action="reject"):
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
        super().__post_init__()
        clean_field(self, "decided_at", NAME_LIMIT, "the time")
        clean_field(self, "joint", NAME_LIMIT, "the joint")
        check_finite(self.place or (), "place")

    def describe(self) -> str:
        return f"reject ({self.reason.replace('_', ' ')})"

    def edit(self, document: Document, context: Context) -> Document:
        _check_joint(document, self.joint)
        if self.listed and (self.comment or self.joint or self.place is not None):
            text = self.comment or self.reason.replace("_", " ")
            return _commented(document, text, self, context)
        return replace(document)

    def review(self, before: ReviewRecord, state: ReviewState, context: Context) -> ReviewRecord:
        return replace(
            super().review(before, state, context),
            reason=self.reason,
            decided_at=self.decided_at,
            joint=self.joint,
            place=self.place,
        )


@dataclass(frozen=True)
class Reopen(_Decision, kind="reopen", action="reopen"):
    """Reopen an accepted or rejected object."""

    comment: str = ""


@dataclass(frozen=True)
class AddComment(Command, kind="add_comment", action="comment"):
    """A comment of a reviewer, for the annotator to deal with.

    Attributes:
        text: human-readable.
        joint, place: what it is about; see :class:`Reject`.
    """

    text: str
    joint: str = ""
    place: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        clean_field(self, "text", COMMENT_LIMIT, "the comment", lines=True)
        if not self.text:
            raise CommandError("the comment is empty; say what should change")
        clean_field(self, "joint", NAME_LIMIT, "the joint")
        check_finite(self.place or (), "place")

    def describe(self) -> str:
        return f"comment: {self.text.splitlines()[0][:60]}"

    def edit(self, document: Document, context: Context) -> Document:
        return _commented(document, self.text, self, context)


@dataclass(frozen=True)
class ResolveComment(Command, kind="resolve_comment", action="resolve"):
    """Mark a comment, by its number from 1, as done or as open again."""

    number: int
    done: bool = True

    def describe(self) -> str:
        return f"comment {self.number} is {'done' if self.done else 'open'}"

    def edit(self, document: Document, context: Context) -> Document:
        comments, at = document.comments, self.number - 1
        if not 0 <= at < len(comments):
            raise CommandError(f"there is no comment {self.number}; there are {len(comments)}")
        if comments[at].done is self.done:
            return document
        changed = replace(comments[at], done=self.done)
        return replace(document, comments=(*comments[:at], changed, *comments[at + 1 :]))


@dataclass(frozen=True)
class Saved(JobResult, kind="saved"):
    """The asset was written to ``folder``. Amends the present document; no undo step."""

    folder: str

    def edit(self, document: Document, context: Context) -> Document:
        return replace(document, saved=SavedRecord(self.folder, context.who, context.at))


def _complete(document: Document, verb: str) -> Document:
    """Return the document anew; refuses one that can't be accepted."""
    problems = acceptance_problems(document)
    if problems:
        raise CommandError(f"can't {verb}: " + "; ".join(problems))
    return replace(document)


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


def to_json(command: Command) -> dict[str, Any]:
    """Return ``command`` as JSON data, its name under ``kind``.

    Raises:
        CommandError: where a number is NaN or infinite.
    """
    try:
        return {"kind": command.kind, **codec.write(command, command.kind)}
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
