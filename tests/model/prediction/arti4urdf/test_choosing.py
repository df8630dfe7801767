"""The evidence by which joints are chosen: what the rules and accepted objects add."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import PointCloud, merged_clouds
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.choosing import geometric_prior
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, read_structure
from model.prediction.lessons import Lesson, taught_tree
from model.prediction.registry import DEFAULT, load_predictor
from tests.model.prediction.geometric.archetypes import cooktop
from tests.scanned_cabinet import sheet


def test_accepted_carriers_replace_geometry_s_unless_locked_or_in_a_circle() -> None:
    def about(part: int, base: float = 0.0) -> Lesson:
        return Lesson(3, 3.0, 0.0, (), {part: 1.0}, base)

    assert taught_tree(0, [-1, 0, 0], {2: about(1)}, {}) == [-1, 0, 1]
    assert taught_tree(0, [-1, 0, 0], {2: about(1)}, {2: 0}) == [-1, 0, 0], "a person fixed it"
    assert taught_tree(0, [-1, 0, 1], {1: about(2)}, {}) == [-1, 0, 1], "no circle"
    assert taught_tree(0, [-1, 0, 0], {1: about(0, 1.0)}, {}) == [1, -1, 0], "another base"


def test_what_a_wrong_name_leaves_open_is_decided_by_the_shape() -> None:
    """A knob that somebody calls a button is likelier to spin than to be a lever or a rocker."""
    thing = cooktop().segmented()
    parts = tuple(replace(p, name="button" if p.name == "knob" else p.name) for p in thing.parts)
    structure = read_structure(SegmentedObject("cooktop", parts))
    prior = geometric_prior(structure)
    knob = next(i for i, p in enumerate(parts) if p.name == "button")
    slots = dict(zip(MECHANISMS, prior[knob][v.SLOT_IDS][::RANKS], strict=True))
    assert max(slots, key=lambda m: slots[m]) == "press"
    assert slots["spin"] > max(slots["lever"], slots["toggle"]) + 0.5


def scanned_drawers(
    width: float, height: float, count: int, noise: float, name: str
) -> SegmentedObject:
    """Equal flush drawers, one above the other and as wide as their cabinet, of whose back, bottom
    and inside nothing was seen; its front faces -y."""
    rng = np.random.default_rng(1)
    across, deep = (width, 0, 0), (0, 0.4, 0)
    body = [sheet((x, 0, 0), deep, (0, 0, height), 2000, rng) for x in (0, width)]
    body += [sheet((0, 0, height), across, deep, 1500, rng)]
    step = height / count
    low = (0, 0, step - 0.008)
    fronts = [sheet((0, 0, k * step + 0.004), across, low, 1200, rng) for k in range(count)]
    parts = []
    for k, cloud in enumerate((merged_clouds(tuple(body)), *fronts)):
        points = cloud.points + rng.normal(0, noise, cloud.points.shape)
        noisy = replace(cloud, points=points.astype(np.float32))
        parts.append(Part(f"link_{k}", cloud=noisy, name=name if k else None))
    return SegmentedObject("drawers", tuple(parts), "StorageFurniture")


@pytest.mark.parametrize(
    ("width", "height", "count", "noise", "name"),
    [
        (1.2, 0.8, 2, 0.004, "drawer"),
        (0.8, 0.5, 2, 0.0005, "drawer"),
        (0.8, 0.8, 3, 0.0005, "drawer door"),
        (1.2, 0.5, 3, 0.0005, "drawer door"),
    ],
)
def test_equal_drawers_come_out_of_their_front_alike(width, height, count, noise, name) -> None:
    """Not along the front or upwards, and none of them is the one that is warned about."""
    found = load_predictor(DEFAULT).predict(scanned_drawers(width, height, count, noise, name))
    assert found.tree is not None and len(found.tree.joints) == count
    for joint in found.tree.joints:
        assert joint.type == "prismatic" and joint.axis[1] < -0.99, joint
        for other in found.alternatives[joint.child]:
            assert other.type != "prismatic" or abs(other.axis[1]) > 0.99, other
    ends = [joint.motion_range[1] for joint in found.tree.joints]
    for numbers in ([*found.confidence.values()], ends):
        assert max(numbers) - min(numbers) < 0.15


def scanned_knobs(height: float, noise: float, cut: str) -> SegmentedObject:
    """A stove with three knobs in a row on its front, which faces -y, badly cut: their upper
    halves alone, or with a patch of the panel below."""
    rng = np.random.default_rng(1)
    deep, up = (0, 0.6, 0), (0, 0, 0.85)
    body = [sheet((0, 0, 0), (0.6, 0, 0), up, 6000, rng), sheet(up, (0.6, 0, 0), deep, 4000, rng)]
    body += [sheet((x, 0, 0), deep, up, 3000, rng) for x in (0, 0.6)]
    parts = [Part("link_0", cloud=merged_clouds(tuple(body)))]
    for k in range(3):
        turn = np.pi * np.concatenate([2 * rng.random(220), rng.random(110)])
        radius = 0.018 * np.concatenate([np.sqrt(rng.random(220)), np.ones(110)])
        y = -height * np.concatenate([np.ones(220), rng.random(110)])
        points = np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], 1)
        patch = (rng.random((150, 3)) - [0, 0, 1]) * [0.03, 0, 0.05] - [0, 0, 0.02]
        points = points[points[:, 2] > 0] if cut == "half" else np.concatenate([points, patch])
        points += [0.15 * (k + 1), 0, 0.78] + rng.normal(0, noise, points.shape)
        cloud = PointCloud(points.astype(np.float32))
        parts.append(Part(f"link_{k + 1}", cloud=cloud, name="knob"))
    return SegmentedObject("stove", tuple(parts), "Oven")


@pytest.mark.parametrize(
    ("height", "noise", "cut"),
    [(0.015, 0.001, "half"), (0.05, 0.001, "half"), (0.05, 0.001, "leak")],
)
def test_a_badly_cut_knob_turns_about_the_normal_of_its_panel(height, noise, cut) -> None:
    found = load_predictor(DEFAULT).predict(scanned_knobs(height, noise, cut))
    assert found.tree is not None and len(found.tree.joints) == 3
    for joint in found.tree.joints:
        assert joint.type == "continuous" and abs(joint.axis[1]) > 0.98, joint


@pytest.mark.parametrize(("tilt", "height"), [(30, 0.8), (45, 0.8), (90, 0.04)])
def test_scanned_knobs_on_a_slope_or_a_flat_hob_turn_about_its_normal(tilt, height) -> None:
    rng = np.random.default_rng(1)
    normal, along = unit_yz(tilt - 90), unit_yz(tilt)
    low, wide, up = np.array([0, 0, height]), (0.6, 0, 0), 0.14 * along
    body = [sheet((0, 0, 0), wide, low, 5000, rng), sheet(low, wide, up, 1500, rng)]
    body.append(sheet(low + up, wide, (0, 0.45, 0), 4000, rng))
    parts = [Part("link_0", cloud=merged_clouds(tuple(body)))]
    for k in range(3):
        turn, cap = 2 * np.pi * rng.random(320), np.arange(320) < 220
        radius = 0.018 * np.where(cap, np.sqrt(rng.random(320)), 1)
        out = 0.016 * np.where(cap, 1, rng.random(320))
        points = low + up / 2 + np.outer(out, normal) + np.outer(radius * np.sin(turn), along)
        points[:, 0] += 0.15 * (k + 1) + radius * np.cos(turn)
        points += rng.normal(0, 0.001, points.shape)
        parts.append(
            Part(f"link_{k + 1}", cloud=PointCloud(points.astype(np.float32)), name="knob")
        )
    found = load_predictor(DEFAULT).predict(SegmentedObject("stove", tuple(parts), "Oven"))
    assert found.tree is not None
    for joint in found.tree.joints:
        assert joint.type == "continuous" and abs(joint.axis @ normal) > 0.98, joint
    assert min(found.confidence.values()) > 0.5


def unit_yz(degrees: float) -> np.ndarray:
    """(3,) the direction so far from z towards y."""
    return np.array([0, np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])
