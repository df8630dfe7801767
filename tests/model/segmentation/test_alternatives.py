"""Which masks Tab offers."""

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from model.segmentation.solver import offered

SIZE = np.ones(100)


def span(begin: int, end: int) -> np.ndarray:
    mask = np.zeros(100, bool)
    mask[begin:end] = True
    return mask


def test_another_mask_comes_before_small_changes_of_the_one_shown() -> None:
    shown = span(0, 50)
    masks = np.stack([span(0, 50), span(0, 44), span(0, 43), span(0, 42), span(0, 100)])
    scores = np.array([3.0, 2.9, 2.8, 2.7, 2.5])
    assert offered(masks, scores, shown, SIZE)[0] == 4
    assert offered(masks, scores, span(0, 100), SIZE)[0] in (0, 1, 2, 3)


def test_nothing_is_offered_that_looks_like_what_is_shown() -> None:
    masks = np.stack([span(0, 50), span(0, 49), span(1, 50)])
    assert offered(masks, np.zeros(3), span(0, 50), SIZE) == []
    assert offered(masks, np.zeros(3), np.zeros(100, bool), SIZE) == [0]


def test_large_cells_count_more() -> None:
    size = np.where(np.arange(100) < 10, 1000.0, 1.0)
    masks = np.stack([span(0, 100), span(10, 100)])
    # The first differs from what is shown by ninety cells that weigh next to nothing.
    assert offered(masks, np.zeros(2), span(0, 10), size) == [1]


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.integers(2, 9))
def test_what_is_offered_covers_nearly_as_much_as_the_best_choice(seed: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    begin = rng.integers(0, 60, number)
    masks = np.stack(
        [span(b, b + w) for b, w in zip(begin, rng.integers(5, 40, number), strict=True)]
    )
    scores, shown = rng.normal(0, 2, number), masks[0]
    found = offered(masks, scores, shown, SIZE, most=2)

    def overlap(a: np.ndarray, b: np.ndarray) -> float:
        return (a & b).sum() / (a | b).sum()

    table = np.array([[overlap(a, b) for b in masks] for a in masks])
    likely = np.exp(scores / 2) / np.exp(scores / 2).sum()

    def gain(chosen: tuple[int, ...]) -> float:
        covered = table[:, [0, *chosen]].max(1)
        return float(likely @ (covered - table[:, 0]))

    # As those may be chosen that differ from each other and from what is shown.
    free = [i for i in range(number) if table[0, i] <= 0.9]
    pairs = [p for p in combinations(free, 2) if table[p] <= 0.9]
    best = max([gain(p) for p in pairs] + [gain((i,)) for i in free] + [0.0])
    assert gain(tuple(found)) >= (1 - 1 / np.e) * best - 1e-6
    assert len(set(found)) == len(found) <= 2
