"""Moving joints back and forth."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence

from model.core.joint import Joint

TICKS_PER_SECOND = 25.0
PERIOD_SECONDS = 3.2


class Animation:
    """Plays joints over their range until stopped; ``show(q)`` is called at every tick."""

    def __init__(self, show: Callable[[dict[str, float]], None]) -> None:
        self._show = show
        self._lock = threading.Lock()
        self._joints: dict[str, tuple[Joint, float]] = {}
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> frozenset[str]:
        """Names of the joints that move now."""
        return frozenset(self._joints)

    def toggle(self, joints: Sequence[Joint], q: dict[str, float]) -> None:
        """Stop ``joints`` where all of them play, else play them from where they are."""
        with self._lock:
            names = {j.name for j in joints}
            if names and names <= set(self._joints):
                for name in names:
                    del self._joints[name]
                return
            now = time.monotonic()
            for joint in joints:
                phase = phase_at(joint, q.get(joint.name, 0.0))
                self._joints[joint.name] = (joint, now - phase * PERIOD_SECONDS)
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._run, name="animation", daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop all; joints stay where they are."""
        with self._lock:
            self._joints.clear()

    def _run(self) -> None:
        while True:
            now = time.monotonic()
            with self._lock:
                if not self._joints:
                    self._thread = None
                    return
                q = {
                    name: value_at(joint, (now - start) / PERIOD_SECONDS)
                    for name, (joint, start) in self._joints.items()
                }
            self._show(q)
            time.sleep(max(0.0, 1 / TICKS_PER_SECOND - (time.monotonic() - now)))


def value_at(joint: Joint, phase: float) -> float:
    """q at ``phase`` periods: limited joints swing smoothly between limits, others turn on."""
    if joint.type == "continuous":
        return (phase * 2 * math.pi + math.pi) % (2 * math.pi) - math.pi
    assert joint.lower is not None and joint.upper is not None
    swing = 0.5 - 0.5 * math.cos(2 * math.pi * phase)
    return joint.lower + swing * (joint.upper - joint.lower)


def phase_at(joint: Joint, q: float) -> float:
    """The phase in [0, 1) at which :func:`value_at` is ``q``."""
    if joint.type == "continuous":
        return (q / (2 * math.pi)) % 1.0
    assert joint.lower is not None and joint.upper is not None
    span = joint.upper - joint.lower
    share = min(max((q - joint.lower) / span, 0.0), 1.0) if span > 0 else 0.0
    return math.acos(1 - 2 * share) / (2 * math.pi)
