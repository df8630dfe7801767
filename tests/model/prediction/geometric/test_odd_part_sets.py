"""Random part sets with all that is degenerate, and rules that fail: a tree comes out all the same.

``ARTIWORLD_PART_SETS`` sets how many are tried; 10,000 take half an hour.
"""

import logging
import os
from functools import partial

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject, Part, SegmentedObject
from model.core.geometry import Mesh, PointCloud
from model.core.progress import Cancelled
from model.prediction.geometric import context, mechanisms, motion_scores, predictor, roles, tree
from model.prediction.geometric.predictor import GeometricPredictor
from model.prediction.geometric.sampled_object import sample_object
from tests.builders import spans
from tests.model.prediction.geometric.archetypes import THINGS

SETS = int(os.environ.get("ARTIWORLD_PART_SETS", "60"))
WORDS = "door drawer lid knob wheel hand cap seat blade screen button switch"
NAMES = (None, None, None, *WORDS.split())
CATEGORIES = (None, None, "Refrigerator", "Faucet", "Switch", "Dispenser", "Scissors", "Clock")
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
TRIANGLES = "013 032 467 475 045 051 237 276 026 064 157 173"
FACES = np.array([list(map(int, corners)) for corners in TRIANGLES.split()], np.int32)


def odd_part(rng: np.random.Generator, link: str, before: list[Part]) -> Part:
    """A box, cylinder or cloud on a coarse grid, so that steps are level and parts coincide."""
    name = NAMES[rng.integers(len(NAMES))]
    if before and rng.random() < 0.12:
        twin = before[rng.integers(len(before))]
        return Part(link, twin.mesh, twin.cloud, name)
    size = rng.choice([0, 0.02, 0.1, 0.3, 0.5, 1.0], 3)
    low = rng.choice([0, 0.1, 0.25, 0.5, 1.0], 3)
    if rng.random() < 0.2:  # flat, a line or a point
        size[rng.permutation(3)[: rng.integers(1, 4)]] = 0
    if rng.random() < 0.25:
        count = int(rng.choice([1, 2, 3, 4, 5, 10, 60, 300]))
        points = low + rng.random((count, 3)) * size
        points = np.round(points, 1) if rng.random() < 0.5 else points
        return Part(link, None, PointCloud(points.astype(np.float32)), name)
    if rng.random() < 0.2:
        turn = np.arange(12) * np.pi / 6
        ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
        k = np.arange(12)
        j = (k + 1) % 12
        sides = [(k, j, 12 + j), (k, 12 + j, 12 + k), (0 * k, k, j), (0 * k + 12, 12 + j, 12 + k)]
        faces = np.concatenate([np.stack(s, 1) for s in sides]).astype(np.int32)
        round_ = np.concatenate([ring, ring + [0, 0, 1]]) * size / 2 + low
        return Part(link, Mesh(round_, faces), None, name)
    faces = FACES if rng.random() < 0.8 else FACES[: rng.integers(1, 12)]
    angle = rng.uniform(0, 7) if rng.random() < 0.15 else 0.0
    c, s = np.cos(angle), np.sin(angle)
    turned = (CORNERS * size + low) @ [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    return Part(link, Mesh(turned, faces), None, name)


def odd_object(seed: int) -> SegmentedObject:
    rng = np.random.default_rng(seed)
    parts: list[Part] = []
    for i in range(rng.integers(1, 8)):
        parts.append(odd_part(rng, f"link_{i}", parts))
    return SegmentedObject("odd", tuple(parts), CATEGORIES[rng.integers(len(CATEGORIES))])


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few surface points: the rules see the same degenerate sets in a fifth of the time."""
    monkeypatch.setattr(predictor, "sample_object", partial(sample_object, budget=800))


@pytest.mark.usefixtures("quick")
def test_no_rule_fails_on_odd_part_sets(caplog: pytest.LogCaptureFixture) -> None:
    for seed in range(SETS):
        segmented = odd_object(seed)
        prediction = GeometricPredictor().predict(segmented)
        assert not caplog.records, (seed, caplog.text)
        assert prediction.tree is not None, seed
        ArticulatedObject("odd", segmented.parts, prediction.tree)


def test_a_front_level_with_a_door_spans_none() -> None:
    """The step between two small fronts at one height has no sign, as on an oven's knobs."""
    table = spans("0 .02 0 1 .5 1  .2 0 .49 .06 .02 .02  .225 0 .48 .01 .02 .04")  # low and size
    solids = [Mesh(CORNERS * size + low, FACES) for low, size in table]
    parts = [Part(f"link_{i}", solid) for i, solid in enumerate(solids)]
    sampled = sample_object(SegmentedObject("oven", tuple(parts)))
    part = context.PartContext(context.Assembly(sampled, 0, [-1, 0, 0]), 1)
    assert sampled.shapes[1].center[2] == sampled.shapes[2].center[2]
    assert not motion_scores.spans_doors(part)


RULES = {
    motion_scores: "spans_doors",
    roles: "motion_scores measure_features named_mechanism",
    mechanisms: "front_of",
    tree: "root_scores spanning_parents",
    predictor: "part_evidence propose joints_of",
    context.PartContext: "covers_of shut",
}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("owner", "rule"), [(owner, rule) for owner, rules in RULES.items() for rule in rules.split()]
)
def test_a_rule_that_fails_is_left_out(
    owner: object, rule: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError(0.0)

    parts = THINGS["cabinet"]().segmented(names=False).parts
    monkeypatch.setattr(owner, rule, property(broken) if rule == "shut" else broken)
    with caplog.at_level(logging.ERROR):
        prediction = GeometricPredictor().predict(SegmentedObject("cabinet", parts))
    assert prediction.tree is not None
    ArticulatedObject("cabinet", parts, prediction.tree)
    told = [p for p in prediction.problems if "KeyError" in p]
    assert bool(told) == bool(caplog.records)
    assert len(told) == len(set(told))
    if rule not in ("shut", "named_mechanism"):
        assert told


@pytest.mark.usefixtures("quick")
def test_a_cancel_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def cancelled(*_: object) -> None:
        raise Cancelled

    monkeypatch.setattr(predictor, "propose", cancelled)
    with pytest.raises(Cancelled):
        GeometricPredictor().predict(odd_object(29))
