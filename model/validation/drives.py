"""What joints did when they were driven in the simulator, kept while limits of others change.

Each drive begins at rest, on its own. Of two models that differ in limits alone, and of those that
a drive never came to, it sees nothing: every number on the way is the same, so it isn't run again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.lru_cache import Recent
from model.validation.physics_report import Stop

OUTSIDE = 0.2
"""Share of the range beyond a limit that counts as exploded."""
DRIFT = 0.1
"""Share of its range that a joint may drift while others are driven."""
CLEAR = 1e-6
"""Radians or metres from a limit at which it surely has no say: files round it."""
_RANGE = re.compile(r' range="[^"]*"')

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bounds:
    """What limits say in the simulator.

    Attributes:
        low, high: (J,) radians or metres.
        most: (A,) force of each drive in N or N m.
    """

    low: FloatArray
    high: FloatArray
    most: FloatArray


@dataclass(eq=False)
class Seen:
    """What a drive of some joints showed.

    Attributes:
        low, high: (J,) the lowest and highest value of each joint on the way.
        force: (A,) the greatest of each drive, N or N m.
        moved: (J,) how far each ended from where it began, less what drives give way.
        missed: joint, share of its range that it stopped short of, and where.
        drifted: joint and share of its range.
        seconds: simulated.
        exploded: joint, how, and where it stood where it had left its limits.
    """

    low: FloatArray
    high: FloatArray
    force: FloatArray
    moved: FloatArray
    missed: list[tuple[int, float, Stop]] = field(default_factory=list)
    drifted: list[tuple[int, float]] = field(default_factory=list)
    exploded: list[tuple[int, str, Stop | None]] = field(default_factory=list)
    seconds: float = 0.0

    @staticmethod
    def nothing(joints: int, drives: int) -> Seen:
        """Before the first step."""
        far = np.full(joints, np.inf)
        return Seen(far, -far, np.zeros(drives), np.zeros(joints))

    def note(self, q: FloatArray, force: FloatArray) -> None:
        """After a step: (J,) values and (A,) forces."""
        self.low, self.high = np.minimum(self.low, q), np.maximum(self.high, q)
        self.force = np.maximum(self.force, np.abs(force))


class KeptDrives:
    """The drives of one model, whatever the limits in it.

    Args:
        key: tells models apart, but for limits.
    """

    def __init__(self, key: str) -> None:
        self._key = key

    def _held(
        self, gravity: float, group: Sequence[int], bounds: Bounds
    ) -> list[tuple[Bounds, Seen]]:
        """A list of one, or empty."""
        own = tuple((float(bounds.low[k]), float(bounds.high[k])) for k in group)
        return _DRIVES.get((self._key, gravity, tuple(group), own), list)

    def keep(self, gravity: float, group: Sequence[int], bounds: Bounds, seen: Seen) -> None:
        """Remember what a drive of ``group`` showed; what exploded is looked at each time."""
        self._held(gravity, group, bounds)[:] = [] if seen.exploded else [(bounds, seen)]

    def seen(
        self, gravity: float, group: Sequence[int], bounds: Bounds, driven: Sequence[int]
    ) -> Seen | None:
        """What a drive of ``group`` would show; None where it must be run.

        Args:
            driven: (A,) the joint of each drive.
        """
        for before, seen in self._held(gravity, group, bounds):
            if _unnoticed(before, bounds, seen, np.asarray(driven)):
                return seen
        return None


def _unnoticed(before: Bounds, now: Bounds, seen: Seen, driven: npt.NDArray[np.int64]) -> bool:
    """Whether other limits would have made no difference."""
    low, high = before.low != now.low, before.high != now.high
    starts = [np.clip(0.0, b.low, b.high) for b in (before, now)]
    span = np.minimum(before.high - before.low, now.high - now.low)
    force = before.most != now.most
    return bool(
        (starts[0] == starts[1]).all()
        and (seen.low[low] > np.maximum(before.low, now.low)[low] + CLEAR).all()
        and (seen.high[high] < np.minimum(before.high, now.high)[high] - CLEAR).all()
        and (np.maximum(now.low - seen.low, seen.high - now.high) <= OUTSIDE * span)[
            low | high
        ].all()
        and (seen.moved[low | high] <= DRIFT * span[low | high]).all()
        and (seen.force[force] < 0.999 * np.minimum(before.most, now.most)[force]).all()
        # What leads or follows others is tied to them.
        and (low | high)[driven].sum() == (low | high).sum()
    )


def kept_drives(text: str, obj: ArticulatedObject) -> KeptDrives:
    """Those of a model.

    Args:
        text: the simulator's model. Names in it are numbers of the object's links and joints.
    """
    names = (obj.tree.order, [j.name for j in obj.tree.joints])
    said = f"{names}\0{_RANGE.sub(' range', text)}"
    return KeptDrives(hashlib.sha256(said.encode()).hexdigest())


_DRIVES: Recent[
    tuple[str, float, tuple[int, ...], tuple[tuple[float, float], ...]], list[tuple[Bounds, Seen]]
] = Recent(256)
