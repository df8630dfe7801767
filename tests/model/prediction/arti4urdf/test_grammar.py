"""Whatever is chosen, the answer is one tree; settled parts stay where they were put."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("torch", reason="torch is not installed")

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import SLOTS
from model.prediction.arti4urdf.vocabulary import FREE, Grammar, Lock


def _random_answer(rng: np.random.Generator, grammar: Grammar) -> int:
    """Choose at random until the answer is complete; gives the number of tokens."""
    tokens = len(grammar.forced())
    while (asked := grammar.choice()) is not None:
        options = [*np.flatnonzero(asked.words), *(v.SIZE + np.flatnonzero(asked.parts))]
        assert options, asked
        pick = int(options[int(rng.integers(len(options)))])
        if pick < v.SIZE:
            grammar.take(pick)
        else:
            grammar.take(-1, pick - v.SIZE)
        tokens += 1 + len(grammar.forced())
        assert tokens < 40 * grammar.count + 40
    return tokens


def _grammar(rng: np.random.Generator, count: int, locked: dict[int, Lock]) -> Grammar:
    present = rng.random((count, SLOTS)) < rng.random()
    planned = bool(rng.random() < 0.7)
    return Grammar(present, rng.random((count, SLOTS)) < 0.5, locked, json_step=planned)


def test_ten_thousand_random_answers_are_trees() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10_000):
        count = int(rng.integers(1, 9))
        grammar = _grammar(rng, count, {})
        _random_answer(rng, grammar)
        parents = [d.parent for d in grammar.decisions]
        assert parents.count(-1) == 1 and parents[grammar.root] == -1
        for k in range(count):
            at, steps = k, 0
            while at != grammar.root:
                at, steps = parents[at], steps + 1
                assert steps <= count
        for k, d in enumerate(grammar.decisions):
            if k == grammar.root or v.TYPES[d.type] == "fixed":
                assert d.slot == -1
                continue
            assert d.slot == FREE or 0 <= d.slot < SLOTS
            assert len(d.numbers) == (6 if d.slot == FREE else 0)
            assert d.lower <= d.upper


@settings(max_examples=200)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 12))
def test_settled_parts_stay_where_they_were_put(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(count)
    locked = {
        int(order[k]): Lock(int(order[rng.integers(k)]), int(rng.integers(-1, len(v.TYPES))))
        for k in range(1, count)
        if rng.random() < 0.5
    }
    grammar = _grammar(rng, count, locked)
    _random_answer(rng, grammar)
    for part, lock in locked.items():
        assert grammar.decisions[part].parent == lock.parent
        if lock.type >= 0:
            assert grammar.decisions[part].type == lock.type
            assert grammar.decisions[part].slot == -1
    assert [d.parent for d in grammar.decisions].count(-1) == 1


def test_settled_parts_in_a_circle_end_and_do_not_hang() -> None:
    rng = np.random.default_rng(3)
    grammar = _grammar(rng, 4, {1: Lock(2), 2: Lock(1)})
    _random_answer(rng, grammar)
    assert grammar.choice() is None


def test_what_is_not_allowed_is_refused() -> None:
    grammar = _grammar(np.random.default_rng(0), 3, {})
    grammar.forced()
    with pytest.raises(ValueError, match="allows neither"):
        grammar.take(v.ID["<close>"])
    with pytest.raises(ValueError, match="allows neither"):
        grammar.take(-1, 3)


def test_numbers_come_back_from_their_levels() -> None:
    angles = np.linspace(-np.pi, np.pi, 41)
    assert [v.level_angle(int(k)) for k in v.angle_levels(angles)] == pytest.approx(angles)
    for value in (-1.0, -0.2, -0.01, 0.0, 0.003, 0.05, 0.6):
        level = int(v.travel_levels(value))
        assert v.level_travel(level) == pytest.approx(value, abs=0.05 * abs(value) ** 0.5 + 1e-3)
