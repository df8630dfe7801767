"""The default segmenter: nothing to download, fast on a CPU.

An asset becomes at most 100k nodes, a graph with learned edge strengths, about ten thousand
superpoints, three merge trees and three factorised random walks. A click gathers proposals (regions
of the trees, boxes, the earlier mask with or without a region, random walks), and small trained
models choose the one most like a part. Parts exclude each other.
"""

from __future__ import annotations

import hashlib
import time

from cachetools import LRUCache

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool, Int16
from model.segmentation.encoding import Encoding, encode
from model.segmentation.graph import shipped_edge_model
from model.segmentation.labels import LabelFinisher
from model.segmentation.prompt_steps import ClickStep, Step, resolve, surface_steps
from model.segmentation.prompts import Click, PartSegmentation, Prompts
from model.segmentation.scores import InputDomain, shipped_moving_scorers, shipped_scorers
from model.segmentation.session_state import SessionState, StateUpdates
from model.segmentation.solver import ALTERNATIVES, PartSolver, look_alike, offered, solver_of

STATES_CACHED, _CLICKS_CACHED = 64, 10_000
"""For undo and the next click; a state of 20,000 points takes 0.6 MB."""
_SPARE = 10
"""Further alternatives, as some may turn out to be equal, or everything."""
_ALL = 0.99
"""Share of the asset above which an alternative is everything."""


class DefaultSession:
    """See :class:`~model.segmentation.registry.SegmentationSession`.

    Attributes:
        asset, encoding, solver: as given.
        finisher: from superpoints to labels.
        moving: first clicks mean parts that move; see :meth:`including_base`.
    """

    def __init__(
        self,
        asset: Asset,
        encoding: Encoding,
        solver: PartSolver,
        *,
        moving: bool = True,
    ) -> None:
        self.asset = asset
        self.encoding = encoding
        self.solver = solver
        self.moving = moving
        self.finisher = LabelFinisher(asset, encoding)
        self._updates = StateUpdates(encoding, solver, self.finisher, moving)
        self._all = float(self.finisher.weight.sum())
        self._states: LRUCache[bytes, SessionState] = LRUCache(STATES_CACHED)
        self._clicks: LRUCache[Click, ClickStep] = LRUCache(_CLICKS_CACHED)

    def including_base(self) -> DefaultSession:
        """The same session for clicks that may mean the base, too, whatever part they name.

        People don't click the base; evaluation protocols that ask for every link do.
        """
        return DefaultSession(self.asset, self.encoding, self.solver, moving=False)

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """Labels for all elements; see the protocol."""
        begin = time.perf_counter()
        steps = self._steps(prompts)
        labels = self._labels(steps, self._state(steps))
        return PartSegmentation(labels, "default", time.perf_counter() - begin)

    def candidates(self, prompts: Prompts, part: int) -> list[Bool]:
        """Up to five other masks for the latest click of ``part``, most useful first."""
        steps = self._steps(prompts)
        state = self._state(steps)
        if part not in state.scored or part not in state.parts:
            return []
        scored, mask = state.scored[part], state.parts[part].mask
        assert mask is not None
        masks, size = scored.proposals.masks, self.encoding.superpoints.size
        weight = self.finisher.weight
        out: list[Bool] = []
        shown = [self._labels(steps, state) == part]
        for index in offered(masks, scored.scores, mask, size, ALTERNATIVES + _SPARE):
            if len(out) == ALTERNATIVES:
                break
            mask = self._labels(steps, state.with_mask(part, masks[index])) == part
            # Attached handles make masks with and without them equal.
            if weight @ mask <= _ALL * self._all and not any(
                look_alike(mask, one, weight) for one in shown
            ):
                shown.append(mask)
                out.append(mask)
        return out

    def preview(self, superpoint: int) -> Bool:
        """(C,) the superpoints that a first click on one of them would take."""
        return self._updates.preview(superpoint)

    def _steps(self, prompts: Prompts) -> tuple[Step, ...]:
        return resolve(
            self.asset, self.encoding.nodes, prompts, self._clicks, self.finisher.first_of
        )

    def _labels(self, steps: tuple[Step, ...], state: SessionState) -> Int16:
        return self.finisher.labels(steps, state.parts)

    def _state(self, steps: tuple[Step, ...]) -> SessionState:
        steps = surface_steps(steps)
        keys = [hashlib.sha256(b"start").digest()]
        for step in steps:
            keys.append(hashlib.sha256(keys[-1] + _digest(step)).digest())
        # From the first on, so that the earlier states are kept for undo, too.
        known = [self._states.get(key) for key in keys]
        done = max((i for i, state in enumerate(known) if state is not None), default=0)
        state = known[done] or SessionState()
        for index in range(done, len(steps)):
            state = self._updates.after(state, steps[: index + 1])
            self._states[keys[index + 1]] = state
        return state


def _digest(step: Step) -> bytes:
    if isinstance(step, ClickStep):
        return repr((step.part, step.positive, step.element, step.node)).encode()
    return repr((step.part, step.positive)).encode() + step.elements.tobytes()


class DefaultSegmenter:
    """See :class:`~model.segmentation.registry.Segmenter`."""

    name = "default"

    def encode(self, asset: Asset, progress: Progress = no_progress) -> DefaultSession:
        """Encode ``asset``: 2 to 3 s at 100k points and at a million."""
        encoding = encode(asset, shipped_edge_model(), progress)
        domain: InputDomain = "mesh" if encoding.nodes.of_mesh else "cloud"
        if encoding.room is not None:
            domain = "room"
        solver = solver_of(encoding, *shipped_scorers(domain), shipped_moving_scorers())
        return DefaultSession(asset, encoding, solver)
