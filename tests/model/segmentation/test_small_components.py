"""On scans small pieces in front of one part go with it unless a prompt says otherwise."""

import numpy as np
import pytest

from model.segmentation.default import DefaultSession
from model.segmentation.mask_tools import hover
from model.segmentation.prompts import Click, Prompts, Region
from tests.model.demos import demo_truth, encoded_demo

DOOR = 1
Oven = tuple[DefaultSession, np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def oven() -> Oven:
    """The bundled scan's session, its points, its true parts, and the bar of the door's handle."""
    session, (labels, _) = encoded_demo("oven_scan"), demo_truth("oven_scan")
    points = session.asset.element_centers
    low, high = np.array([-0.23, -0.43, 0.67]), np.array([0.31, -0.355, 0.73])
    bar = (labels == DOOR) & ((points > low) & (points < high)).all(1)
    assert bar.sum() > 2000
    return session, points, labels, bar


def click(points: np.ndarray, where: np.ndarray, part: int, positive: bool = True) -> Click:
    """On the point in the middle of ``where``."""
    middle = np.median(points[where], axis=0)
    index = int(np.flatnonzero(where)[np.linalg.norm(points[where] - middle, axis=1).argmin()])
    return Click(points[index], part, positive, index)


def test_a_handle_goes_with_the_door_behind_it(oven: Oven) -> None:
    session, points, labels, bar = oven
    door = Region(DOOR, np.flatnonzero((labels == DOOR) & ~bar))
    drawn = session.segment(Prompts((door,))).labels
    assert (drawn[bar] == 0).mean() > 0.8  # who draws knows what belongs to it
    confirmed = click(points, (labels == DOOR) & ~bar, DOOR)
    found = session.segment(Prompts((door, confirmed))).labels
    assert (found[bar] == DOOR).mean() > 0.98
    assert not (found[labels == 0] == DOOR).mean() > 0.02
    knobs = labels > 2
    assert not (found[knobs] == DOOR).any()  # they touch the panel, not the door


def test_what_a_click_says_of_it_holds(oven: Oven) -> None:
    session, points, labels, bar = oven
    door = Region(DOOR, np.flatnonzero((labels == DOOR) & ~bar))
    confirmed = click(points, (labels == DOOR) & ~bar, DOOR)
    not_this = click(points, bar, DOOR, positive=False)
    found = session.segment(Prompts((door, confirmed, not_this))).labels
    assert (found[bar] == 0).mean() > 0.95
    own = click(points, bar, 2)
    found = session.segment(Prompts((door, confirmed, own))).labels
    assert found[own.element] == 2 and (found[bar] == 2).mean() > 0.5
    base = Region(0, np.flatnonzero(bar))
    assert (session.segment(Prompts((door, confirmed, base))).labels[bar] == 0).all()


def test_what_was_taken_back_says_nothing(oven: Oven) -> None:
    """Door and drawer in one, the drawer taken away and made its own: its handle goes with it."""
    session, points, labels, _ = oven
    low, high = np.array([-0.16, -0.42, 0.13]), np.array([0.16, -0.345, 0.23])
    grip = (labels == 2) & ((points > low) & (points < high)).all(1)
    both = Region(DOOR, np.flatnonzero((labels == DOOR) | (labels == 2)))
    taken_back = Region(DOOR, np.flatnonzero(labels == 2), positive=False)
    drawer = Region(2, np.flatnonzero((labels == 2) & ~grip))
    confirmed = click(points, (labels == 2) & ~grip, 2)
    found = session.segment(Prompts((both, taken_back, drawer, confirmed))).labels
    assert grip.sum() > 1000 and (found[grip] == 2).mean() > 0.9


def test_half_of_an_object_takes_no_other_half(oven: Oven) -> None:
    """What is not small beside the part stays, however much it lies beside it alone."""
    session, points, labels, bar = oven
    panel = Region(DOOR, np.flatnonzero(labels != DOOR))
    confirmed = click(points, labels == 0, DOOR)
    found = session.segment(Prompts((panel, confirmed))).labels
    assert (found[(labels == DOOR) & ~bar] == 0).mean() > 0.98


def test_the_preview_shows_what_the_click_takes(oven: Oven) -> None:
    session, points, labels, bar = oven
    for where in (labels == 2, labels == 3, bar):
        at = click(points, where, 1)
        assert at.element is not None
        taken = session.segment(Prompts((at,))).labels == 1
        shown = hover(session, points[at.element], at.element)
        assert (shown ^ taken).sum() <= 0.01 * taken.sum()
