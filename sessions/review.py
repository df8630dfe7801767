"""Annotation and review of an object: states, roles, allowed transitions; their records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from model.core.errors import CommandError

ReviewState = Literal["todo", "in_progress", "predicted", "submitted", "accepted", "rejected"]
RejectReason = Literal["range", "axis", "type", "parts", "not_articulated", "other"]
Role = Literal["annotator", "reviewer", "manager"]
Action = Literal[
    "annotate", "adjust", "predict", "submit", "accept", "reject", "reopen", "comment", "resolve"
]


class NotPermittedError(CommandError):
    """The person may not do this, whatever the state."""


REVIEW_STATES: tuple[ReviewState, ...] = get_args(ReviewState)
REJECT_REASONS: tuple[RejectReason, ...] = get_args(RejectReason)
ACTIONS: tuple[Action, ...] = get_args(Action)
ROLES: tuple[Role, ...] = get_args(Role)
"""Each may do what those before it may."""

TRANSITIONS: Mapping[Action, Mapping[ReviewState, ReviewState]] = {
    # Prompts, parts and the frame: what was predicted before no longer describes them.
    "annotate": {
        "todo": "in_progress",
        "in_progress": "in_progress",
        "predicted": "in_progress",
        "submitted": "in_progress",
        "rejected": "in_progress",
    },
    # Names and joints: a prediction that a person corrects is still a prediction to review.
    "adjust": {
        "todo": "in_progress",
        "in_progress": "in_progress",
        "predicted": "predicted",
        "submitted": "submitted",
        "rejected": "in_progress",
    },
    "predict": {
        "todo": "predicted",
        "in_progress": "predicted",
        "predicted": "predicted",
        "submitted": "predicted",
        "rejected": "predicted",
    },
    "submit": {"in_progress": "submitted", "predicted": "submitted", "rejected": "submitted"},
    "accept": {
        "in_progress": "accepted",
        "predicted": "accepted",
        "submitted": "accepted",
        "rejected": "accepted",
    },
    "reject": {
        "todo": "rejected",
        "in_progress": "rejected",
        "predicted": "rejected",
        "submitted": "rejected",
        "accepted": "rejected",
        "rejected": "rejected",
    },
    "reopen": {
        "accepted": "in_progress",
        "submitted": "in_progress",
        "rejected": "in_progress",
    },
    "comment": {state: state for state in REVIEW_STATES},
    "resolve": {state: state for state in REVIEW_STATES if state != "accepted"},
}
"""Action → state before → state after. All else is refused."""

PERMITTED: Mapping[Role, frozenset[Action]] = {
    "annotator": frozenset({"annotate", "adjust", "predict", "submit", "resolve"}),
    "reviewer": frozenset(ACTIONS),
    "manager": frozenset(ACTIONS),
}
"""The permitted actions of each role. A person who works alone is a reviewer."""


@dataclass(frozen=True)
class ReviewRecord:
    """The state of review.

    Attributes:
        state: see :data:`REVIEW_STATES`.
        by, at: author and time (ISO 8601, UTC) of the last change.
        reason: why it was rejected, else None.
        comment: the reviewer's comment.
        problems: the warnings and errors known when it was accepted.
        override: why it was accepted despite errors, else "".
        decided_at: time of the scene's decision that led to the state, else "".
        joint, place: what the comment is about; see :class:`~sessions.commands.Reject`.
    """

    state: ReviewState = "todo"
    by: str = ""
    at: str = ""
    reason: RejectReason | None = None
    comment: str = ""
    problems: tuple[str, ...] = ()
    override: str = ""
    decided_at: str = ""
    joint: str = ""
    place: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class CommentRecord:
    """A reviewer's comment.

    Attributes:
        number: from 1, in the order in which they were given.
        text: human-readable.
        joint, place: what it is about; see :class:`~sessions.commands.Reject`.
        by, at: author and time (ISO 8601, UTC).
        done: whether the annotator dealt with it.
    """

    number: int
    text: str
    joint: str
    place: tuple[float, float, float] | None
    by: str
    at: str
    done: bool = False


def transition(state: ReviewState, action: Action, role: Role = "reviewer") -> ReviewState:
    """Return the state after ``action``.

    Raises:
        CommandError: where the role may not do it, or the state doesn't allow it.
    """
    if action not in PERMITTED[role]:
        raise NotPermittedError(f"only a reviewer may {action} an object; your role is {role}")
    after = TRANSITIONS[action].get(state)
    if after is not None:
        return after
    if state == "accepted":
        raise CommandError("the object is accepted; reopen it before you change it")
    before = ", ".join(TRANSITIONS[action])
    raise CommandError(f"can't {action} an object that is {state}; it would have to be {before}")
