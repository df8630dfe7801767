"""Cached drives of joints in the simulator, reused while only limits of other joints change.

Each drive begins at rest, on its own. Where two models differ only in limits that a drive never
reached, every number of that drive is the same, so it isn't run again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.lru_cache import LruCache
from model.validation.physics_report import Stop

OUTSIDE = 0.2
"""Share of the range beyond a limit that counts as exploded."""
DRIFT = 0.1
"""Share of its range that a joint may drift while others are driven."""
CLEAR = 1e-6
"""Radians or metres from a limit from which it has no influence: files round it."""
_RANGE = re.compile(r' range="[^"]*"')

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bounds:
    """Limits in the simulator.

    Attributes:
        low, high: (J,) radians or metres.
        most: (J,) largest force of each drive in N or N m; infinite for followers.
    """

    low: FloatArray
    high: FloatArray
    most: FloatArray


@dataclass(eq=False)
class DriveResult:
    """The result of driving some joints.

    Attributes:
        low, high: (J,) lowest and highest value of each joint.
        force: (J,) greatest force of each drive, N or N m.
        moved: (J,) distance of each from its start at the end, less the sag of its drive.
        missed: joint, share of its range that it stopped short, and where.
        drifted: joint, and share of its range.
        seconds: simulated.
        exploded: joint, how, and where it was if it left its limits.
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
    def empty(joints: int) -> DriveResult:
        """The result before the first step."""
        far = np.full(joints, np.inf)
        return DriveResult(far, -far, np.zeros(joints), np.zeros(joints))

    def record(self, q: FloatArray, force: FloatArray) -> None:
        """Add a step: (J,) values and (J,) forces."""
        self.low, self.high = np.minimum(self.low, q), np.maximum(self.high, q)
        self.force = np.maximum(self.force, np.abs(force))


class DriveCache:
    """Drives of one model, whatever its limits.

    Args:
        key: of the model without its limits.
    """

    def __init__(self, key: str) -> None:
        self._key = key

    def _entry(
        self, gravity: float, group: Sequence[int], bounds: Bounds
    ) -> list[tuple[Bounds, DriveResult]]:
        """A list of one, or empty."""
        own = tuple((float(bounds.low[k]), float(bounds.high[k])) for k in group)
        return recent_drives.get((self._key, gravity, tuple(group), own), list)

    def save(
        self, gravity: float, group: Sequence[int], bounds: Bounds, result: DriveResult
    ) -> None:
        """Cache a drive of ``group``, unless it exploded."""
        self._entry(gravity, group, bounds)[:] = [] if result.exploded else [(bounds, result)]

    def load(
        self, gravity: float, group: Sequence[int], bounds: Bounds, driven: Sequence[int]
    ) -> DriveResult | None:
        """The result of driving ``group``; None where it must be run.

        Args:
            driven: (A,) the joint of each drive.
        """
        for before, result in self._entry(gravity, group, bounds):
            if _unaffected(before, bounds, result, np.asarray(driven)):
                return result
        return None


def _unaffected(
    before: Bounds, now: Bounds, result: DriveResult, driven: npt.NDArray[np.int64]
) -> bool:
    """True if the changed limits make no difference to a result."""
    low, high = before.low != now.low, before.high != now.high
    starts = [np.clip(0.0, b.low, b.high) for b in (before, now)]
    span = np.minimum(before.high - before.low, now.high - now.low)
    force = before.most != now.most
    return bool(
        (starts[0] == starts[1]).all()
        and (result.low[low] > np.maximum(before.low, now.low)[low] + CLEAR).all()
        and (result.high[high] < np.minimum(before.high, now.high)[high] - CLEAR).all()
        and (np.maximum(now.low - result.low, result.high - now.high) <= OUTSIDE * span)[
            low | high
        ].all()
        and (result.moved[low | high] <= DRIFT * span[low | high]).all()
        and (result.force[force] < 0.999 * np.minimum(before.most, now.most)[force]).all()
        # Mimics and their leaders are coupled.
        and (low | high)[driven].sum() == (low | high).sum()
    )


def drive_cache(engine: str, text: str, obj: ArticulatedObject) -> DriveCache:
    """The cached drives of a model.

    Args:
        engine: its name.
        text: the model as MJCF, whatever the engine; its links and joints are named by their
            numbers.
    """
    names = (obj.tree.order, [j.name for j in obj.tree.joints])
    key = f"{engine}\0{names}\0{_RANGE.sub(' range', text)}"
    return DriveCache(hashlib.sha256(key.encode()).hexdigest())


recent_drives: LruCache[
    tuple[str, float, tuple[int, ...], tuple[tuple[float, float], ...]],
    list[tuple[Bounds, DriveResult]],
] = LruCache(256)
