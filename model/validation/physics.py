"""The joints driven there and back in a physics engine, without gravity and with it.

Drives are cached, and reused while only limits of other joints change. Each begins at rest, on its
own. Where two models differ only in limits that a drive never reached, every number of that drive
is the same, so it isn't run again.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.memory import LruCache
from model.core.names import display_name
from model.core.progress import Progress, no_progress
from model.physics.simulation_values import Physics, rough_physics
from model.validation import messages
from model.validation.engines import ENGINES, MUJOCO, STEP, Drive, Engine, Load, load_of
from model.validation.messages import value
from model.validation.report import PhysicsReport, Stop
from model.validation.simulators import mjcf_text

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


DRIVE = 0.4
"""Seconds to one end of a range; as many back."""
STIFFNESS = 100.0
"""1/s: natural frequency of the position drives, which are critically damped for their load."""
GROUPS = 12
"""Most drives of an object: joints of larger ones are driven several at a time."""
SAG = 2 * 9.81 / STIFFNESS**2
"""Metres that a drive yields under twice its load; the same in radians on a lever of a metre."""
MISS = 0.1
"""Share of the range short of its target from which a joint is reported."""
HASTE = 0.5 * (1.3 * math.pi / DRIVE) ** 2
"""1/s²: greatest acceleration along the path, over its length."""
SPARE = 4.0
"""Force limit of a drive over what path and weight need, so that obstacles are not torn out."""
TOUCHING = 1e-3
"""Metres of gap up to which a shape counts as the one that stops a joint."""


def run_physics(
    obj: ArticulatedObject,
    physics: Physics | None = None,
    *,
    engine: str = MUJOCO,
    progress: Progress = no_progress,
) -> PhysicsReport:
    """Drive each joint to both ends of its range and back while the others hold still.

    Args:
        physics: with it the links collide as in an exported asset; None drives joints with rough
            masses alone, which is quick.
        engine: see :data:`model.validation.engines.ENGINES`.
    """
    info = ENGINES[engine]
    if not info.installed:
        problem = messages.NOT_INSTALLED.format(engine=info.title, command=info.command)
        return PhysicsReport(False, problem, engine=info.title)
    joints = [j for j in obj.tree.joints if _drivable(j)]
    physics = physics or rough_physics(obj)
    shapes = sum(map(len, physics.collision.values()))
    if not joints:
        return PhysicsReport(True, shapes=shapes, engine=info.title)
    try:
        made = info.build(obj, joints, physics)
    except ValueError as error:
        problem = messages.NOT_LOADED.format(engine=info.title, error=str(error)[:200])
        return PhysicsReport(False, problem, engine=info.title)
    cache = drive_cache(engine, mjcf_text(obj, joints, physics), obj)
    run = Simulation(made, joints, obj, physics, cache)
    said = messages.SIMULATING.format(engine=info.title)
    for k, gravity in enumerate((0.0, -9.81)):
        run.all_joints(gravity, lambda f, k=k: progress(0.5 * (k + f), said))
    return PhysicsReport(
        True, "", run.exploded, run.drifted, run.missed, shapes, run.seconds, run.stops, info.title
    )


def _drivable(joint: Joint) -> bool:
    if not joint.moves:
        return False
    return not joint.limited or (joint.upper or 0.0) - (joint.lower or 0.0) > 1e-6


class Simulation:
    """The simulation and its results so far."""

    def __init__(
        self,
        engine: Engine,
        joints: Sequence[Joint],
        obj: ArticulatedObject,
        physics: Physics,
        cache: DriveCache,
    ) -> None:
        self.engine, self.joints = engine, list(joints)
        self._driven = [k for k, j in enumerate(joints) if j.mimic is None]
        limits = np.array([j.motion_range for j in joints])
        self.low, self.high = limits.T
        self.span = self.high - self.low
        self._slack = np.where([j.rotates for j in joints], 2 * SAG, SAG)
        self.start = np.clip(0.0, self.low, self.high)
        self.exploded: dict[str, str] = {}
        self.drifted: dict[str, float] = {}
        self.missed: dict[str, float] = {}
        self.stops: dict[str, Stop] = {}
        self.obj = obj
        self.seconds = 0.0
        self._cache = cache
        self._targets = self.start.copy()
        self._result = DriveResult.empty(len(joints))
        drives = [self._drive_of(k, load_of(obj, j, physics)) for k, j in enumerate(joints)]
        self.most = np.where([j.mimic is None for j in joints], [d.most for d in drives], np.inf)
        engine.set_drives(drives)

    def _drive_of(self, k: int, load: Load) -> Drive:
        """As strong as the joint's load needs, critically damped."""
        stiff, damp = load.inertia * STIFFNESS**2, 2 * load.inertia * STIFFNESS
        weight = 9.81 * load.mass * load.lever
        most = SPARE * (weight + load.inertia * HASTE * float(self.span[k]))
        return Drive(stiff, damp, most)

    def _rest(self) -> None:
        self._targets = self.start.copy()
        self.engine.rest(self.start)

    def all_joints(self, gravity: float, progress: Any) -> None:
        """Drive every joint once under ``gravity`` (m/s² along z)."""
        self.engine.set_gravity(gravity)
        size = math.ceil(len(self._driven) / GROUPS)
        groups = [self._driven[i : i + size] for i in range(0, len(self._driven), size)]
        for n, group in enumerate(groups):
            progress(n / len(groups))
            bounds = Bounds(self.low, self.high, self.most)
            result = self._cache.load(gravity, group, bounds, self._driven)
            if result is None:
                result = self._result = DriveResult.empty(len(self.joints))
                self._rest()
                self._settle()
                before = self.engine.q.copy()
                for end in (self.high, self.low):
                    if not self.drive(group, end, before):
                        break
                self._cache.save(gravity, group, bounds, result)
            self._add(result)

    def _add(self, result: DriveResult) -> None:
        """Merge one drive: the worst of each joint counts."""
        self.seconds += result.seconds
        for k, share, stop in result.missed:
            name = self.joints[k].name
            if share > self.missed.get(name, 0.0):
                self.missed[name], self.stops[name] = share, stop
        for k, share in result.drifted:
            name = self.joints[k].name
            self.drifted[name] = max(self.drifted.get(name, 0.0), share)
        for k, how, place in result.exploded:
            name = self.joints[k].name
            self.exploded[name] = how
            if place is not None:
                self.stops[name] = place

    def _settle(self) -> None:
        self._steps(round(0.1 / STEP), lambda t: None)

    def drive(self, group: list[int], end: FloatArray, before: FloatArray) -> bool:
        """There and back; False where it exploded."""
        path = end - self.start
        if not np.abs(path[group]).max() > 0:
            return True

        def aim(t: float) -> None:
            self._targets[group] = self.start[group] + t * path[group]

        count = round(DRIVE / STEP)
        there = self._steps(count, lambda t: aim(0.5 - 0.5 * math.cos(math.pi * min(1.3 * t, 1))))
        if not there:
            return self._burst(group)
        self._compare(group, end)
        back = self._steps(count, lambda t: aim(0.5 + 0.5 * math.cos(math.pi * min(1.3 * t, 1))))
        if not back:
            return self._burst(group)
        self._drift(group, before)
        return True

    def _steps(self, count: int, aim: Any) -> bool:
        """Simulate; False where a value became infinite or far outside its limits."""
        for k in range(count):
            aim((k + 1) / count)
            self.engine.step(self._targets)
            self._result.record(self.engine.q, self.engine.force)
            if k % 20 == 19 and not self._is_stable():
                return False
        self._result.seconds += count * STEP
        return self._is_stable()

    def _is_stable(self) -> bool:
        return self.engine.stable and not self._outside().any()

    def _outside(self) -> npt.NDArray[np.bool_]:
        q = self.engine.q
        far = np.maximum(self.low - q, q - self.high)
        limited = np.array([j.limited for j in self.joints])
        return limited & (far > OUTSIDE * self.span + self._slack)

    def _burst(self, group: list[int]) -> bool:
        far = np.flatnonzero(self._outside())
        for k in far.tolist():
            stop = self._stop(k)
            self._result.exploded.append((k, self._left(k, group, stop), stop))
        for k in group if not len(far) else ():
            self._result.exploded.append((k, messages.UNSTABLE, None))
        return False

    def _left(self, k: int, group: list[int], stop: Stop) -> str:
        """Say how far a joint is beyond its limits, which joint was driven, and what pushes it."""
        joint, q = self.joints[k], float(self.engine.q[k])
        beyond = max(float(self.low[k]) - q, q - float(self.high[k]))
        by = messages.BY.format(value=value(joint, beyond)) if math.isfinite(beyond) else ""
        others = [display_name(self.obj, self.joints[g].child) for g in group if g != k]
        template = (
            messages.DRIVEN_ITSELF,
            messages.DRIVEN_ONE,
            messages.DRIVEN_TWO,
            messages.DRIVEN_MANY,
        )[min(len(others), 3)]
        driven = template.format(**dict(zip(("first", "second"), others, strict=False)))
        cause = ""
        if joint.mimic is not None:
            cause = messages.CAUSE_MIMIC
        elif stop.other is not None:
            cause = messages.CAUSE_SHAPES.format(other=display_name(self.obj, stop.other))
        return messages.LEAVES_LIMITS.format(by=by, driven=driven, cause=cause)

    def _compare(self, group: list[int], end: FloatArray) -> None:
        q = self.engine.q
        for k in group:
            short = (abs(end[k] - q[k]) - self._slack[k]) / self.span[k]
            if short > MISS:
                self._result.missed.append((k, float(short), self._stop(k)))
        place = {j.name: i for i, j in enumerate(self.joints)}
        for k, joint in enumerate(self.joints):
            leader = None if joint.mimic is None else place.get(joint.mimic.joint)
            if joint.mimic is None or leader not in group:
                continue
            led = joint.mimic.multiplier * q[leader] + joint.mimic.offset
            short = (abs(led - q[k]) - self._slack[k]) / self.span[k]
            if short > MISS:
                self._result.missed.append((k, float(short), self._stop(k)))

    def _stop(self, k: int) -> Stop:
        """Value of a joint, and the other link that touches its subtree."""
        moved = self.obj.tree.descendants(self.joints[k].child)
        across = [t for t in self.engine.touches() if (t.a in moved) != (t.b in moved)]
        first = min(across, key=lambda t: t.gap, default=None)
        other, where = None, None
        if first is not None and first.gap < TOUCHING:
            other, where = first.b if first.a in moved else first.a, first.where
        name = self.joints[k].name
        return Stop({name: float(self.engine.q[k])}, other, where)

    def _drift(self, group: list[int], before: FloatArray) -> None:
        q = self.engine.q
        self._result.moved = np.maximum(self._result.moved, np.abs(q - before) - self._slack)
        led = {self.joints[k].name for k in group}
        for k, joint in enumerate(self.joints):
            if joint.mimic is not None and joint.mimic.joint in led:
                continue
            share = (abs(q[k] - before[k]) - self._slack[k]) / self.span[k]
            if share > DRIFT:
                self._result.drifted.append((k, float(share)))
