"""Clicks on what is seen."""

import numpy as np
import pytest

from model.evaluation.segmentation import BenchConfig, run
from model.evaluation.segmentation_clicks import (
    Picture,
    largest_component,
    middle_of,
    picture_of,
    visible_click_ious,
)
from model.segmentation.default import DefaultSegmenter
from model.segmentation.prompts import PartSegmentation, Prompts

AHEAD = (0.0, -1.0, 0.0)


@pytest.fixture(scope="module")
def picture(mesh_cabinet) -> Picture:
    return picture_of(mesh_cabinet.asset, AHEAD)


def test_the_middle_of_the_largest_piece() -> None:
    region = np.zeros((20, 30), bool)
    region[2:9, 3:14] = True
    region[12:14, 20:29] = True
    piece, size = largest_component(region)
    assert size == 77 and not piece[12:].any()
    row, column = middle_of(piece)
    assert row == 5 and 6 <= column <= 10
    assert largest_component(np.zeros((4, 4), bool))[1] == 0


def test_a_picture_shows_the_front_and_not_the_back(picture, mesh_cabinet) -> None:
    center = mesh_cabinet.asset.element_centers
    seen = np.unique(picture.element[picture.element >= 0])
    assert np.abs(center[seen, 1] - 0.5).min() > 1e-3, "the back faces away"
    apart = picture.position[picture.element >= 0] - center[picture.element[picture.element >= 0]]
    assert np.linalg.norm(apart, axis=1).max() < 0.15
    share = (picture.element >= 0).mean()
    assert 0.15 < share < 0.8, "the whole object, and not much else"
    edge = np.concatenate([picture.element[0], picture.element[-1], picture.element[:, 0]])
    assert (edge < 0).all()


def test_a_scan_is_seen_as_closed_surfaces(picture, make_cabinet_cloud) -> None:
    cloud = make_cabinet_cloud(40_000)
    shown = picture_of(cloud.asset, AHEAD)
    there = shown.element >= 0
    center = cloud.asset.element_centers
    assert np.abs(shown.position[there] - center[shown.element[there]]).max() < 1e-6
    solid = picture.element >= 0
    assert there[solid].mean() > 0.99, "no gaps between dots"
    assert (there & ~solid).mean() < 0.05, "dots no larger than they need to be"
    # Each dot is on the side that is seen, and nothing shines through from behind.
    both = there & solid
    apart = np.linalg.norm(shown.position[both] - picture.position[both], axis=1)
    assert np.median(apart) < 0.02 and (apart > 0.1).mean() < 0.01


class Asked:
    """A session that knows the truth but for its first answers."""

    def __init__(self, answers: list[np.ndarray]) -> None:
        self.answers, self.prompts = answers, []

    def segment(self, prompts: Prompts) -> PartSegmentation:
        self.prompts.append(prompts)
        labels = self.answers[min(len(self.prompts), len(self.answers)) - 1]
        return PartSegmentation(labels, "asked", 0.0)


def test_what_is_wrong_is_clicked_as_what_it_is(picture, mesh_cabinet) -> None:
    truth = mesh_cabinet.labels
    area = mesh_cabinet.asset.mesh.face_areas
    wrong = truth.copy()
    wrong[truth == 2] = 0
    asked = Asked([wrong, truth])
    rounds = visible_click_ious(asked, picture, truth, area)
    assert rounds[0] == pytest.approx((0.5, 0.5)) and rounds[-1] == (1.0, 1.0)
    first, more = asked.prompts[0].clicks, asked.prompts[1].clicks
    assert [(c.part, c.positive) for c in first] == [(1, True), (2, True)]
    assert (more[2].part, more[2].positive) == (2, True)
    assert all(truth[c.element] == c.part for c in more)
    # What is too much of a part is taken away from it.
    all_ = np.where(truth == 0, np.int16(1), truth)
    asked = Asked([all_, truth])
    visible_click_ious(asked, picture, truth, area)
    last = asked.prompts[1].clicks[-1]
    assert (last.part, last.positive) == (1, False) and truth[last.element] == 0


def test_a_person_gets_the_doors(picture, mesh_cabinet, mesh_session) -> None:
    rounds = visible_click_ious(
        mesh_session, picture, mesh_cabinet.labels, mesh_cabinet.asset.mesh.face_areas
    )
    assert len(rounds) == 3
    assert rounds[0][0] > 0.8 and rounds[-1][0] > 0.9


def test_nothing_moves_nothing_is_clicked(picture, mesh_cabinet) -> None:
    asked = Asked([mesh_cabinet.labels])
    still = np.zeros_like(mesh_cabinet.labels)
    assert visible_click_ious(asked, picture, still, np.ones(len(still))) == []
    assert not asked.prompts


def test_a_person_gets_the_doors_of_a_scan(make_cabinet_cloud) -> None:
    cloud = make_cabinet_cloud(40_000)
    session = DefaultSegmenter().encode(cloud.asset)
    shown = picture_of(cloud.asset, AHEAD)
    rounds = visible_click_ious(session, shown, cloud.labels, np.ones(len(cloud.labels)))
    assert rounds[-1][0] > 0.9


@pytest.mark.parametrize("data", ["partnet-mesh", "partnet-one-sided"])
def test_the_benchmark_says_it(shared_data, data) -> None:
    few = {"limit": 1, "points": 20_000, "parts": 1, "cap": 1}
    config = BenchConfig(data=shared_data, sets=(data,), segmenters=("nearest",), **few)
    report = run(config)
    summary = report.rows[0].summary()
    assert 0 < summary["seen all@1, hidden too"] <= 1
    assert summary["seen all@1"] <= summary["seen all@3"] + 0.05
    report.print_table()
