"""The steps of the answer: they write what the writer writes, and whatever is chosen parses."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.procedural.generate import COMPOSITE, make
from model.data.registry import GroundTruth
from model.prediction.arti4urdf.answer import parse_answer, rounded, write_answer
from model.prediction.arti4urdf.text_script import AnswerScript, Numbers, OneOf, as_written

Choose = Callable[[OneOf | Numbers, str], str]


def write(script: AnswerScript, choose: Choose) -> str:
    """Run the script; ``choose`` gets each choice and the text before it."""
    steps, text = script.steps(), ""
    step = next(steps)
    while True:
        answer = step if isinstance(step, str) else choose(step, text)
        if isinstance(step, OneOf):
            assert answer in step.texts
            assert not any(a != b and b.startswith(a) for a in step.texts for b in step.texts)
        text += answer
        try:
            step = steps.send("" if isinstance(step, str) else answer)
        except StopIteration:
            return text


def following(target: str) -> Choose:
    """Choices that lead to ``target``."""

    def choose(step: OneOf | Numbers, text: str) -> str:
        rest = target[len(text) :]
        if isinstance(step, OneOf):
            return next(t for t in step.texts if rest.startswith(t))
        text = rest[: rest.index('"')]
        assert step.allows(text, complete=True)
        assert all(step.allows(text[:k]) for k in range(len(text)))
        return text

    return choose


def at_random(rng: np.random.Generator) -> Choose:
    letters = np.array(list("0123456789-. "))

    def choose(step: OneOf | Numbers, text: str) -> str:
        if isinstance(step, OneOf):
            return str(rng.choice(list(step.texts)))
        text = ""
        while not (step.allows(text, complete=True) and rng.random() < 0.3):
            able = [c for c in letters if step.allows(text + c)]
            if not able:
                assert step.allows(text, complete=True), (text, step)
                break
            text += str(rng.choice(able))
        return text

    return choose


def truth_of(family: str, index: int) -> tuple[KinematicTree, SegmentedObject]:
    """A procedural object with its motions in the form of the training answers."""
    truth = GroundTruth("made", make(family, 5, index).object)
    segmented = truth.segmented(names=True)
    return as_written(truth.object.tree, {p.link for p in segmented.parts}), segmented


@pytest.mark.parametrize(
    "family", ["WashingMachine", "Bottle", "Lamp", "StorageFurniture", COMPOSITE]
)
def test_the_steps_equal_the_written_answer(family: str) -> None:
    for index in range(4):
        tree, segmented = truth_of(family, index)
        helpers = {k for k in tree.links if k not in {p.link for p in segmented.parts}}
        target = rounded(write_answer(tree, segmented))
        # Of an origin that occurs twice, the second is forced.
        text = write(AnswerScript(segmented), _forgiving(target))
        assert _without_origins(text) == _without_origins(target)
        found, problems = parse_answer(text)
        assert problems == () and found is not None
        for joint in tree.joints:
            mine = found.joint_of[joint.child]
            assert (mine.parent, mine.type) == (joint.parent, joint.type)
            if joint.moves and joint.child not in helpers:
                np.testing.assert_allclose(mine.origin, joint.origin, atol=5e-5)
                np.testing.assert_allclose(mine.axis, joint.axis, atol=1e-4)


def _forgiving(target: str) -> Choose:
    """Follows the target by the order of the choices, not by their position."""
    asked = iter(re.findall(r'<visual[^>]*>\s*<origin xyz="([^"]*)"', target)[1:])
    tree, urdf = target.split("<urdf_start>")
    moves = re.findall(
        r'<axis xyz="([^"]*)"/>\n\s*<limit (?:lower="([^"]*)" upper="([^"]*)")?', urdf
    )
    values = iter([x for row in moves for x in row if x])
    json = following(tree)

    def choose(step: OneOf | Numbers, text: str) -> str:
        if isinstance(step, OneOf):
            return json(step, text)
        return next(asked if step.kind == "origin" else values)

    return choose


def _without_origins(text: str) -> str:
    return re.sub(r'<origin xyz="[^"]*"', "<origin", text)


def test_random_choices_parse() -> None:
    rng = np.random.default_rng(0)
    for index in range(40):
        family = ("WashingMachine", "Bottle", COMPOSITE, "StorageFurniture")[index % 4]
        tree, segmented = truth_of(family, index)
        locked: tuple[Joint, ...] = ()
        if index % 2:
            locked = tuple(j for j in tree.joints if rng.random() < 0.4)
        found, problems = parse_answer(write(AnswerScript(segmented, locked), at_random(rng)))
        assert not problems
        assert found is not None
        ArticulatedObject(segmented.name, segmented.parts, found)
        for joint in locked:
            if _hangs(joint, locked, segmented):
                mine = found.joint_of[joint.child]
                assert (mine.parent, mine.type) == (joint.parent, joint.type)
                if joint.moves:
                    np.testing.assert_allclose(mine.axis, joint.axis, atol=1e-6)


def _hangs(joint: Joint, locked: tuple[Joint, ...], segmented: SegmentedObject) -> bool:
    """Whether both ends are parts: helpers count only where the whole chain is settled."""
    links = {p.link for p in segmented.parts}
    return joint.child in links and joint.parent in links


@pytest.mark.parametrize(
    ("text", "least", "begins", "whole"),
    [
        ("-", None, True, False),
        ("0.5", 0.2, True, True),
        ("0.1", 0.2, False, False),
        ("0.", 0.2, True, False),
        ("-1", 0.2, False, False),
        ("-1", -5.0, True, True),
        ("1 2", None, False, False),
        ("1234", None, False, False),
        ("0.123456", None, False, False),
        ("x", None, False, False),
    ],
)
def test_numbers(text: str, least: float | None, begins: bool, whole: bool) -> None:
    ask = Numbers("link_1", "limits", 1, least=least)
    assert ask.allows(text) == begins
    assert ask.allows(text, complete=True) == whole


def test_an_axis_is_not_zero() -> None:
    ask = Numbers("link_1", "axis", nonzero=True)
    assert not ask.allows("0 0 0", complete=True)
    assert ask.allows("0 0 0") and ask.allows("0 0 -")
    assert not ask.allows("0 0 0.0000")
    assert ask.allows("0 0 1", complete=True)
