"""Agreement of two annotations: each figure alone, frames apart, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model.core.geometry import affine, rotation_from_rpy
from model.evaluation.agreement import agreement, mean_figures
from tests.accepted import cupboard
from tests.builders import box, part


def test_the_same_twice_agrees_wholly() -> None:
    found = agreement(cupboard(), cupboard())
    assert found.part_iou == pytest.approx(1.0, abs=0.02)
    assert (found.type_agreement, found.range_iou) == (1.0, 1.0)
    assert (found.axis_angle, found.origin_distance) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert found.disagreement < 0.01 and found.agrees


def test_frames_that_were_levelled_and_sized_differently_are_the_same_object() -> None:
    one_from_other = affine(0.5 * rotation_from_rpy((0.3, -1.0, 2.0)), (3.0, -1.0, 0.2))
    other = cupboard().moved(np.linalg.inv(one_from_other))
    assert agreement(cupboard(), other).disagreement > 0.3
    assert agreement(cupboard(), other, one_from_other).disagreement < 0.01


def test_each_difference_has_its_figure_and_its_words() -> None:
    whole = cupboard()
    tilted = agreement(whole, cupboard(axis=(0, math.sin(0.3), -math.cos(0.3))))
    assert tilted.axis_angle == pytest.approx(0.3)
    assert tilted.what == ("door: axes 17° apart",)
    apart = agreement(whole, cupboard(origin=(0.6, -0.02, 0)))
    assert apart.origin_distance == pytest.approx(0.6 / math.hypot(0.6, 0.52, 0.8))
    assert "of the diagonal apart" in apart.what[0]
    half = agreement(whole, cupboard(upper=0.6))
    assert half.range_iou == pytest.approx(0.4) and half.what == ("door: ranges overlap by 40 %",)
    slide = agreement(whole, cupboard(type="prismatic", axis=(0, -1, 0), upper=0.3))
    assert slide.type_agreement == 0.0 and slide.what == ("door: revolute or prismatic",)
    stuck = agreement(whole, cupboard(type="fixed", lower=None, upper=None))
    assert stuck.type_agreement == 0.0 and stuck.what == ("door moves in the first only",)
    sizes = [x.disagreement for x in (half, tilted, slide, stuck)]
    assert min(sizes) > 0.02 and max(sizes) <= 1


def test_a_part_cut_elsewhere_lowers_part_iou_both_ways() -> None:
    whole = cupboard()
    body = part("link_0", box((0, 0, 0), (0.6, 0.5, 0.8)), box((0, -0.02, 0), (0.3, 0, 0.8)))
    door = part("link_1", box((0.3, -0.02, 0), (0.6, 0, 0.8)), name="door")
    halved = replace(whole, parts=(body, door))
    first, second = agreement(whole, halved), agreement(halved, whole)
    assert 0.4 < first.part_iou < 0.95
    assert first.part_iou == pytest.approx(second.part_iou, abs=0.02)


def test_means_leave_out_what_nobody_has() -> None:
    pairs = [agreement(cupboard(), cupboard()), agreement(cupboard(), cupboard(upper=0.6))]
    means = mean_figures(pairs)
    assert means["pairs"] == 2 and means["range_iou"] == pytest.approx(0.7)
    assert mean_figures([]) == {
        "pairs": 0, "part_iou": None, "type_agreement": None, "axis_angle": None,
        "origin_distance": None, "range_iou": None, "disagreement": None,
    }  # fmt: skip
