"""A session's state, and the effect of commands on it. Pure: replaying the log gives the state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import ClassVar

from model.core.errors import ArtiworldError, CommandError
from sessions.document import Document
from sessions.review import Action, ReviewRecord, ReviewState, Role, transition

MAX_UNDO = 1000
SOURCE = "source file"
"""Author of the parts and joints that a file holds."""


@dataclass(frozen=True)
class SessionState:
    """The present document, and the documents of undo and redo.

    Attributes:
        present: the present decisions.
        past: former documents, oldest first, at most ``MAX_UNDO``.
        future: documents taken back; the next one to redo is last.
        seq: number of the last command that is in it; 0 before the first.
        opened: number of the first steps, by which the file was opened.
    """

    present: Document = field(default_factory=Document)
    past: tuple[Document, ...] = ()
    future: tuple[Document, ...] = ()
    seq: int = 0
    opened: int = 0

    @property
    def can_undo(self) -> bool:
        """True if there is a step to undo; joints that the file holds stay."""
        steps = (*self.past, self.present)[self.opened : self.opened + 1]
        return len(self.past) > (self.opened if steps and steps[0].tree is not None else 0)

    @property
    def can_redo(self) -> bool:
        """True if there is a step to redo."""
        return bool(self.future)

    @property
    def undo_label(self) -> str:
        """Label of undo, as "Undo: add click, part 1"; "" where there is nothing."""
        return f"Undo: {self.present.label}" if self.can_undo else ""

    @property
    def redo_label(self) -> str:
        """Label of redo, as "Redo: add click, part 1"; "" where there is nothing."""
        return f"Redo: {self.future[-1].label}" if self.future else ""


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


class Command:
    """A decision of a person, or the result of a job, as a small frozen value with a JSON form.

    Stored commands are kept for good: a kind or a field is never renamed, and new fields have
    defaults.

    Attributes:
        KINDS: all commands by their stored name.
        kind: the stored name.
    """

    KINDS: ClassVar[dict[str, type[Command]]] = {}
    kind: ClassVar[str]
    _action: ClassVar[Action] = "annotate"
    _words: ClassVar[str]

    def __init_subclass__(
        cls, kind: str = "", action: Action | None = None, words: str = ""
    ) -> None:
        """Enter a command.

        Args:
            kind: its stored name; "" for a base of several.
            action: that of its base where it is None.
            words: of what it does, with fields in braces; "" is its stored name.
        """
        cls._action = action or cls._action
        if kind:
            cls.kind, cls._words = kind, words or kind.replace("_", " ")
            Command.KINDS[kind] = cls

    @property
    def action(self) -> Action:
        """Its place in the course of a review."""
        return self._action

    def describe(self) -> str:
        """Return what it does, in a few words for an undo button or a list of edits."""
        return self._words.format_map(vars(self))

    def edit(self, document: Document, context: Context) -> Document:
        """Return the document after it; the same object where it changes nothing.

        Raises:
            CommandError: where the document doesn't allow it; the message says why.
        """
        raise NotImplementedError

    def review(self, before: ReviewRecord, state: ReviewState, context: Context) -> ReviewRecord:
        """Return the record of the review after it, in the state that its action leads to."""
        if state == before.state:
            return before
        # The reviewer's comment stays while the annotator corrects the object.
        return replace(before, state=state, by=context.who, at=context.at)

    def apply(self, state: SessionState, context: Context) -> SessionState:
        """Return the state after it; see :func:`apply`."""
        before = state.present
        try:
            after = self.edit(before, context)
        except CommandError:
            raise
        except ArtiworldError as error:
            raise CommandError(str(error)) from error
        if after is before:
            return state
        review = transition(before.review.state, self.action, context.role)
        edited = self.action in ("annotate", "submit")
        after = replace(
            after,
            review=self.review(before.review, review, context),
            annotator=context.who if edited else before.annotator,
            edits=before.edits + 1,
            label=self.describe(),
        )
        opens = context.who == SOURCE and len(state.past) == state.opened
        past = (*state.past, before)[-MAX_UNDO:]
        return SessionState(after, past, (), state.seq + 1, state.opened + opens)


class JobResult(Command):
    """Amends the present document; no undo step. The server lets nobody send it."""

    def apply(self, state: SessionState, context: Context) -> SessionState:
        amended = self.edit(state.present, context)
        if amended is state.present:
            return state
        return replace(state, present=amended, seq=state.seq + 1)


@dataclass(frozen=True)
class Undo(Command, kind="undo"):
    """Undo the last step."""

    def apply(self, state: SessionState, context: Context) -> SessionState:
        if not state.past:
            raise CommandError("there is nothing to undo")
        _check_review_kept(state.present, state.past[-1], context)
        future = (*state.future, state.present)
        past = state.past[:-1]
        opened = min(state.opened, len(past))
        return SessionState(state.past[-1], past, future, state.seq + 1, opened)


@dataclass(frozen=True)
class Redo(Command, kind="redo"):
    """Redo the step that was undone last."""

    def apply(self, state: SessionState, context: Context) -> SessionState:
        if not state.future:
            raise CommandError("there is nothing to redo")
        _check_review_kept(state.present, state.future[-1], context)
        past = (*state.past, state.present)[-MAX_UNDO:]
        present, future = state.future[-1], state.future[:-1]
        return replace(state, present=present, past=past, future=future, seq=state.seq + 1)


def apply(state: SessionState, command: Command, context: Context) -> SessionState:
    """Return the state after ``command``; the same object where it changes nothing.

    Raises:
        CommandError: where the state doesn't allow the command; the message says why.
    """
    return command.apply(state, context)


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
