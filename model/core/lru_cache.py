"""What was worked out last, kept by what it was asked."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

K = TypeVar("K")
V = TypeVar("V")


def content_of(*arrays: npt.NDArray) -> bytes:
    """Tells arrays apart by what is in them."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


class Recent(Generic[K, V]):
    """The last few values of an expensive function; for one process.

    Args:
        size: how many at most.
        weight: how heavy they may be together; the last one is kept whatever it weighs.
    """

    def __init__(self, size: int, weight: float = float("inf")) -> None:
        self._size, self._most = size, weight
        self._kept: OrderedDict[K, tuple[V, float]] = OrderedDict()
        self._total = 0.0

    def get(
        self,
        key: K,
        make: Callable[[], V],
        weight: float = 0.0,
        weigh: Callable[[V], float] | None = None,
    ) -> V:
        """The value of ``key``; made where it isn't kept, after room for its ``weight`` is.

        Args:
            weigh: how heavy it turned out to be, where only that tells.
        """
        held = self._kept.get(key)
        if held is not None:
            self._kept.move_to_end(key)
            return held[0]
        self._make_room(weight)
        value = make()
        weight = weight if weigh is None else weigh(value)
        self._drop(key)  # other jobs may have come between its steps
        self._make_room(weight)
        self._kept[key] = value, weight
        self._total += weight
        return value

    def _make_room(self, weight: float) -> None:
        while self._kept and (len(self._kept) >= self._size or weight + self._total > self._most):
            self._drop(next(iter(self._kept)))

    def _drop(self, key: K) -> None:
        held = self._kept.pop(key, None)
        if held is not None:
            self._total -= held[1]
