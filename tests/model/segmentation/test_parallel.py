"""Two threads give the answers of one."""

import time

import pytest

from model.segmentation.arrays import mapped, together


def test_answers_come_in_the_order_of_the_items() -> None:
    def late(n: int) -> int:
        time.sleep(0.02 * (n == 0))
        return n * n

    assert mapped(late, range(6)) == [0, 1, 4, 9, 16, 25]
    assert mapped(late, []) == []
    assert together(lambda: late(0), lambda: "b") == (0, "b")


def test_what_fails_on_a_thread_fails_for_the_caller() -> None:
    def fails(n: int) -> int:
        if n == 2:
            raise ValueError("two")
        return n

    with pytest.raises(ValueError, match="two"):
        mapped(fails, range(4))
    with pytest.raises(ValueError, match="two"):
        together(lambda: 1, lambda: fails(2))
