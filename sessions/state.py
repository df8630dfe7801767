"""A session's state, and the effect of commands on it. Pure: replaying the log gives the state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

from model.core.errors import CommandError
from sessions.commands import Command, Placed, RecordSegmentation, Redo, Saved, Undo
from sessions.document import Document, acceptance_problems, prompts_key, review_problems
from sessions.edits import Context, amend, edit

__all__ = [
    "MAX_UNDO",
    "Context",
    "Document",
    "JobRequest",
    "SessionState",
    "acceptance_problems",
    "apply",
    "needed_jobs",
    "prompts_key",
    "replay",
    "review_problems",
]

MAX_UNDO = 1000


@dataclass(frozen=True)
class SessionState:
    """The present document, and the documents of undo and redo.

    Attributes:
        present: the present decisions.
        past: former documents, oldest first, at most ``MAX_UNDO``.
        future: documents taken back; the next one to redo is last.
        seq: number of the last command that is in it; 0 before the first.
    """

    present: Document = field(default_factory=Document)
    past: tuple[Document, ...] = ()
    future: tuple[Document, ...] = ()
    seq: int = 0

    @property
    def can_undo(self) -> bool:
        """True if there is a step to undo."""
        return bool(self.past)

    @property
    def can_redo(self) -> bool:
        """True if there is a step to redo."""
        return bool(self.future)

    @property
    def undo_label(self) -> str:
        """Label of undo, as "Undo: add click, part 1"; "" where there is nothing."""
        return f"Undo: {self.present.label}" if self.past else ""

    @property
    def redo_label(self) -> str:
        """Label of redo, as "Redo: add click, part 1"; "" where there is nothing."""
        return f"Redo: {self.future[-1].label}" if self.future else ""


@dataclass(frozen=True)
class JobRequest:
    """Work that the state asks for.

    Attributes:
        kind: the kind of work.
        prompts_key: the prompts that it is asked for; the answer carries it back.
    """

    kind: Literal["segment"]
    prompts_key: str


def apply(state: SessionState, command: Command, context: Context) -> SessionState:
    """Return the state after ``command``; the same object where it changes nothing.

    Raises:
        CommandError: where the state doesn't allow the command; the message says why.
    """
    seq = state.seq + 1
    match command:
        case Undo():
            if not state.past:
                raise CommandError("there is nothing to undo")
            _check_review_kept(state.present, state.past[-1], context)
            return SessionState(
                state.past[-1], state.past[:-1], (*state.future, state.present), seq
            )
        case Redo():
            if not state.future:
                raise CommandError("there is nothing to redo")
            _check_review_kept(state.present, state.future[-1], context)
            past = (*state.past, state.present)[-MAX_UNDO:]
            return SessionState(state.future[-1], past, state.future[:-1], seq)
        case RecordSegmentation() | Saved() | Placed():
            amended = amend(state.present, command, context)
            if amended is state.present:
                return state
            return replace(state, present=amended, seq=seq)
        case _:
            after = edit(state.present, command, context)
            if after is state.present:
                return state
            return SessionState(after, (*state.past, state.present)[-MAX_UNDO:], (), seq)


def replay(
    commands: Iterable[tuple[int, Command, Context]], state: SessionState | None = None
) -> SessionState:
    """Return the state after stored commands.

    Args:
        commands: (seq, command, context) in order.
        state: where to begin; the empty state where it is None.
    """
    state = SessionState() if state is None else state
    for seq, command, context in commands:
        state = apply(state, command, context)
        if state.seq != seq:
            state = replace(state, seq=seq)
    return state


def needed_jobs(state: SessionState) -> tuple[JobRequest, ...]:
    """Return the jobs that the present document needs."""
    document = state.present
    if document.prompts and not document.segmentation_current:
        return (JobRequest("segment", document.key),)
    return ()


def _check_review_kept(before: Document, after: Document, context: Context) -> None:
    """Check that an annotator doesn't undo a reviewer's decision."""
    decided = {"accepted", "rejected"}
    if (
        context.role == "annotator"
        and before.review != after.review
        and decided & {before.review.state, after.review.state}
    ):
        raise CommandError("only a reviewer may undo or redo a review")
    if context.role == "annotator" and len(before.comments) != len(after.comments):
        raise CommandError("only a reviewer may undo or redo a comment")
