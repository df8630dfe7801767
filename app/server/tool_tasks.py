"""Tools and the preview under the pointer, as the worker processes run them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.segmenting_tasks import StoredRegion, prompts_of, session_of
from app.server.tasks import arrays_of, asset_of
from model.core.asset import Asset
from model.core.errors import CommandError
from model.core.lru_cache import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.sampling import sample_surface
from model.geometry.splitting import split_faces
from model.segmentation.prompts import BASE, Click, Prompts
from model.segmentation.registry import DEFAULT
from model.segmentation.tools.all_parts import propose, without_leftovers
from model.segmentation.tools.connected import connected, grow
from model.segmentation.tools.cuts import Cut, line_cut, pieces
from model.segmentation.tools.rectangles import rectangle_cut, surface_frame
from model.segmentation.tools.similar import mirrored, same_shape
from sessions.tool_commands import FaceCut

Bool = npt.NDArray[np.bool_]
Point = tuple[float, float, float]

NEW_PART = -1
SAMPLE_POINTS = 150_000
HOVER_POINTS = 8_000
NEXT_MASK = "next mask"
PROPOSE = "propose"
_LEAST_PIECE = 0.01
"""Share of a part that a piece needs to become a part of its own."""


_SWALLOWED = 0.25
"""Of a part: what looks like another part and is less of it has been taken along by mistake."""


@dataclass(frozen=True)
class RegionOffer:
    """Elements that a tool gives to a part, or takes from it. ``NEW_PART`` asks for a new part."""

    part: int
    elements: str
    count: int
    positive: bool = True


@dataclass(frozen=True)
class FaceCutOffer:
    """A cut that splits faces, with what the parts hold afterwards.

    Attributes:
        cut: what is split.
        regions: of all parts but the base.
        labels: reference of the stored labels of all faces.
        counts: label → number of faces.
    """

    cut: FaceCut
    regions: tuple[RegionOffer, ...]
    labels: str
    counts: dict[int, int]


@dataclass(frozen=True)
class MaskOffer:
    """Another mask for the last click.

    Attributes:
        regions: what it adds to the answer and takes from it; none for the answer itself.
        number: which one it is, 0 for the answer.
        total: masks that there are, with the answer.
    """

    regions: list[RegionOffer]
    number: int
    total: int


Offer = list[RegionOffer] | FaceCutOffer | MaskOffer
"""What came of a tool."""


@dataclass(frozen=True)
class ToolRequest:
    """What a person asks of a tool.

    Attributes:
        tool: a key of :data:`TOOLS`.
        part: the chosen part.
        turn: which mask "next mask" shows, round and round; 0 is the answer to the clicks. As a
            person asks: how many on from the one that is shown.
        other: the part to merge into the chosen one.
        places: clicked places for a cut, metres, with the element of the first one.
        element: see ``places``.
        view: (3,) the direction that the person looks in.
        exact: a rectangle lies where it was clicked, whatever is close by.
        free_part: the lowest id that no part has.
    """

    tool: str
    part: int
    turn: int = 0
    other: int | None = None
    places: tuple[Point, ...] = ()
    element: int | None = None
    view: Point | None = None
    exact: bool = False
    free_part: int = NEW_PART


@dataclass(frozen=True)
class _Work:
    """What a tool works on."""

    request: ToolRequest
    folder: Path
    workspace: Path
    session: Any
    prompts: Prompts
    progress: Progress = no_progress

    @cached_property
    def labels(self) -> npt.NDArray[np.int16]:
        return self.session.segment(self.prompts).labels

    @cached_property
    def mask(self) -> Bool:
        """The chosen part.

        Raises:
            CommandError: where it has no element yet.
        """
        mask = self.labels == self.request.part
        if not mask.any():
            raise CommandError("this part has nothing yet: click on it first")
        return mask

    @cached_property
    def encoded(self) -> Any:
        """The default segmenter's encoding, which the tools work on whoever answers the clicks."""
        if hasattr(self.session, "encoding"):
            return self.session
        return session_of(self.folder, DEFAULT)

    def offer(self, mask: Bool, part: int, positive: bool = True) -> list[RegionOffer]:
        """One offer; none where the mask is empty."""
        elements = np.flatnonzero(mask).astype(np.int64)
        if not len(elements):
            return []
        ref = arrays_of(self.workspace).put(elements)
        return [RegionOffer(part, ref, len(elements), positive)]


def use_tool(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    request: ToolRequest,
    progress: Progress = no_progress,
) -> Offer:
    """What a segmentation tool makes of the parts.

    Raises:
        CommandError: for an unknown tool, or where it can't work on what there is.
    """
    tool = TOOLS.get(request.tool)
    if tool is None:
        raise CommandError(f"no tool is called {request.tool!r}; there are {', '.join(TOOLS)}")
    session = session_of(folder, segmenter, progress)
    prompts = prompts_of(workspace, items)
    return tool(_Work(request, folder, workspace, session, prompts, progress))


def _propose(work: _Work) -> list[RegionOffer]:
    labels = propose(work.encoded, progress=work.progress).labels
    # What is a part already stays as it is; most of what is new lies beside it.
    taken = work.labels > BASE
    out: list[RegionOffer] = []
    for part in np.unique(labels[labels > BASE]):
        mask = labels == part
        if 2 * np.count_nonzero(mask & ~taken) > np.count_nonzero(mask):
            out += work.offer(mask & ~taken, NEW_PART)
    return out


def _next_mask(work: _Work) -> MaskOffer:
    part = work.request.part
    others = work.session.candidates(work.prompts, part)
    total = len(others) + 1
    number = work.request.turn % total
    if not number:
        return MaskOffer([], 0, total)
    mask, chosen = work.labels == part, others[number - 1]
    regions = work.offer(mask & ~chosen, part, False) + work.offer(chosen & ~mask, part)
    return MaskOffer(regions, number, total)


def _connected(work: _Work) -> list[RegionOffer]:
    part = work.request.part
    clicks = [c for c in work.prompts.clicks if c.part == part and c.positive]
    if not clicks:
        raise CommandError("click on the part first; what is connected with it joins it")
    others = (work.labels > BASE) & (work.labels != part)
    found = connected(work.encoded, clicks[-1].position, clicks[-1].element, others)
    more = found.mask & (work.labels != part)
    if found.nearly_all and more.any():
        what = "no other part has" if others.any() else "there is"
        raise CommandError(
            f"nearly all that {what} hangs together here, and nothing was taken: clicks, a lasso "
            "(L) or a cut (K) tell apart what no gap does"
        )
    return work.offer(more, part)


def _same_shape(work: _Work) -> list[RegionOffer]:
    return _beside_parts(work, same_shape(work.encoded, work.mask))


def _mirror(work: _Work) -> list[RegionOffer]:
    return _beside_parts(work, [mirrored(work.encoded, work.mask)])


def _beside_parts(work: _Work, masks: list[Bool]) -> list[RegionOffer]:
    """New parts out of masks that look like the chosen one."""
    out: list[RegionOffer] = []
    labels, part = work.labels, work.request.part
    ids = labels - labels.min()
    held = np.bincount(ids)
    for mask in masks:
        # What other parts have already stays theirs, so that asking twice finds nothing twice; but
        # a small piece of a large part, a knob that a panel took along, is found.
        swallowed = np.bincount(ids[mask], minlength=len(held)) < _SWALLOWED * held
        free = mask & ((labels == BASE) | (swallowed[ids] & (labels != part)))
        if free.sum() > 0.5 * mask.sum():
            out += work.offer(free, NEW_PART)
    return out


def _grow(work: _Work) -> list[RegionOffer]:
    return work.offer(grow(work.encoded, work.mask, 1) & ~work.mask, work.request.part)


def _shrink(work: _Work) -> list[RegionOffer]:
    kept = grow(work.encoded, work.mask, -1)
    return work.offer(work.mask & ~kept, work.request.part, False) if kept.any() else []


def _split(work: _Work) -> list[RegionOffer]:
    least = _LEAST_PIECE * work.mask.sum()
    out: list[RegionOffer] = []
    for piece in pieces(work.encoded, work.mask)[1:]:
        if piece.sum() >= least:
            out += work.offer(piece, NEW_PART)
    return out


def _cut(work: _Work) -> list[RegionOffer] | FaceCutOffer:
    request, labels = work.request, work.labels
    if request.element is None:
        raise CommandError("a cut needs the places that were clicked")
    # What is cut is what was clicked; what comes off goes to the chosen part while that has
    # nothing yet, else to a new one.
    part = int(labels[request.element])
    mask = labels == part
    if request.tool == "rectangle":
        cut = rectangle_cut(
            work.encoded, mask, request.places, request.view, snap=not request.exact
        )
    else:
        cut = line_cut(work.encoded, mask, request.places, request.view)
    empty = request.part not in (part, BASE) and not (labels == request.part).any()
    target = request.part if empty else request.free_part
    asset = asset_of(work.folder)
    if cut.splits_faces(asset):
        return _face_cut(work, asset, cut, target)
    off = cut.inside(asset)
    rest = mask & ~off
    if request.tool == "cut" and off.sum() > rest.sum():
        off = rest
    if not off.any():
        raise CommandError("nothing of the part lies there: click on the part that is to be cut")
    return work.offer(off, target)


def frame_at(folder: Path, place: Point, view: Point) -> tuple[Point, Point]:
    """Out of the surface at a place, and level along it: how a rectangle begun there will lie."""
    out, across = surface_frame(session_of(folder, DEFAULT), np.array([place]), view)
    return tuple(out.tolist()), tuple(across.tolist())


def _face_cut(work: _Work, asset: Asset, cut: Cut, target: int) -> FaceCutOffer:
    """The parts after a cut that splits faces, by the numbers that those have then."""
    assert asset.mesh is not None
    split = split_faces(asset.mesh, cut.chosen, cut.planes)
    off, labels = split.inside, work.labels[split.parent]
    if cut.whole is not None:
        off = off | cut.whole[split.parent]
    if work.request.tool == "cut":
        area = split.mesh.face_areas
        rest = cut.chosen[split.parent] & ~off
        off = off if area[off].sum() <= area[rest].sum() else rest
    labels[off] = target
    arrays = arrays_of(work.workspace)
    chosen = arrays.put(np.flatnonzero(cut.chosen).astype(np.int64))
    parts, counts = np.unique(labels, return_counts=True)
    regions: list[RegionOffer] = []
    for part in parts[parts > BASE].tolist():
        regions += work.offer(labels == part, part)
    return FaceCutOffer(
        FaceCut(chosen, cut.planes),
        tuple(regions),
        arrays.put(labels),
        dict(zip(parts.tolist(), counts.tolist(), strict=True)),
    )


def _merge(work: _Work) -> list[RegionOffer]:
    other, part = work.request.other, work.request.part
    if other is None or other == part:
        raise CommandError("choose another part to merge with this one")
    return work.offer(work.labels == other, part)


def _leftovers(work: _Work) -> list[RegionOffer]:
    clean = without_leftovers(work.encoded, work.labels)
    moved = clean != work.labels
    out: list[RegionOffer] = []
    for part in np.unique(clean[moved]):
        out += work.offer(moved & (clean == part), int(part))
    return out


TOOLS: dict[str, Callable[[_Work], Offer]] = {
    PROPOSE: _propose,
    NEXT_MASK: _next_mask,
    "connected": _connected,
    "same shape": _same_shape,
    "mirror": _mirror,
    "grow": _grow,
    "shrink": _shrink,
    "split": _split,
    "cut": _cut,
    "rectangle": _cut,
    "merge": _merge,
    "leftovers": _leftovers,
}
"""The one table of tools."""


# --- the preview under the pointer ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class HoverAnswer:
    """What a click would give to the part and take from it, as points on the surface.

    Attributes:
        gained, lost: (K, 3) metres; at most ``HOVER_POINTS`` of them.
        count: elements that would change.
    """

    gained: npt.NDArray[np.float32]
    lost: npt.NDArray[np.float32]
    count: int


@dataclass(frozen=True, eq=False)
class _Sample:
    """Points spread over an asset's surface in random order, and the element of each."""

    points: npt.NDArray[np.float32]
    element: npt.NDArray[np.int64]

    def inside(self, mask: Bool) -> npt.NDArray[np.float32]:
        """(K, 3) the first points on the elements of a mask."""
        return self.points[np.flatnonzero(mask[self.element])[:HOVER_POINTS]]


@dataclass
class _Now:
    """The labels before the hovered click; of one process."""

    key: Any = None
    labels: npt.NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, np.int16))


_samples: LruCache[Path, _Sample] = LruCache(8)
_now = _Now()


def hover(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    click: Click,
) -> HoverAnswer:
    """What would change if ``click`` were said now: the segmenter's own answer, kept by nobody."""
    session = session_of(folder, segmenter)
    prompts = prompts_of(workspace, items)
    key = (folder, segmenter, prompts.key())
    if _now.key != key:
        _now.key, _now.labels = key, session.segment(prompts).labels
    after = session.segment(Prompts((*prompts.items, click))).labels
    before = _now.labels
    gained = (after == click.part) & (before != click.part)
    lost = (before == click.part) & (after != click.part)
    sample = _samples.get(folder, lambda: _sample(folder))
    return HoverAnswer(sample.inside(gained), sample.inside(lost), int(gained.sum() + lost.sum()))


def _sample(folder: Path) -> _Sample:
    asset, rng = asset_of(folder), np.random.default_rng(0)
    if asset.mesh is not None:
        cloud, face = sample_surface(asset.mesh, SAMPLE_POINTS, rng)
        return _Sample(cloud.points.astype(np.float32), np.asarray(face, np.int64))
    assert asset.cloud is not None
    chosen = rng.permutation(len(asset.cloud))[:SAMPLE_POINTS]
    return _Sample(np.asarray(asset.cloud.points[chosen], np.float32), chosen)
