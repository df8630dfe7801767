"""The way of an object through annotation and review."""

import itertools

import pytest

from model.core.errors import CommandError
from sessions.review import ACTIONS, REVIEW_STATES, TRANSITIONS, transition


def test_the_table_speaks_of_known_states_only():
    assert set(TRANSITIONS) == set(ACTIONS)
    for table in TRANSITIONS.values():
        assert set(table) <= set(REVIEW_STATES)
        assert set(table.values()) <= set(REVIEW_STATES)


def test_every_state_can_be_reached_and_left():
    reached = {"todo"}
    for _ in REVIEW_STATES:
        reached |= {t[s] for t in TRANSITIONS.values() for s in reached if s in t}
    assert reached == set(REVIEW_STATES)
    for state in REVIEW_STATES:
        assert any(t.get(state, state) != state for t in TRANSITIONS.values())


def test_an_accepted_object_is_changed_only_after_reopening():
    for action in ("annotate", "adjust", "predict", "accept"):
        with pytest.raises(CommandError, match="accepted; reopen it"):
            transition("accepted", action)
    assert transition("accepted", "reopen") == "in_progress"


def test_any_work_takes_up_a_rejected_object():
    for action in ("annotate", "adjust"):
        assert transition("rejected", action, "annotator") == "in_progress"


def test_only_reviewers_decide():
    for state, action in itertools.product(REVIEW_STATES, ("accept", "reject", "reopen")):
        with pytest.raises(CommandError, match="only a reviewer"):
            transition(state, action, "annotator")


def test_nothing_is_accepted_before_it_is_begun():
    with pytest.raises(CommandError, match="todo"):
        transition("todo", "accept")
