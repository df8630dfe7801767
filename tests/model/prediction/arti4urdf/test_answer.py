"""One writer, one parser: what is written comes back, and bad text becomes problems."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.data.procedural.generate import make
from model.prediction.arti4urdf.answer import parse_answer, write_answer

FAMILIES = ("StorageFurniture", "Bottle", "Chair", "Fan", "Oven")


@pytest.mark.parametrize("family", FAMILIES)
def test_the_truth_is_written_and_comes_back(family: str) -> None:
    obj = make(family, 3, 1).object
    text = write_answer(obj.tree, SegmentedObject(obj.name, obj.parts, obj.category))
    tree, problems = parse_answer(text)
    assert tree is not None
    assert problems == ()
    rng = np.random.default_rng(0)
    q = {j.name: float(rng.uniform(-0.5, 0.5)) for j in obj.tree.joints if j.moves}
    ours, theirs = obj.tree.pose(q), tree.pose(q)
    for link in obj.tree.links:
        assert np.allclose(ours[link], theirs[link], atol=1e-6)


def test_thinking_aloud_before_the_answer_does_no_harm() -> None:
    obj = make("Laptop", 3, 1).object
    text = write_answer(obj.tree, SegmentedObject(obj.name, obj.parts))
    tree, problems = parse_answer("The base is <json_start> nonsense <json_end>, so:\n" + text)
    assert tree is not None and problems == ()


def test_blocks_that_disagree_are_told() -> None:
    obj = make("Laptop", 3, 1).object
    text = write_answer(obj.tree, SegmentedObject(obj.name, obj.parts))
    tree, problems = parse_answer(text.replace('"revolute"', '"prismatic"', 1))
    assert tree is not None
    assert any("prismatic" in p for p in problems)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<json_start>{}<json_end>",
        "<urdf_start><robot><urdf_end>",
        "<urdf_start><robot name='x'><link name='a'/></robot><urdf_end>",
        "<json_start>" + "[" * 3000 + "<json_end><urdf_start>x<urdf_end>",
        "<urdf_start><!DOCTYPE a [<!ENTITY b SYSTEM 'file:///etc/passwd'>]><robot/><urdf_end>",
        "\x00<urdf_start>\ud800<urdf_end>",
    ],
)
def test_bad_text_becomes_problems(text: str) -> None:
    _, problems = parse_answer(text)
    assert problems
    assert all("/tmp" not in p for p in problems)


@settings(max_examples=60)
@given(st.text(max_size=200), st.integers(0, 10**6))
def test_damaged_answers_never_raise(noise: str, seed: int) -> None:
    obj = make("Lighter", 3, 1).object
    text = write_answer(obj.tree, SegmentedObject(obj.name, obj.parts))
    at = seed % len(text)
    parse_answer(text[:at] + noise + text[min(len(text), at + len(noise)) :])
