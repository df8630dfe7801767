"""The default segmenter: nothing to download, excellent on a CPU.

An asset becomes at most 100k nodes, a graph with learned edge strengths, about ten thousand
superpoints, three merge trees and three factorised random walks. A click gathers hypotheses (regions of
the trees, boxes, the earlier mask with a region added or cut, walks from the clicks, walks that
mend a mask) and a small network picks the one most like a part. Parts exclude each other. Small
parts of clouds are answered on the nodes round them, see ``closeup.py``.
"""

from __future__ import annotations

import hashlib
import itertools
import time
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.geometry.topology import coincident_faces
from model.segmentation.encode.edge_strength import shipped_edge_model
from model.segmentation.encode.encoding import Encoding, encode
from model.segmentation.encode.graph import components
from model.segmentation.finish.alternatives import ALTERNATIVES, look_alike, offered
from model.segmentation.finish.attached_shells import Fittings, fittings_of
from model.segmentation.finish.facets import Plates, plates_of
from model.segmentation.finish.local_refinement import ClosePart, Closeups
from model.segmentation.prompt_steps import (
    ClickStep,
    RegionStep,
    Step,
    enforce,
    resolve,
    surface_steps,
)
from model.segmentation.prompts import BASE, Click, PartSegmentation, Prompts
from model.segmentation.propose.boxes import ObjectSolver
from model.segmentation.propose.fronts import BAR_LENGTH
from model.segmentation.score.scorers import shipped_moving_scorers, shipped_scorers, solver_of
from model.segmentation.solver import (
    ALONE_BEHIND,
    NEARLY_ALL,
    PartSolver,
    PartState,
    Ranked,
    agreeing,
)

_STATES = 256
_CLICKS = 10_000
"""Of which it is kept what was clicked."""
_SPARE = 10
"""Other masks more than are shown, since some may turn out to be the same, or everything."""
_ALL = 0.99
"""Of the object: what takes more moves against nothing, and is no part."""
_ISLAND_ALONE = 0.8
"""Of its links: what has that many with one part lies beside that alone."""
_ISLAND_SHARE = 0.15
"""Of the part: what is larger is no handle."""
_TRIED = 12
"""First answers of a mesh that are looked at for one that takes no more than ``NEARLY_ALL``."""
_IN_VAIN = 2
"""Clicks in vain after which, in a room, one beside the part takes a region of its own along."""
_SPECK = 0.002
_SPECK_OF_PART = 0.1
_FAR_LARGER = 0.5
_CHOSEN_SHARE = 0.1
"""Of the mask: a region that changes more was chosen or drawn to replace what clicks brought."""

Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _State:
    """Where the session stands after some prompts; a pure function of them.

    Attributes:
        parts: masks and clicks of the parts other than the base.
        base: superpoints clicked as base.
        ranked: the hypotheses of the latest click of each part.
        close: what close-ups show of the small parts.
    """

    parts: dict[int, PartState] = field(default_factory=dict)
    base: tuple[int, ...] = ()
    ranked: dict[int, Ranked] = field(default_factory=dict)
    close: dict[int, ClosePart] = field(default_factory=dict)


class DefaultSession:
    """See :class:`~model.segmentation.protocol.SegmentationSession`.

    Attributes:
        asset: what was encoded.
        encoding: nodes, graph, superpoints, trees, walks.
        solver: hypotheses and scores for one part.
        groups: faces of a mesh that belong together.
        fittings: what the small shells of a mesh are fastened to.
        closeups: small parts of an object on the nodes themselves; None in a room.
        of_parts: first clicks mean parts that move, see :meth:`of_anything`.
    """

    def __init__(
        self, asset: Asset, encoding: Encoding, solver: PartSolver, *, of_parts: bool = True
    ) -> None:
        self.asset = asset
        self.encoding = encoding
        self.solver = solver
        self.of_parts = of_parts
        # An object's own hypotheses reach far enough; a room's objects are many regions.
        self._joins = encoding.room is not None
        # On meshes shells tell what is fastened; in a room what lies on a table is no handle of it.
        self._islands = asset.mesh is None and encoding.room is None
        self.closeups: Closeups | None = None
        if encoding.room is None and isinstance(solver, ObjectSolver):
            self.closeups = Closeups(encoding, solver.axes)
        # On meshes and in rooms the mask that is there says more than a first click.
        self._asks_anew = of_parts and isinstance(solver, ObjectSolver) and bool(solver.fronts)
        mesh = asset.mesh
        # A face that is there twice, once for either side, is one thing to whoever clicks on it.
        self._first_of = None if mesh is None else coincident_faces(mesh)
        self._weight = np.ones(asset.element_count, np.float32)
        if mesh is not None:
            self._weight = mesh.face_areas.astype(np.float32)
        self._all = float(self._weight.sum())
        self.groups: tuple[Plates, ...] = ()
        self.fittings: Fittings | None = None
        if mesh is not None:
            graph, face = encoding.graph, encoding.nodes.elements.element_of_node
            a, b = face[graph.a[~graph.bridge]], face[graph.b[~graph.bridge]]
            self.fittings = fittings_of(mesh, a, b)
            self.groups = (plates_of(mesh), self.fittings.shells)
        self._states: OrderedDict[bytes, _State] = OrderedDict()
        self._clicks: dict[Click, ClickStep] = {}

    def of_anything(self) -> DefaultSession:
        """The same for clicks that may mean the base, too, whatever part they are said to be of.

        People don't click the base: it is what they leave. Protocols that ask for every link in
        turn do.
        """
        return DefaultSession(self.asset, self.encoding, self.solver, of_parts=False)

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
        if part not in state.ranked or part not in state.parts:
            return []
        out: list[Bool] = []
        seen = [self._labels(steps, state) == part]
        for other in self._others(state, part):
            if len(out) == ALTERNATIVES:
                break
            own = self._labels(steps, other) == part
            if self._weight @ own > _ALL * self._all:
                continue
            # Handles go with what they are mounted on: with and without them is the same then.
            if not any(look_alike(own, one, self._weight) for one in seen):
                seen.append(own)
                out.append(own)
        return out

    def _others(self, state: _State, part: int) -> Iterator[_State]:
        """``state`` with other masks of ``part``, the most useful first; those of its close-up take
        turns with those of the whole object.
        """
        ranked, own = state.ranked[part], state.parts[part].mask
        assert own is not None
        masks, most = ranked.candidates.masks, ALTERNATIVES + _SPARE
        index = offered(masks, ranked.scores, own, self.encoding.superpoints.size, most)
        whole = (_with_mask(state, part, masks[i]) for i in index)
        close = state.close.get(part)
        if close is None or self.closeups is None:
            yield from whole
            return
        near = (
            replace(state, close={**state.close, part: one}) for one in self.closeups.others(close)
        )
        # A small answer on a mesh is mostly a whole shell, and what is meant is what holds it.
        turns = (near, whole) if self.asset.mesh is None else (whole, near)
        for other in itertools.chain.from_iterable(itertools.zip_longest(*turns)):
            if other is not None:
                yield other

    def preview(self, superpoint: int) -> Bool:
        """(C,) the superpoints that a first click on ``superpoint`` would take."""
        found = self.solver.first_answer(superpoint, of_a_part=self.of_parts)
        best = found.best
        if self.fittings is not None:
            node = int(np.argmax(self.encoding.superpoints.of_node == superpoint))
            element = int(self.encoding.nodes.elements.element_of_node[node])
            found = self._with_mount(found, PartState(), element, None)
            best = self._not_all(found, _State(), (ClickStep(1, True, element, node),))
        mask = self.solver.tidy(best, PartState(), superpoint)
        return self._with_islands(mask.astype(np.int16), ()) > BASE if self._islands else mask

    def _steps(self, prompts: Prompts) -> tuple[Step, ...]:
        if len(self._clicks) > _CLICKS:
            self._clicks.clear()
        return resolve(self.asset, self.encoding.nodes, prompts, self._clicks, self._first_of)

    # The state after each prompt ---------------------------------------------------------

    def _state(self, steps: tuple[Step, ...]) -> _State:
        steps = surface_steps(steps)
        keys = [hashlib.sha256(b"start").digest()]
        for step in steps:
            keys.append(hashlib.sha256(keys[-1] + _digest(step)).digest())
        done = len(steps)
        while done and keys[done] not in self._states:
            done -= 1
        state = self._states[keys[done]] if done else _State()
        for index in range(done, len(steps)):
            so_far = steps[: index + 1]
            after = self._completed(self._after(state, so_far), so_far)
            state = after if self.closeups is None else self._closer(state, after, so_far)
            self._states[keys[index + 1]] = state
        for key in keys[1:]:
            self._states.move_to_end(key)
        while len(self._states) > _STATES:
            self._states.popitem(last=False)
        return state

    def _after(self, state: _State, steps: tuple[Step, ...]) -> _State:
        """The state after the last of ``steps``, from that before it."""
        step = steps[-1]
        if isinstance(step, RegionStep):
            return self._after_region(state, step)
        superpoint = int(self.encoding.superpoints.of_node[step.node])
        if step.part == BASE:
            return self._after_base_click(state, superpoint, step.positive)
        parts, ranked = dict(state.parts), dict(state.ranked)
        handle: Bool | None = None
        own = parts.get(step.part, self._begun(state, step.part))
        inside = own.mask is not None and bool(own.mask[superpoint])
        others = {q: s for q, s in parts.items() if q != step.part and s.mask is not None}
        if inside == step.positive and own.mask is not None:
            # The answer already agrees: a click that confirms must not disturb anything.
            parts[step.part] = agreeing(own, superpoint, step.positive)
        else:
            blocked = np.zeros(len(self.encoding.superpoints), bool)
            for other in others.values():
                if step.positive and not other.mask[superpoint]:  # type: ignore[index]
                    blocked |= other.mask  # type: ignore[operator]
            handle = (
                self._handle_of(superpoint, others) if step.positive and own.mask is None else None
            )
            if handle is not None:
                blocked |= ~handle
            self.encoding.walk.prefetch(superpoint)
            found = self.solver.answer(
                own, superpoint, step.positive, blocked, of_a_part=self.of_parts
            )
            if step.positive and own.mask is None:
                found = self._with_mount(found, own, step.element, blocked)
            best = found.best
            if step.positive and own.mask is None and self.fittings is not None:
                best = self._not_all(found, state, steps)
            mask = self.solver.tidy(best, own, superpoint) & ~blocked
            if self._joins and step.positive and own.mask is not None and own.stalls >= _IN_VAIN:
                mask = self._not_in_vain(own, mask, superpoint, blocked)
            parts[step.part] = self.solver.moved(own, superpoint, step.positive, mask)
            ranked[step.part] = found
        if step.positive:
            taken = parts[step.part].mask
            assert taken is not None
            for q, other in others.items():
                assert other.mask is not None
                if other.mask[superpoint] and handle is None:
                    # The click says that this part was too large: ask again what it is.
                    rest = _union([s.mask for r, s in parts.items() if r != q], len(taken))
                    parts[q], ranked[q] = self._without(other, superpoint, rest)
                else:
                    parts[q] = replace(agreeing(other, superpoint, False), mask=other.mask & ~taken)
        return _State(parts, state.base, ranked)

    def _without(self, own: PartState, superpoint: int, rest: Bool) -> tuple[PartState, Ranked]:
        """A part after a click on something else that it had taken, and its hypotheses.

        One click so far: what that meant is asked anew, knowing more. Else the mask is mended.

        Args:
            rest: (C,) what other parts have now.
        """
        if not self._asks_anew or len(own.positive) != 1 or own.drawn or own.run:
            found = self.solver.answer(own, superpoint, False, rest, of_a_part=self.of_parts)
            return self.solver.moved(own, superpoint, False, found.best & ~rest), found
        (first,) = own.positive
        begun = agreeing(
            PartState(negative=own.negative, agreed=(0, own.agreed[1])), superpoint, False
        )
        free = rest.copy()
        free[first] = False
        found = self.solver.answer(begun, first, True, free)
        mask = self.solver.tidy(found.best, begun, first) & ~free
        return self.solver.moved(begun, first, True, mask), found

    def _handle_of(self, superpoint: int, others: dict[int, PartState]) -> Bool | None:
        """(C,) the handle that a superpoint is on, where another part has it and what is behind it: who
        clicks there wants no half of a door, but the handle as a part of its own.
        """
        if not self._asks_anew:
            return None
        assert isinstance(self.solver, ObjectSolver) and self.solver.fronts is not None
        bar = self.solver.fronts.bar(superpoint)
        if bar is None or bar.length < BAR_LENGTH:
            return None
        size = self.encoding.superpoints.size
        for other in others.values():
            mask = other.mask
            assert mask is not None
            if mask[superpoint] and size[mask & bar.behind].sum() > 0.5 * size[bar.behind].sum():
                return bar.superpoints | (np.arange(len(size)) == superpoint)
        return None

    def _with_mount(
        self, found: Ranked, own: PartState, element: int, blocked: Bool | None
    ) -> Ranked:
        """First answers to a click on a mesh's handle: what a click beside it, on what it moves,
        means; then the handle alone.

        Args:
            found: the answers to the click itself, on ``element``.
        """
        if self.fittings is None or not self.of_parts:
            return found
        face = self.fittings.mount(element)
        if face is None:
            return found
        elements, of_node = self.encoding.nodes.elements, self.encoding.superpoints.of_node
        superpoint, beside = (int(of_node[elements.node_of_element[f]]) for f in (element, face))
        if superpoint == beside or (blocked is not None and blocked[beside]):
            return found
        moved = self.solver.answer(own, beside, True, blocked)
        masks = moved.candidates.masks.copy()
        masks[:, superpoint] = True
        moved = replace(moved, candidates=replace(moved.candidates, masks=masks))
        alone = found.take(np.flatnonzero(~found.candidates.masks[:, beside]))
        if not len(alone.scores):
            return moved
        behind = alone.scores.max() - moved.scores.max() + ALONE_BEHIND
        return Ranked.of([moved, replace(alone, scores=alone.scores - max(behind, 0.0))])

    def _not_all(self, found: Ranked, state: _State, steps: tuple[Step, ...]) -> Bool:
        """The best first answer that plates and shells don't make all that is left of the mesh.

        The solver has none of the whole object, but faces may be far more than their superpoints.
        """
        masks, part = found.candidates.masks, steps[-1].part
        for index in np.argsort(-found.scores, kind="stable")[:_TRIED]:
            labels = self._labels(steps, _with_mask(state, part, masks[index]))
            taken, left = (self._weight[labels == p].sum() for p in (part, BASE))
            if taken <= NEARLY_ALL * (taken + left):
                return masks[index]
        return found.best

    def _not_in_vain(self, own: PartState, mask: Bool, superpoint: int, blocked: Bool) -> Bool:
        """``mask``, widened where yet another positive click beside it brought hardly anything.

        A person who keeps clicking there means more than a speck: the best first answer there that
        is neither a speck nor far larger than the part joins it.
        """
        size = self.encoding.superpoints.size
        total = size.sum()
        assert own.mask is not None
        least = min(_SPECK * total, _SPECK_OF_PART * size[own.mask].sum())
        if size[mask & ~own.mask].sum() >= least:
            return mask
        apart = (
            (self.encoding.superpoints.center - self.encoding.superpoints.center[superpoint]) ** 2
        ).sum(1)
        if size[apart < apart[own.mask].min()].sum() < least:
            # Right beside the part a click means what it brought: a near-perfect mask is mended.
            return mask
        most = max(_FAR_LARGER * size[own.mask].sum(), 20 * least)
        first = self.solver.first_answer(superpoint)
        for index in np.argsort(-first.scores, kind="stable"):
            more = first.candidates.masks[index] & ~blocked
            if not more[superpoint] or more[list(own.negative)].any():
                continue
            if least <= size[more & ~mask].sum() <= most:
                return mask | more
        return mask

    def _begun(self, state: _State, part: int) -> PartState:
        """A part without clicks of its own: what was clicked as something else is not in it."""
        superpoints = [c for q, s in state.parts.items() if q != part for c in s.positive]
        foreign = tuple(dict.fromkeys([*state.base, *superpoints]))
        return PartState(negative=foreign, agreed=(0, len(foreign)))

    def _after_base_click(self, state: _State, superpoint: int, positive: bool) -> _State:
        if not positive:
            return replace(state, base=tuple(c for c in state.base if c != superpoint))
        parts, ranked = dict(state.parts), dict(state.ranked)
        for part, own in state.parts.items():
            if own.mask is not None and own.mask[superpoint]:
                none = np.zeros(len(own.mask), bool)
                parts[part], ranked[part] = self._without(own, superpoint, none)
            else:
                parts[part] = agreeing(own, superpoint, False)
        base = (*(c for c in state.base if c != superpoint), superpoint)
        return _State(parts, base, ranked)

    def _after_region(self, state: _State, step: RegionStep) -> _State:
        superpoints = self.encoding.superpoints
        inside = (
            np.bincount(superpoints.of_node[step.nodes], minlength=len(superpoints))
            > 0.5 * superpoints.size
        )
        parts = dict(state.parts)
        for part, own in state.parts.items():
            if own.mask is not None and (step.positive or part == step.part):
                parts[part] = replace(own, mask=own.mask & ~inside)
        if step.positive and step.part != BASE:
            own = parts.get(step.part, self._begun(state, step.part))
            before = own.mask if own.mask is not None else np.zeros(len(superpoints), bool)
            parts[step.part] = replace(own, mask=before | inside)
        own, now = state.parts.get(step.part), parts.get(step.part)
        if own is not None and own.positive and own.mask is not None and now is not None:
            # After clicks, a region that changes this much is what the person settled for.
            assert now.mask is not None
            changed = superpoints.size[now.mask ^ own.mask].sum()
            if changed > _CHOSEN_SHARE * superpoints.size[now.mask].sum():
                parts[step.part] = replace(now, drawn=own.drawn + 1)
        return replace(state, parts=parts)

    # Labels --------------------------------------------------------------------------

    def _labels(self, steps: tuple[Step, ...], state: _State) -> npt.NDArray[np.int16]:
        told = surface_steps(steps)
        of_superpoint = self._of_cells(state, told)
        of_node = of_superpoint[self.encoding.superpoints.of_node]
        self._split_cells(of_node, of_superpoint, told)
        if self.closeups is not None:
            self.closeups.place(of_node, state.close)
        labels = self.encoding.nodes.elements.to_elements(of_node)
        if not steps:
            return labels
        labels = self._whole(labels, steps)
        labels = enforce(
            labels, steps, self._instead(steps, of_superpoint), _released(steps, labels)
        )
        return labels if self._first_of is None else labels[self._first_of]

    def _whole(
        self, labels: npt.NDArray[np.int16], steps: tuple[Step, ...]
    ) -> npt.NDArray[np.int16]:
        """``labels`` of faces with plates and shells undivided, fittings where they belong."""
        for plates in self.groups:
            labels = plates.whole(labels, steps)
        labels = labels if self.fittings is None else self.fittings.joined(labels, steps)
        return labels if self._first_of is None else labels[self._first_of]

    def without_prompts(self, of_superpoint: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
        """(E,) labels of the parts that superpoints (C,) were given by something else than prompts."""
        of_superpoint = self._with_islands(of_superpoint, ()) if self._islands else of_superpoint
        superpoints, elements = self.encoding.superpoints, self.encoding.nodes.elements
        labels = self._whole(elements.to_elements(of_superpoint[superpoints.of_node]), ())
        if self.fittings is None:
            return labels
        return self.fittings.joined(self.fittings.merged(self.fittings.freed(labels)), ())

    def _of_cells(self, state: _State, steps: tuple[Step, ...]) -> npt.NDArray[np.int16]:
        """(C,) the part of each superpoint, islands with what they lie beside."""
        out = np.zeros(len(self.encoding.superpoints), np.int16)
        for part, own in state.parts.items():
            if own.mask is not None:
                out[own.mask] = part
        return self._with_islands(out, steps) if self._islands else out

    def _completed(self, state: _State, steps: tuple[Step, ...]) -> _State:
        """``state`` with islands in the masks: the next click is about what is seen."""
        if not self._islands or not state.parts:
            return state
        of_superpoint = self._of_cells(state, steps)
        parts = {
            part: own if own.mask is None else replace(own, mask=own.mask | (of_superpoint == part))
            for part, own in state.parts.items()
        }
        return replace(state, parts=parts)

    def _closer(self, before: _State, after: _State, steps: tuple[Step, ...]) -> _State:
        """``after`` with what close-ups show: the next click is about what is seen."""
        assert self.closeups is not None
        close = self.closeups.after(before.close, after.parts, steps)
        parts = dict(after.parts)
        for part, its in close.items():
            parts[part] = replace(parts[part], mask=self.closeups.superpoints(its, parts[part]))
        return replace(after, parts=parts, close=close)

    def _with_islands(
        self, of_superpoint: npt.NDArray[np.int16], steps: tuple[Step, ...]
    ) -> npt.NDArray[np.int16]:
        """``of_superpoint`` where small pieces of the base beside one part alone belong to it.

        A handle in front of a door, its window, a hole in what clicks found. Pieces of which a
        prompt says something else stay as they are, and so do those beside a part that was drawn.
        """
        superpoints, links = self.encoding.superpoints, self.encoding.superpoints.links
        width, free = int(of_superpoint.max()) + 1, of_superpoint == BASE
        one, two = free[links.a], free[links.b]
        inner = one & two
        count, piece = components(len(superpoints), links.a[inner], links.b[inner])
        size = np.bincount(piece[free], superpoints.size[free], count)
        out, back = np.flatnonzero(one & ~two), np.flatnonzero(two & ~one)
        mine = np.concatenate([links.a[out], links.b[back]])
        beside = np.concatenate([links.b[out], links.a[back]])
        weight = links.count[np.concatenate([out, back])]
        key = piece[mine].astype(np.int64) * width + of_superpoint[beside]
        votes = np.bincount(key, weight, count * width).reshape(count, width)
        best = votes.argmax(1)
        part_size = np.bincount(of_superpoint, superpoints.size, width)
        joins = (best != BASE) & (votes.max(1) >= _ISLAND_ALONE * votes.sum(1))
        joins &= size <= _ISLAND_SHARE * part_size[best]
        joins[size.argmax()] = False  # something has to stay behind
        # Whoever draws a part has drawn its handle, too, or left it out.
        last = {step.part: step for step in steps}
        drawn = [part for part, step in last.items() if isinstance(step, RegionStep)]
        if drawn:
            joins &= ~np.isin(best, drawn)
        for step in steps:
            # What was said to be a part and is the base has been taken back since.
            if step.positive and step.part != BASE:
                continue
            nodes = step.node if isinstance(step, ClickStep) else step.nodes
            told = np.unique(piece[superpoints.of_node[nodes]])
            joins[told] &= (not step.positive) & (best[told] != step.part)
        return np.where(free & joins[piece], best[piece], of_superpoint).astype(np.int16)

    def _split_cells(
        self,
        of_node: npt.NDArray[np.int16],
        of_superpoint: npt.NDArray[np.int16],
        steps: tuple[Step, ...],
    ) -> None:
        """Share the nodes of superpoints that were clicked for different parts among those clicks.

        A border may run through a superpoint: each of its nodes follows the nearest click. Changes
        ``of_node`` in place.
        """
        superpoints, points = self.encoding.superpoints, self.encoding.nodes.points
        said: dict[int, dict[int, ClickStep]] = {}
        for step in steps:
            if isinstance(step, ClickStep):
                said.setdefault(int(superpoints.of_node[step.node]), {})[step.node] = step
        for superpoint, clicks in said.items():
            if len(clicks) < 2:
                continue
            own = int(of_superpoint[superpoint])
            wanted = [
                s.part if s.positive else (own if own != s.part else BASE) for s in clicks.values()
            ]
            if len(set(wanted)) > 1:
                nodes = np.nonzero(superpoints.of_node == superpoint)[0]
                apart = points[nodes][:, None] - points[list(clicks)][None]
                nearest = np.linalg.norm(apart, axis=2).argmin(1)
                of_node[nodes] = np.array(wanted, np.int16)[nearest]

    def _instead(
        self, steps: tuple[Step, ...], of_superpoint: npt.NDArray[np.int16]
    ) -> npt.NDArray[np.int16]:
        """What refused elements become: the base, or the nearest part where the base is refused."""
        count = self.asset.element_count
        taken = np.nonzero(of_superpoint)[0]
        if not len(taken) or all(s.positive or s.part != BASE for s in steps):
            return np.zeros(count, np.int16)
        superpoints = self.encoding.superpoints
        _, near = KDTree(superpoints.center[taken]).query(superpoints.center)
        nearest = of_superpoint[taken[near]]
        instead = np.where(of_superpoint == BASE, nearest, BASE).astype(np.int16)
        return self.encoding.nodes.elements.to_elements(instead[superpoints.of_node])


def _with_mask(state: _State, part: int, mask: Bool) -> _State:
    """``state`` if the superpoints of ``part`` were ``mask``; it has no close-up then."""
    parts = {
        other: its if its.mask is None else replace(its, mask=its.mask & ~mask)
        for other, its in state.parts.items()
    }
    parts[part] = replace(state.parts.get(part, PartState()), mask=mask)
    close = {other: its for other, its in state.close.items() if other != part}
    return replace(state, parts=parts, close=close)


def _released(steps: tuple[Step, ...], labels: npt.NDArray[np.int16]) -> dict[int, Bool]:
    """For each region that a later click contradicts, the elements that the click has taken.

    A click inside a region of another part says that the region was too much there: what the
    click's part takes is its own, the rest of the region stays.
    """
    out: dict[int, Bool] = {}
    for index, step in enumerate(steps):
        if not isinstance(step, RegionStep) or not len(step.elements):
            continue
        for later in steps[index + 1 :]:
            if not isinstance(later, ClickStep) or not _contains(step.elements, later.element):
                continue
            free = None
            if step.positive and later.positive and later.part != step.part:
                free = labels == later.part
            elif later.part == step.part and later.positive != step.positive:
                free = (labels == step.part) == later.positive
            if free is not None:
                out[index] = out[index] | free if index in out else free
    return out


def _union(masks: list[Bool | None], count: int) -> Bool:
    out = np.zeros(count, bool)
    for mask in masks:
        if mask is not None:
            out |= mask
    return out


def _contains(ordered: npt.NDArray[np.int64], value: int) -> bool:
    at = int(np.searchsorted(ordered, value))
    return at < len(ordered) and int(ordered[at]) == value


def _digest(step: Step) -> bytes:
    if isinstance(step, ClickStep):
        return repr((step.part, step.positive, step.element, step.node)).encode()
    return repr((step.part, step.positive)).encode() + step.elements.tobytes()


class DefaultSegmenter:
    """See :class:`~model.segmentation.protocol.Segmenter`."""

    name = "default"

    def encode(self, asset: Asset, progress: Progress = no_progress) -> DefaultSession:
        """Encode ``asset``: 2 to 3 s at 100k points and at a million."""
        encoding = encode(asset, shipped_edge_model(), progress)
        thing = "mesh" if encoding.nodes.of_mesh else "cloud"
        met = thing if encoding.room is None else "room"
        solver = solver_of(encoding, *shipped_scorers(met), shipped_moving_scorers())
        return DefaultSession(asset, encoding, solver)
