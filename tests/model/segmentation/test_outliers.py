"""Points in the air, as depth cameras leave them: no surface, and no click on one is about more."""

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.segmentation.default import DefaultSegmenter
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.prompt_steps import ClickStep, resolve, surface_steps
from model.segmentation.prompts import BASE, Click, Prompts

STRAY = 150
DOOR, BODY = (0.25, -0.02, 0.55), (0.5, 0.2, 0.8)


def with_stray(made, seed: int) -> Asset:
    """The cabinet, then points in the air around it."""
    cloud, rng = made.asset.cloud, np.random.default_rng(seed)
    air = rng.uniform((-0.3, -0.5, -0.2), (1.3, 0.9, 1.1), (3 * STRAY, 3))
    outside = (np.abs(air - (0.5, 0.22, 0.4)) > (0.56, 0.34, 0.46)).any(1)
    air = air[outside][:STRAY].astype(np.float32)
    colors = np.concatenate([cloud.colors, np.full((len(air), 3), 90, np.uint8)])
    whole = PointCloud(np.concatenate([cloud.points, air]), colors=colors)
    return Asset("scan", cloud=whole)


@pytest.fixture(scope="module")
def scan(make_cabinet_cloud) -> tuple[Asset, np.ndarray]:
    made = make_cabinet_cloud(noise=0.001)
    return with_stray(made, 1), made.labels


@pytest.fixture(scope="module")
def session(scan):
    return DefaultSegmenter().encode(scan[0])


def click(place, part: int = 1, positive: bool = True, element: int | None = None) -> Click:
    return Click(place, part, positive, element)


def test_points_in_the_air_are_no_nodes(scan) -> None:
    asset, labels = scan
    nodes = nodes_of_asset(asset)
    floating = np.arange(len(labels), asset.element_count)
    assert len(nodes) <= len(labels) + 5
    assert np.isin(nodes.elements.outliers, floating).all()
    assert len(nodes.elements.outliers) > 0.95 * STRAY
    # Each goes with what is nearest, and none stands for a node.
    apart = np.linalg.norm(asset.cloud.points[floating][:, None] - nodes.points[None, ::7], axis=2)
    own = nodes.points[nodes.elements.node_of_element[floating]]
    assert (np.linalg.norm(asset.cloud.points[floating] - own, axis=1) <= apart.min(1) + 1e-6).all()
    assert not np.isin(nodes.elements.element_of_node, nodes.elements.outliers).any()


@pytest.mark.parametrize("count", [100, 300, 1000])
def test_what_is_seen_at_a_slant_stays(count: int) -> None:
    """A side that was hardly seen has few points, but is a surface."""
    rng = np.random.default_rng(0)
    front = np.c_[rng.random(20_000), np.zeros(20_000), rng.random(20_000)]
    side = np.c_[np.zeros(count), rng.random(count), rng.random(count)]
    cloud = PointCloud(np.concatenate([front, side]).astype(np.float32))
    assert len(nodes_of_asset(Asset("corner", cloud=cloud)).elements.outliers) <= 0.15 * count


@pytest.mark.parametrize("count", [1, 2, 21, 200])
def test_few_points_are_all_kept(count: int) -> None:
    points = np.random.default_rng(0).random((count, 3)).astype(np.float32)
    nodes = nodes_of_asset(Asset("few", cloud=PointCloud(points)))
    assert len(nodes) + len(nodes.elements.outliers) == count
    assert nodes_of_asset(Asset("same", cloud=PointCloud(points * 0))).elements.node_count == count


def test_points_in_the_air_make_no_answer_worse(make_cabinet_cloud) -> None:
    made = make_cabinet_cloud(noise=0.001)
    places = ((1, DOOR), (2, (0.75, -0.02, 0.2)))

    def right(asset: Asset) -> list[float]:
        session, found = DefaultSegmenter().encode(asset), []
        for part, place in places:
            answer = session.segment(Prompts((click(place),))).labels[: len(made.labels)] == 1
            true = made.labels == part
            found.append((answer & true).sum() / (answer | true).sum())
        return found

    # Which points make a cell changes with a few of them, so single answers come and go a little.
    clean = np.array(right(made.asset))
    stray = np.array([right(with_stray(made, seed)) for seed in (1, 2)])
    assert (stray > clean - 0.08).all()


def test_a_click_on_one_is_about_it_alone(scan, session) -> None:
    asset, _ = scan
    points, stray = asset.cloud.points, session.encoding.nodes.elements.outliers
    first = click(DOOR)
    before = session.segment(Prompts((first,))).labels
    inside = stray[before[stray] == 1]
    outside = stray[before[stray] != 1]
    assert len(inside) and len(outside)
    for element, positive in ((int(inside[0]), False), (int(outside[0]), True)):
        more = click(points[element], 1, positive, element)
        after = session.segment(Prompts((first, more))).labels
        assert (after[element] == 1) == positive
        assert np.flatnonzero(after != before).tolist() == [element]
        assert np.array_equal(session.segment(Prompts((first,))).labels, before)


def test_the_first_click_of_a_part_is_about_what_is_nearest(scan, session) -> None:
    asset, labels = scan
    points, stray = asset.cloud.points, session.encoding.nodes.elements.outliers
    element = int(stray[np.abs(points[stray] - DOOR).sum(1).argmin()])
    answer = session.segment(Prompts((click(points[element], 1, True, element),))).labels
    assert answer[element] == 1 and (answer[: len(labels)] == 1).sum() > 100


def test_which_clicks_tell(scan, session) -> None:
    asset, _ = scan
    points, stray = asset.cloud.points, int(session.encoding.nodes.elements.outliers[0])
    on = [
        click(points[stray], part, yes, stray) for part, yes in ((1, True), (2, False), (0, True))
    ]
    prompts = Prompts((on[0], click(DOOR), on[1], click(BODY, BASE), on[2], on[0]))
    steps = resolve(asset, session.encoding.nodes, prompts)
    assert [isinstance(s, ClickStep) and s.outlier for s in steps] == [1, 0, 1, 0, 1, 1]
    assert surface_steps(steps) == (steps[0], steps[1], steps[3])
