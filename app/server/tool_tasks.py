"""Jobs of the segmentation tools, of the preview under the pointer, and those that find which
accepted object an open one is like, and carry its parts over.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from app.server.segmenting_tasks import StoredRegion, prompts_of, session_of
from app.server.tasks import arrays_of, asset_of
from model.core.asset import Asset
from model.core.errors import ArtiworldError, CommandError
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.geometry.like_object import Example, best_match, example_of
from model.geometry.sampling import sample_surface
from model.geometry.splitting import split_faces
from model.io.assets.reader import load_object
from model.prediction.experience import masks_in_use
from model.segmentation.all_parts import absorb_small_components, propose_parts
from model.segmentation.mask_tools import (
    Cut,
    connected,
    connected_components,
    grow,
    line_cut,
    rectangle_cut,
    surface_frame,
    to_elements,
)
from model.segmentation.prompt_steps import locate
from model.segmentation.prompts import BASE, Click, Prompts
from model.segmentation.registry import DEFAULT
from model.segmentation.similar import ProposedParts, carry_over, mirrored, same_shape, telling
from model.segmentation.solver import look_alike
from sessions.document import FaceCut

Bool = npt.NDArray[np.bool_]
Point = tuple[float, float, float]

NEW_PART = -1
SAMPLE_POINTS = 150_000
"""Surface points from which previews are drawn."""
HOVER_POINTS, LEAST_FILL = 8_000, 12
"""Most points along a preview's outline; within it are a fourth of them, or these few, so that what
lies below stays visible."""
_NEIGHBOURS = 6
"""Nearest points, one of which lies outside where an outline is."""
NEXT_MASK = "next mask"
PROPOSE = "propose"
_MIN_PIECE = 0.01
"""Least share of a part that becomes a part of its own when it is split."""
_SWALLOWED = 0.25
"""A match that is a smaller share of a part was included in it by mistake."""
LIKE = "like"
"""First word of the recorded tool; the second one is the asset's folder."""
FIT, AGREEMENT = 0.9, 0.6
"""Least fit and agreement of an offer; chosen on 37 objects scanned twice (docs/annotate.md)."""
CLOSE_FIT, LITTLE_AGREEMENT = 0.97, 0.2
"""The same where the shapes hardly differ: clicks that are answered badly are those to save."""
_examples: LruCache[tuple[Path, int], Example | None] = LruCache(256)


@dataclass(frozen=True)
class RegionOffer:
    """Elements that a tool adds to a part or removes from it; ``NEW_PART`` is a new one."""

    part: int
    elements: str
    count: int
    positive: bool = True
    points: npt.NDArray[np.float32] | None = None
    """(M, 3) places on what is shown before it is taken, metres."""
    name: str | None = None
    known: int = 0
    """Accepted objects that it was compared with."""


@dataclass(frozen=True)
class FaceCutOffer:
    """A cut that splits faces, with the parts afterwards.

    Attributes:
        cut: the faces to split and where.
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
        regions: its difference from the segmenter's first choice; none for that itself.
        number: steps from the first choice to it, towards larger ones, modulo ``total``.
        total: number of masks, the first choice included.
        rank: how many of them are smaller.
        share: of the surface that it covers, 0..1.
    """

    regions: list[RegionOffer]
    number: int
    total: int
    rank: int = 0
    share: float = 0.0


Offer = list[RegionOffer] | FaceCutOffer | MaskOffer
"""The result of a tool."""


@dataclass(frozen=True)
class ToolRequest:
    """A person's request to a tool.

    Attributes:
        tool: a key of :data:`TOOLS`.
        part: the selected part.
        turn: steps from the mask shown to the one to show; in the worker its number (modulo the
            number of masks, 0 is the segmenter's first choice).
        other: the part to merge into the selected one.
        places: clicked places of a cut, metres. element: the element of the first one.
        view: (3,) viewing direction.
        exact: whether a rectangle stays where it was clicked instead of snapping to edges.
        free_part: the lowest unused part id.
        category: of the object, or the likeliest one, or None.
        name: of the selected part, where the tool makes it.
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
    category: str | None = None
    name: str | None = None


@dataclass(frozen=True)
class _Input:
    """The input of a tool."""

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
        """The selected part.

        Raises:
            CommandError: where it is empty.
        """
        mask = self.labels == self.request.part
        if not mask.any():
            raise CommandError("this part is empty: click on it first")
        return mask

    @cached_property
    def weight(self) -> npt.NDArray[np.floating]:
        """(E,) size of each element: m² of faces, the same for all points."""
        mesh = asset_of(self.folder, textures=False).mesh
        return np.ones(len(self.labels)) if mesh is None else mesh.face_areas

    @cached_property
    def encoded(self) -> Any:
        """The default segmenter's encoding, which the tools need whatever segmenter is chosen."""
        if hasattr(self.session, "encoding"):
            return self.session
        return session_of(self.folder, DEFAULT)

    def offer(self, mask: Bool, part: int, positive: bool = True) -> list[RegionOffer]:
        """Return the offer of a mask's elements; none where it is empty."""
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
    """Run a segmentation tool.

    Raises:
        CommandError: for an unknown tool, or where it can't work on the present parts.
    """
    tool = TOOLS.get(request.tool)
    if tool is None:
        raise CommandError(f"unknown tool {request.tool!r}; the tools are {', '.join(TOOLS)}")
    session = session_of(folder, segmenter, progress)
    prompts = prompts_of(workspace, items)
    return tool(_Input(request, folder, workspace, session, prompts, progress))


def _propose(given: _Input) -> list[RegionOffer]:
    known = masks_in_use(given.workspace, given.request.category)
    found = propose_parts(given.encoded, progress=given.progress, known=known)
    # Existing parts stay; a proposal counts where most of it is unassigned.
    taken = given.labels > BASE
    out: list[RegionOffer] = []
    for part, name in enumerate(found.names, start=BASE + 1):
        mask = found.labels == part
        if 2 * np.count_nonzero(mask & ~taken) > np.count_nonzero(mask):
            offers = given.offer(mask & ~taken, NEW_PART)
            out += [replace(o, name=name or None, known=found.known) for o in offers]
    return out


def _next_mask(given: _Input) -> MaskOffer:
    """Offer the masks from small to large, in turn from the first choice."""
    part, first = given.request.part, given.labels == given.request.part
    others = given.session.candidates(given.prompts, part)
    if hasattr(given.session, "encoding"):
        others = [*others, *_around_click(given)]
    weight = given.weight
    masks = [first]
    for mask in others:
        if mask.any() and not any(look_alike(mask, one, weight) for one in masks):
            masks.append(mask)
    order = sorted(range(len(masks)), key=lambda k: float(weight @ masks[k]))
    total, rank = len(masks), order.index(0)
    number = given.request.turn % total
    rank = (rank + number) % total
    chosen = masks[order[rank]]
    share = float(weight @ chosen) / max(float(weight.sum()), 1e-12)
    regions = []
    if number:
        regions = given.offer(first & ~chosen, part, False) + given.offer(chosen & ~first, part)
    return MaskOffer(regions, number, total, rank, share)


def _around_click(given: _Input) -> list[Bool]:
    """The smallest surface under the last click, its superpoint, and its connected shell: a knob
    or a caster that no proposal separates."""
    part = given.request.part
    clicks = [c for c in given.prompts.clicks if c.part == part and c.positive]
    if not clicks:
        return []
    session, (click, taken) = given.encoded, (clicks[-1], (given.labels > BASE))
    taken &= given.labels != part
    node = locate(session.asset, session.encoding.nodes, click.position, click.element)[1]
    of_node = session.encoding.superpoints.of_node
    smallest = to_elements(session, of_node == of_node[node]) & ~taken
    shell = connected(session, click.position, click.element, taken)
    return [smallest] if shell.nearly_all else [smallest, shell.mask]


def _connected(given: _Input) -> list[RegionOffer]:
    part = given.request.part
    clicks = [c for c in given.prompts.clicks if c.part == part and c.positive]
    if not clicks:
        raise CommandError("click on the part first; connected elements are added to it")
    others = (given.labels > BASE) & (given.labels != part)
    found = connected(given.encoded, clicks[-1].position, clicks[-1].element, others)
    more = found.mask & (given.labels != part)
    if found.nearly_all and more.any():
        scope = "that no other part has " if others.any() else ""
        raise CommandError(
            f"nearly everything {scope}is connected here, so nothing was added: use clicks, a "
            "lasso (L) or a cut (K)"
        )
    return given.offer(more, part)


def _beside_parts(given: _Input, masks: list[Bool]) -> list[RegionOffer]:
    """Offer new parts of masks that are similar to the selected one."""
    out: list[RegionOffer] = []
    labels, part = given.labels, given.request.part
    ids = labels - labels.min()
    sizes = np.bincount(ids)
    for mask in masks:
        # Existing parts keep their elements, so that a second run finds nothing twice; but a small
        # piece of a large part, like a knob that a panel includes, is found.
        swallowed = np.bincount(ids[mask], minlength=len(sizes)) < _SWALLOWED * sizes
        free = mask & ((labels == BASE) | (swallowed[ids] & (labels != part)))
        if free.sum() > 0.5 * mask.sum():
            points = _sample_of(given.folder).shown(free)
            out += [replace(o, points=points) for o in given.offer(free, NEW_PART)]
    return out


def _grow(given: _Input) -> list[RegionOffer]:
    return given.offer(grow(given.encoded, given.mask, 1) & ~given.mask, given.request.part)


def _shrink(given: _Input) -> list[RegionOffer]:
    kept = grow(given.encoded, given.mask, -1)
    return given.offer(given.mask & ~kept, given.request.part, False) if kept.any() else []


def _split(given: _Input) -> list[RegionOffer]:
    least = _MIN_PIECE * given.mask.sum()
    out: list[RegionOffer] = []
    for piece in connected_components(given.encoded, given.mask)[1:]:
        if piece.sum() >= least:
            out += given.offer(piece, NEW_PART)
    return out


def _cut(given: _Input) -> list[RegionOffer] | FaceCutOffer:
    request, labels = given.request, given.labels
    if request.element is None:
        raise CommandError("a cut needs clicked places")
    # The clicked part is cut; the piece goes to the selected part while that is empty, else to a
    # new one.
    part = int(labels[request.element])
    mask = labels == part
    if request.tool == "rectangle":
        cut = rectangle_cut(
            given.encoded, mask, request.places, request.view, snap=not request.exact
        )
    else:
        cut = line_cut(given.encoded, mask, request.places, request.view)
    empty = request.part not in (part, BASE) and not (labels == request.part).any()
    target = request.part if empty else request.free_part
    asset = asset_of(given.folder)
    if cut.splits_faces(asset):
        return _face_cut(given, asset, cut, target)
    off = cut.inside(asset)
    rest = mask & ~off
    if request.tool == "cut" and off.sum() > rest.sum():
        off = rest
    if not off.any():
        raise CommandError("nothing of the part lies there: click on the part to cut")
    return given.offer(off, target)


def frame_at(folder: Path, place: Point, view: Point) -> tuple[Point, Point]:
    """Return the surface's normal at a place and the horizontal direction along it."""
    out, across = surface_frame(session_of(folder, DEFAULT), np.array([place]), view)
    return tuple(out.tolist()), tuple(across.tolist())


def _face_cut(given: _Input, asset: Asset, cut: Cut, target: int) -> FaceCutOffer:
    """Return the parts after a cut that splits faces, by the new face numbers."""
    assert asset.mesh is not None
    split = split_faces(asset.mesh, cut.chosen, cut.planes)
    off, labels = split.inside, given.labels[split.parent]
    if cut.whole is not None:
        off = off | cut.whole[split.parent]
    if given.request.tool == "cut":
        area = split.mesh.face_areas
        rest = cut.chosen[split.parent] & ~off
        off = off if area[off].sum() <= area[rest].sum() else rest
    labels[off] = target
    arrays = arrays_of(given.workspace)
    chosen = arrays.put(np.flatnonzero(cut.chosen).astype(np.int64))
    parts, counts = np.unique(labels, return_counts=True)
    regions: list[RegionOffer] = []
    for part in parts[parts > BASE].tolist():
        regions += given.offer(labels == part, part)
    return FaceCutOffer(
        FaceCut(chosen, cut.planes),
        tuple(regions),
        arrays.put(labels),
        dict(zip(parts.tolist(), counts.tolist(), strict=True)),
    )


def _merge(given: _Input) -> list[RegionOffer]:
    other, part = given.request.other, given.request.part
    if other is None or other == part:
        raise CommandError("select another part to merge with this one")
    return given.offer(given.labels == other, part)


def _leftovers(given: _Input) -> list[RegionOffer]:
    clean = absorb_small_components(given.encoded, given.labels)
    moved = clean != given.labels
    out: list[RegionOffer] = []
    for part in np.unique(clean[moved]):
        out += given.offer(moved & (clean == part), int(part))
    return out


TOOLS: dict[str, Callable[[_Input], Offer]] = {
    PROPOSE: _propose,
    NEXT_MASK: _next_mask,
    "connected": _connected,
    "same shape": lambda given: _beside_parts(given, same_shape(given.encoded, given.mask)),
    "mirror": lambda given: _beside_parts(given, [mirrored(given.encoded, given.mask)]),
    "grow": _grow,
    "shrink": _shrink,
    "split": _split,
    "cut": _cut,
    "rectangle": _cut,
    "merge": _merge,
    "leftovers": _leftovers,
}
"""All tools by name."""


# --- the preview under the pointer ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class HoverAnswer:
    """The change that a click would make, as points on the surface.

    Attributes:
        gained, lost: (K, 3) metres, along the outline and few within.
        count: elements that would change.
    """

    gained: npt.NDArray[np.float32]
    lost: npt.NDArray[np.float32]
    count: int


@dataclass(frozen=True, eq=False)
class _Sample:
    """Points on an asset's surface in random order, and the element of each."""

    points: npt.NDArray[np.float32]
    element: npt.NDArray[np.int64]

    @cached_property
    def _near(self) -> npt.NDArray[np.int64]:
        found = KDTree(self.points).query(self.points, 1 + _NEIGHBOURS)[1]
        return np.minimum(np.asarray(found, np.int64), len(self.points) - 1)

    def shown(self, mask: Bool) -> npt.NDArray[np.float32]:
        """Return points (K, 3) along the outline of a mask's elements, and few within."""
        inside = mask[self.element]
        edge = inside & ~inside[self._near].all(1)
        outline, fill = np.flatnonzero(edge)[:HOVER_POINTS], np.flatnonzero(inside & ~edge)
        fill = fill[: max(len(outline) // 4, LEAST_FILL)]
        return self.points[np.concatenate([outline, fill])]


@dataclass
class _Current:
    """This process's labels before the hovered click."""

    key: Any = None
    labels: npt.NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, np.int16))


_samples: LruCache[Path, _Sample] = LruCache(8)
_current = _Current()


def hover(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    click: Click,
) -> HoverAnswer:
    """Return what ``click`` would change; the segmenter's result isn't stored."""
    session = session_of(folder, segmenter)
    prompts = prompts_of(workspace, items)
    key = (folder, segmenter, prompts.key())
    if _current.key != key:
        _current.key, _current.labels = key, session.segment(prompts).labels
    after = session.segment(Prompts((*prompts.items, click))).labels
    before = _current.labels
    gained = (after == click.part) & (before != click.part)
    lost = (before == click.part) & (after != click.part)
    sample = _sample_of(folder)
    return HoverAnswer(sample.shown(gained), sample.shown(lost), int(gained.sum() + lost.sum()))


def _sample_of(folder: Path) -> _Sample:
    return _samples.get(folder, lambda: _sample(folder))


def _sample(folder: Path) -> _Sample:
    asset, rng = asset_of(folder), np.random.default_rng(0)
    if asset.mesh is not None:
        cloud, face = sample_surface(asset.mesh, SAMPLE_POINTS, rng)
        return _Sample(cloud.points.astype(np.float32), np.asarray(face, np.int64))
    assert asset.cloud is not None
    chosen = rng.permutation(len(asset.cloud))[:SAMPLE_POINTS]
    return _Sample(np.asarray(asset.cloud.points[chosen], np.float32), chosen)


@dataclass(frozen=True)
class LikeOffer:
    """Parts that accepted objects have where this one has them, too.

    Attributes:
        folder: of the accepted asset of the same shape; "" where a category is followed.
        regions: of the parts, with their names.
        category: of the accepted objects.
        known: accepted objects that it was compared with.
    """

    folder: str
    regions: tuple[RegionOffer, ...]
    category: str | None
    known: int


def find_alike(
    folder: Path,
    workspace: Path,
    assets: Sequence[Path],
    category: str | None = None,
    progress: Progress = no_progress,
) -> LikeOffer | None:
    """Return the parts of the accepted asset that fits best; where none fits well, those that *All
    parts* finds by the accepted objects of the category; None where these don't help.

    Args:
        folder: of the working copy. assets: folders of accepted assets, likeliest first.
        category: of the object, or the likeliest one.
    """
    session = session_of(folder, DEFAULT)
    if session.encoding.room is not None:
        return None
    examples = []
    for k, asset in enumerate(assets):
        progress(0.3 * k / len(assets), "Looking for an object like it")
        example = _example(asset)
        if example is not None:
            examples.append(example)
    match = best_match(examples, session.encoding.nodes.points)
    if match is not None and match.fit >= FIT:
        progress(0.4, "Looking for an object like it")
        found = carry_over(session, match)
        least = LITTLE_AGREEMENT if match.fit >= CLOSE_FIT else AGREEMENT
        if found.names and found.agreement >= least:
            return _offer(workspace, found, match.example.category, match.example.name)
    known = masks_in_use(workspace, category)
    if not telling(known):
        return None
    found = propose_parts(session, progress=progress, known=known)
    return _offer(workspace, found, category) if found.names else None


def _offer(
    workspace: Path, found: ProposedParts, category: str | None, folder: str = ""
) -> LikeOffer:
    regions = []
    for part, name in enumerate(found.names, start=BASE + 1):
        elements = np.flatnonzero(found.labels == part).astype(np.int64)
        ref = arrays_of(workspace).put(elements)
        regions.append(RegionOffer(NEW_PART, ref, len(elements), name=name or None))
    return LikeOffer(folder, tuple(regions), category, found.known)


def _example(asset: Path) -> Example | None:
    """An accepted asset to compare with; None where its folder is gone or damaged."""

    def read() -> Example | None:
        with contextlib.suppress(ArtiworldError):
            return example_of(load_object(asset), asset.name)
        return None

    with contextlib.suppress(OSError):
        return _examples.get((asset, asset.stat().st_mtime_ns), read)
    return None


def object_name(asset_folder: str) -> str:
    """The name of the object that an accepted asset's folder is named after."""
    return asset_folder.rpartition("-")[0] or asset_folder
