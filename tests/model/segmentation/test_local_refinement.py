"""Small parts are answered on the nodes themselves."""

from pathlib import Path

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.data.simulated.scans import build, scan
from model.evaluation.segmentation_clicks import partnet_objects
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.local_refinement import SMALL
from model.segmentation.prompts import Click, Prompts, Region, deepest, iou, next_click

BUTTONS = np.array([(x, y) for y in (-0.05, 0.0, 0.05) for x in (-0.15, -0.05, 0.05, 0.15)])
RADIUS = 0.006
Remote = tuple[DefaultSession, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def remote() -> Remote:
    """A flat box with twelve red buttons of some sixty points each, painted on."""
    rng = np.random.default_rng(5)
    low, high = np.array([-0.2, -0.1, -0.01]), np.array([0.2, 0.1, 0.01])
    points = rng.uniform(low, high, (80_000, 3))
    top = rng.random(len(points)) < 0.9
    points[top, 2] = np.where(rng.random(top.sum()) < 0.5, 0.01, -0.01)
    points[~top, 0] = np.where(rng.random((~top).sum()) < 0.5, -0.2, 0.2)
    apart = np.linalg.norm(points[:, None, :2] - BUTTONS[None], axis=2)
    labels = np.where((apart.min(1) < RADIUS) & (points[:, 2] > 0.009), apart.argmin(1) + 1, 0)
    colors = np.where(labels[:, None] > 0, [200, 30, 30], [90, 90, 95]).astype(np.uint8)
    cloud = PointCloud(points.astype(np.float32), None, colors)
    return DefaultSegmenter().encode(Asset("remote", cloud=cloud)), points, labels


def click(points: np.ndarray, index: int, part: int, positive: bool = True) -> Click:
    return Click(points[index], part, positive, index)


def played(
    session: DefaultSession, labels: np.ndarray, parts: list[int], most: int = 3
) -> list[float]:
    """IoU of each part after some clicks; ``artiworld bench segment`` has many objects."""
    points, out = session.asset.element_centers, []
    for part in parts:
        truth = labels == part
        clicks = [click(points, deepest(points, truth), 1)]
        for _ in range(most - 1):
            found = next_click(points, truth, session.segment(Prompts(tuple(clicks))).labels == 1)
            if found is None:
                break
            clicks.append(click(points, found[0], 1, found[1]))
        out.append(iou(session.segment(Prompts(tuple(clicks))).labels == 1, truth))
    return out


def small_parts(labels: np.ndarray, least: float = 0.0) -> list[int]:
    """Those of more than ``least`` of all points that are looked at closely."""
    share = np.bincount(labels[labels >= 0]) / len(labels)
    return np.flatnonzero((share > least) & (share < SMALL)).tolist()


def without(session: DefaultSession) -> DefaultSession:
    """The same without local refinement."""
    return DefaultSession(session.asset, session.encoding, session.solver, refine=False)


def test_small_parts_have_their_own_outline() -> None:
    data = scan(build(900_011), 100_000, "outside", 0.0, 900_011)
    session = DefaultSegmenter().encode(Asset("composite", cloud=data.cloud))
    parts = small_parts(data.labels, 0.003)
    assert len(parts) >= 3
    assert np.mean(played(session, data.labels, parts)) > 0.9


def test_buttons_of_a_real_remote(shared_data: Path) -> None:
    """The knobs and buttons of a PartNet-Mobility object, 24 to 200 points of 100k each."""
    found = partnet_objects(shared_data / "partnet_mobility", "all", 100_000, 14, 20, 5, 0)
    item = next(item for item in found if item.name == "101352")
    session = DefaultSegmenter().encode(item.asset)
    parts = [part for part in item.parts if part in small_parts(item.labels)]
    assert len(parts) >= 3
    close, plain = (played(s, item.labels, parts) for s in (session, without(session)))
    assert np.mean(close) > 0.8 and np.mean(close) > np.mean(plain) + 0.1


def test_small_parts_of_a_real_mesh(shared_data: Path) -> None:
    """Three parts of a PartNet table, 0.12 % of its surface and 1528 faces each."""
    found = partnet_objects(shared_data / "partnet_mobility", "mesh", 1, 14, 20, 5, 3)
    item = next(item for item in found if item.name == "26800")
    session = DefaultSegmenter().encode(item.asset)
    assert session.refinement is not None
    close, plain = (played(s, item.labels, [2, 3, 4], 1) for s in (session, without(session)))
    assert min(close) > 0.8 and np.mean(close) > np.mean(plain) + 0.1


def test_buttons_are_told_from_what_they_are_painted_on(remote: Remote) -> None:
    session, _, labels = remote
    assert 40 < np.bincount(labels)[1:].mean() < 80
    assert np.mean(played(session, labels, small_parts(labels)[:4])) > 0.95


def test_undo_gives_what_was_there(remote: Remote) -> None:
    session, points, labels = remote
    first = click(points, deepest(points, labels == 6), 1)
    second = click(points, deepest(points, labels == 7), 2)
    away = np.linalg.norm(points - points[first.element], axis=1)
    border = np.flatnonzero((labels == 0) & (away < 1.3 * RADIUS))
    third = click(points, int(border[0]), 1)
    one = session.segment(Prompts((first, second))).labels
    two = session.segment(Prompts((first, second, third))).labels
    assert two[third.element] == 1 and two[second.element] == 2
    assert np.array_equal(session.segment(Prompts((first, second))).labels, one)
    fresh = DefaultSession(session.asset, session.encoding, session.solver)
    assert np.array_equal(fresh.segment(Prompts((first, second, third))).labels, two)


def test_what_a_small_part_leaves_goes_to_what_is_round_it(remote: Remote) -> None:
    session, points, labels = remote
    everything = Region(1, np.arange(len(points)))
    button = click(points, deepest(points, labels == 6), 2)
    found = session.segment(Prompts((everything, button))).labels
    assert set(np.unique(found)) == {1, 2}
    assert iou(found == 2, labels == 6) > 0.8


def test_a_part_that_grows_leaves_its_neighborhood(remote: Remote) -> None:
    session, points, labels = remote
    assert session.refinement is not None
    first = click(points, deepest(points, labels == 6), 1)
    board = Region(1, np.flatnonzero(labels == 0))
    found = session.segment(Prompts((first, board))).labels
    assert (found[labels == 0] == 1).all() and found[first.element] == 1
    back = Region(1, np.flatnonzero(labels == 0), positive=False)
    found = session.segment(Prompts((first, board, back))).labels
    assert found[first.element] == 1 and not (found[labels == 0] == 1).any()


def test_tab_offers_masks_of_both(remote: Remote) -> None:
    session, points, labels = remote
    prompts = Prompts((click(points, deepest(points, labels == 6), 1),))
    shown = session.segment(prompts).labels == 1
    masks = session.candidates(prompts, 1)
    assert len(masks) >= 2 and all(iou(mask, shown) < 0.95 for mask in masks)
    assert max(mask.sum() for mask in masks) > 0.02 * len(points)
    assert all(mask[prompts.items[0].element] for mask in masks)  # type: ignore[union-attr]
