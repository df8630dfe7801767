"""The contract of :class:`Segmenter`, run against every registered one."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.errors import ConfigurationError, PromptError
from model.core.geometry import PointCloud
from model.segmentation.adapters.example import BallSegmenter
from model.segmentation.prompts import BASE, Click, Prompts, Region
from model.segmentation.registry import (
    SegmentationSession,
    Segmenter,
    load_segmenter,
    segmenter_names,
)
from tests.builders import Labelled, cabinet_cloud, cabinet_mesh

NAMES = [*segmenter_names(), "point-sam", "balls"]
"""The registered ones, Point-SAM with random weights, and the example of a plug-in."""


@functools.cache
def load(name: str) -> Segmenter:
    if name == "balls":
        return BallSegmenter()
    if name == "point-sam":
        pytest.importorskip("torch", reason="PyTorch is not installed")
        from tests.model.segmentation.test_point_sam import write_weights

        path = Path(tempfile.mkdtemp()) / "model.safetensors"
        write_weights(path)
        return load_segmenter(f"point-sam:{path}")
    return load_segmenter(name)


@pytest.fixture(scope="session", params=["cloud", "mesh"])
def labelled(request) -> Labelled:
    """A small cloud: no answer has to be good here."""
    return cabinet_cloud(3000) if request.param == "cloud" else cabinet_mesh()


@pytest.fixture(scope="session")
def sessions(labelled):
    made: dict[str, SegmentationSession] = {}

    def get(name: str) -> SegmentationSession:
        if name not in made:
            made[name] = load(name).encode(labelled.asset)
        return made[name]

    return get


def click(labelled, element: int, part: int, positive: bool = True) -> Click:
    return Click(labelled.asset.element_centers[element], part, positive, int(element))


def deepest(labelled, part: int) -> int:
    """The element of the part that is nearest to the middle of its door."""
    centers = labelled.asset.element_centers
    inside = np.nonzero(labelled.labels == part)[0]
    middle = {1: (0.25, -0.02, 0.5), 2: (0.75, -0.02, 0.5), 0: (0.5, 0.25, 0.8)}[part]
    return int(inside[np.linalg.norm(centers[inside] - middle, axis=1).argmin()])


@pytest.mark.parametrize("name", NAMES)
class TestEverySegmenter:
    def test_fits_the_protocols(self, name, sessions):
        assert isinstance(load(name), Segmenter)
        assert isinstance(sessions(name), SegmentationSession)
        assert load(name).name

    def test_without_prompts_all_is_base(self, name, sessions, labelled):
        answer = sessions(name).segment(Prompts())
        assert answer.labels.shape == (labelled.asset.element_count,)
        assert (answer.labels == BASE).all()

    def test_every_element_gets_a_part_that_was_named(self, name, sessions, labelled):
        prompts = Prompts(tuple(click(labelled, deepest(labelled, p), p) for p in (1, 2, 0)))
        answer = sessions(name).segment(prompts)
        assert set(np.unique(answer.labels)) <= {0, 1, 2}
        assert set(answer.parts) == {0, 1, 2}

    def test_clicked_elements_are_on_their_side(self, name, sessions, labelled):
        rng = np.random.default_rng(5)
        elements = rng.choice(labelled.asset.element_count, 8, replace=False)
        parts = [1, 2, 1, 3, 2, 0, 1, 2]
        positive = [True, True, False, True, False, True, True, False]
        items = tuple(
            click(labelled, e, p, s) for e, p, s in zip(elements, parts, positive, strict=True)
        )
        session = sessions(name)
        for count in range(1, len(items) + 1):
            labels = session.segment(Prompts(items[:count])).labels
            for element, part, sign in list(zip(elements, parts, positive, strict=True))[:count]:
                assert (labels[element] == part) == sign, (count, element, part, sign)

    def test_regions_count_exactly(self, name, sessions, labelled):
        rng = np.random.default_rng(6)
        chosen = rng.choice(labelled.asset.element_count, 60, replace=False)
        first, second = Region(1, chosen[:40]), Region(2, chosen[20:])
        labels = sessions(name).segment(Prompts((first, second))).labels
        assert (labels[chosen[:20]] == 1).all()
        assert (labels[chosen[20:]] == 2).all()
        labels = sessions(name).segment(Prompts((first, second, Region(1, chosen, False)))).labels
        assert not (labels[chosen] == 1).any()

    def test_a_region_stays_when_its_part_is_clicked_elsewhere(self, name, sessions, labelled):
        members = np.nonzero(labelled.labels == 2)[0]
        prompts = Prompts((Region(3, members), click(labelled, deepest(labelled, 1), 1)))
        labels = sessions(name).segment(prompts).labels
        assert (labels[members] == 3).all()

    def test_the_later_click_wins(self, name, sessions, labelled):
        element = deepest(labelled, 1)
        items = (click(labelled, element, 1), click(labelled, element, 2))
        assert sessions(name).segment(Prompts(items)).labels[element] == 2
        assert sessions(name).segment(Prompts(items[::-1])).labels[element] == 1

    def test_same_prompts_same_labels_whatever_was_asked_before(self, name, sessions, labelled):
        order = (1, 2, 0, 1, 2)
        rng = np.random.default_rng(7)
        elements = [int(rng.choice(np.nonzero(labelled.labels == p)[0])) for p in order]
        items = tuple(click(labelled, e, p) for e, p in zip(elements, order, strict=True))
        session = sessions(name)
        forward = [session.segment(Prompts(items[:k])).labels for k in range(len(items) + 1)]
        for k in reversed(range(len(items) + 1)):  # undo, click by click
            assert np.array_equal(session.segment(Prompts(items[:k])).labels, forward[k])
        fresh = load(name).encode(labelled.asset)
        assert np.array_equal(fresh.segment(Prompts(items)).labels, forward[-1])
        assert np.array_equal(fresh.segment(Prompts(items[:2])).labels, forward[2])

    def test_a_click_without_an_element_finds_the_nearest(self, name, sessions, labelled):
        element = deepest(labelled, 1)
        known = click(labelled, element, 1)
        unknown = Click(known.position, 1)
        session = sessions(name)
        assert np.array_equal(
            session.segment(Prompts((known,))).labels, session.segment(Prompts((unknown,))).labels
        )

    def test_candidates_hold_the_click(self, name, sessions, labelled):
        element = deepest(labelled, 1)
        for mask in sessions(name).candidates(Prompts((click(labelled, element, 1),)), 1):
            assert mask.shape == (labelled.asset.element_count,) and mask.dtype == bool
            assert mask[element]

    def test_an_unknown_element_is_refused(self, name, sessions, labelled):
        count = labelled.asset.element_count
        with pytest.raises(PromptError, match=str(count)):
            sessions(name).segment(Prompts((Click((0, 0, 0), 1, True, count),)))
        with pytest.raises(PromptError, match=str(count)):
            sessions(name).segment(Prompts((Region(1, np.array([count])),)))

    @pytest.mark.parametrize("count", [1, 2, 5, 30])
    def test_tiny_clouds(self, name, count):
        points = np.random.default_rng(0).random((count, 3)).astype(np.float32)
        session = load(name).encode(Asset("tiny", cloud=PointCloud(points)))
        labels = session.segment(Prompts((Click(points[0], 1, True, 0),))).labels
        assert labels[0] == 1
        labels = session.segment(
            Prompts((Click(points[0], 1, True, 0), Click(points[0], 1, False, 0)))
        ).labels
        assert labels[0] == 0

    def test_coinciding_points(self, name):
        points = np.zeros((50, 3), np.float32)
        session = load(name).encode(Asset("one place", cloud=PointCloud(points)))
        assert session.segment(Prompts((Click((0, 0, 0), 1, True, 7),))).labels[7] == 1


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(ConfigurationError, match="default"):
        load_segmenter("nobody")
