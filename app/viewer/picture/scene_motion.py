"""Joints of a scene that move: one, those of an object, or all at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from app.server.scene_rows import Work
from app.viewer.picture.animation import PERIOD_SECONDS, phase_at, value_at

STEPS = 48
"""Poses of one swing; they are worked out once, so that a tick only sends them."""

Poses = Mapping[int, Mapping[str, npt.NDArray[np.float64]]]


class SceneMotion:
    """Swings joints over their range until stopped; then everything rests.

    Args:
        show: gets session id → link → posed_from_rest at every step.
    """

    def __init__(self, show: Callable[[Poses], None]) -> None:
        self._show = show
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> bool:
        """True while the joints move."""
        return self._thread is not None and self._thread.is_alive()

    def play(self, works: list[Work], joint: str | None = None) -> int:
        """Start, with all joints or the one of that name; returns how many move."""
        cycle, count = _cycle(works, joint)
        if count:
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, args=(cycle,), daemon=True)
            self._thread.start()
        return count

    def stop(self) -> None:
        """End, with every joint at rest."""
        if self.playing:
            self._stop.set()
            assert self._thread is not None
            self._thread.join(timeout=5.0)
            self._show({})
        self._thread = None

    def _run(self, cycle: list[Poses]) -> None:
        start = time.monotonic()
        while True:
            step = int((time.monotonic() - start) / PERIOD_SECONDS * STEPS)
            self._show(cycle[step % STEPS])
            ahead = start + (step + 1) * PERIOD_SECONDS / STEPS - time.monotonic()
            if self._stop.wait(max(0.0, ahead)):
                return


def _cycle(works: list[Work], joint: str | None = None) -> tuple[list[Poses], int]:
    cycle: list[dict[int, dict[str, npt.NDArray[np.float64]]]] = [{} for _ in range(STEPS)]
    count = 0
    for work in works:
        tree = work.document.tree
        joints = (
            []
            if tree is None
            else [j for j in tree.joints if j.moves and j.mimic is None and joint in (None, j.name)]
        )
        if tree is None or not joints:
            continue
        count += len(joints) if joint else sum(j.moves for j in tree.joints)
        begin = {j.name: phase_at(j, 0.0) for j in joints}
        moving = frozenset().union(*(tree.descendants(j.child) for j in joints))
        for k in range(STEPS):
            q = {j.name: value_at(j, begin[j.name] + k / STEPS) for j in joints}
            posed = tree.pose(q)
            cycle[k][work.id] = {link: posed[link] for link in moving}
    return list(cycle), count
