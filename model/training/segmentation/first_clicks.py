"""The scorer of first clicks on parts that move, as people make them.

Nobody clicks the base: what no click claims is the base. So this scorer learns from parts that
move alone, clicked where they are seen, with and without clicks on other parts, on objects with
relief within their parts, most of them met as depth cameras see them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part, SegmentedObject
from model.core.asset import Asset
from model.data.simulated.depth_camera import simulate_scan
from model.data.simulated.ornaments import ornamented
from model.data.simulated.scans import (
    FLUSH,
    SMALL_PARTED,
    SQUARE,
    Shape,
    build,
    depth_cameras,
    scan,
)
from model.evaluation.pool import in_order
from model.evaluation.segmentation.visible_clicks import (
    LEAST_PIXELS,
    Picture,
    depths,
    largest_piece,
    picture_of,
)
from model.segmentation.encode.edge_strength import shipped_edge_model
from model.segmentation.encode.encoding import Encoding, encode
from model.segmentation.propose.boxes import MOVING_FEATURE_NAMES, ObjectSolver
from model.segmentation.score.mlp import Mlp
from model.segmentation.score.scorers import MOVING_SCORERS, shipped_scorers, solver_of
from model.segmentation.score.trees import Scorer, save_scorer
from model.segmentation.solver import PartState
from model.training.segmentation.clicks import (
    Log,
    Rows,
    asked_by_size,
    chosen_overlap,
    fit_scorer,
    joined_rows,
    overlaps,
)

if TYPE_CHECKING:
    from model.training.segmentation.clouds import CloudTraining
    from model.training.segmentation.corrective_clicks import MendingTraining

Seeds = tuple[int, int, int]
"""First one, end, step."""

_COUNTS, _COUNT_CHANCE = (100_000, 60_000, 30_000), (0.6, 0.2, 0.2)
_CLOSE = 0.35
"""Of the greatest depth of what is seen of a part: where clicks land."""
_SIDES = 8
_NOISE = (0.0003, 0.001, 0.002)


@dataclass(frozen=True)
class MovingTraining:
    """What is needed to train ``first_click_moving.npz`` again.

    Attributes:
        seeds: of the objects that are clicked, as ranges.
        small_seed, flush_seed: from there on objects have small parts, and flush fronts.
        square: share of them that are furniture, appliances and the like.
        ornaments: share of them that get relief.
        camera, one_sided, mesh: shares that are met as depth cameras see them, as one-sided clouds
            and as meshes; the rest as clouds seen from all around.
        parts: asked for in each, spread over the logarithm of their sizes.
        clicks: first clicks on each.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = (
        (200_000, 201_138, 2),
        (200_001, 200_369, 2),
        (260_000, 260_071, 1),
        (280_000, 280_244, 1),
    )
    small_seed: int = 260_000
    flush_seed: int = 280_000
    square: float = 0.4
    ornaments: float = 0.6
    camera: float = 0.4
    one_sided: float = 0.15
    mesh: float = 0.25
    parts: int = 5
    clicks: int = 3
    held_out: int = 6
    networks: int = 3
    workers: int = 2


@dataclass(frozen=True, eq=False)
class SeenObject:
    """What a person has before them: an encoded object with the true part of every node.

    Attributes:
        base: the part that does not move.
    """

    encoding: Encoding
    labels: npt.NDArray[np.int16]
    base: int
    picture: Picture
    shown: npt.NDArray[np.int16]


def _base_of(shape: Shape) -> int:
    """The part that does not move; of assemblies the first."""
    if shape.object is None:
        return 0
    links = [p.link for p in shape.object.parts]
    return links.index(shape.object.tree.root)


def _pieces(shape: Shape) -> tuple[SegmentedObject, npt.NDArray[np.int16]]:
    """The parts of a shape as what a camera sees, and the number of each."""
    mesh, numbers = shape.mesh, np.unique(shape.part)
    faces = [shape.part == number for number in numbers]
    parts = tuple(
        Part(f"link_{n}", replace(mesh, faces=mesh.faces[own],
                                  face_material=mesh.face_material[own]))
        for n, own in zip(numbers.tolist(), faces, strict=True)
    )  # fmt: skip
    return SegmentedObject(shape.family, parts), numbers


def _photographed(
    shape: Shape, ahead: float, count: int, rng: np.random.Generator
) -> tuple[Asset, npt.NDArray[np.int16]]:
    """What one to five depth cameras, most of them ``ahead`` (azimuth) of a shape, see, and the
    part of each point, -1: none.
    """
    seen, numbers = _pieces(shape)
    ahead = rng.uniform(-np.pi, np.pi) if rng.random() < 0.1 else ahead
    around = ahead + rng.uniform(-0.9, 0.9, rng.integers(1, 6))
    noise = float(rng.choice(_NOISE))
    settings = replace(
        depth_cameras(shape, around, count, noise, rng),
        color_noise=float(rng.choice([3, 6, 10])),
        outliers=float(rng.choice([0, 0.0005, 0.002])),
    )
    found = simulate_scan(seen, settings, rng)
    labels = np.where((found.part < 0) | found.smeared, -1, numbers[found.part])
    return Asset(shape.family, cloud=found.cloud), labels.astype(np.int16)


def _ahead(shape: Shape, base: int) -> float:
    """Azimuth (of a camera) from which most of the moving parts is seen."""
    asset = Asset("sides", mesh=shape.mesh)
    best, most = 0.0, -1
    for azimuth in np.linspace(-np.pi, np.pi, _SIDES, endpoint=False):
        front = (np.sin(azimuth), -np.cos(azimuth), 0.0)
        part = picture_of(asset, front).of(shape.part)
        number = int(((part >= 0) & (part != base)).sum())
        if number > most:
            best, most = float(azimuth), number
    return best


def seen_object(seed: int, config: MovingTraining, rng: np.random.Generator) -> SeenObject:
    """A made object as a person has it before them."""
    families = SQUARE if rng.random() < config.square else None
    if seed >= config.small_seed:
        families = FLUSH if seed >= config.flush_seed else SMALL_PARTED
    shape = build(seed, families)
    base = _base_of(shape)
    if rng.random() < config.ornaments:
        shape = ornamented(shape, rng)
    ahead = _ahead(shape, base)
    count = int(rng.choice(_COUNTS, p=_COUNT_CHANCE))
    chance = rng.random()
    if chance < config.mesh:
        asset, labels = Asset(shape.family, mesh=shape.mesh), shape.part
    elif chance < config.mesh + config.camera:
        asset, labels = _photographed(shape, ahead, count, rng)
    else:
        aside = chance < config.mesh + config.camera + config.one_sided
        made = scan(shape, count, "one-sided" if aside else "surface",
                    float(rng.choice((0.0, *_NOISE))), seed)  # fmt: skip
        asset, labels = Asset(shape.family, cloud=made.cloud), made.labels
    azimuth = ahead + rng.uniform(-0.3, 0.3)
    picture = picture_of(asset, (np.sin(azimuth), -np.cos(azimuth), 0.0))
    encoding = encode(asset, shipped_edge_model())
    of_node = labels[encoding.nodes.elements.element_of_node]
    return SeenObject(encoding, of_node, base, picture, picture.of(labels))


@dataclass(frozen=True, eq=False)
class FirstClick:
    """A first click and what it meets.

    Attributes:
        state: other parts' clicks. blocked: (C,) superpoints of other parts.
    """

    superpoint: int
    state: PartState
    blocked: npt.NDArray[np.bool_] | None


def play(seed: int, config: MovingTraining) -> Rows:
    """First clicks on the moving parts of one object; rows of their hypotheses."""
    rng = np.random.default_rng([seed, 7])
    seen = seen_object(seed, config, rng)
    log = Log(MOVING_FEATURE_NAMES)
    # Meshes are answered without lines, but teach as well as clouds.
    solver = solver_of(seen.encoding, *shipped_scorers(), lined=True)
    if not isinstance(solver, ObjectSolver):
        return log.rows()  # taken for a room
    encoding = seen.encoding
    for part, clicks in first_clicks(seen, config, rng):
        truth = seen.labels == part
        for click in clicks:
            ranked = solver.answer(click.state, click.superpoint, True, click.blocked)
            log.add(ranked, overlaps(encoding, ranked.candidates.masks, truth), float(truth.mean()))
    return log.rows()


def first_clicks(
    seen: SeenObject, config: MovingTraining, rng: np.random.Generator
) -> Iterator[tuple[int, Iterator[FirstClick]]]:
    """Some of the moving parts that are seen, each with first clicks on it."""
    encoding, of_node = seen.encoding, seen.encoding.superpoints.of_node
    pixels = {
        part: clicks_in(seen.shown == part, config.clicks, rng)
        for part in np.unique(seen.labels[seen.labels >= 0]).tolist()
        if part != seen.base and (seen.shown == part).sum() >= LEAST_PIXELS
    }
    superpoints = {
        part: of_node[encoding.nodes.tree.query([seen.picture.position[at] for at in spots])[1]]
        for part, spots in pixels.items()
    }
    there = np.where(np.isin(seen.labels, list(superpoints)), seen.labels, np.int16(-1))
    for part in asked_by_size(rng, there, config.parts):
        others = np.array([q for q in superpoints if q != part])
        yield part, (_beside(c, others, superpoints, seen, rng) for c in superpoints[part].tolist())


def _beside(
    superpoint: int,
    others: npt.NDArray[np.int64],
    superpoints: dict[int, npt.NDArray[np.int32]],
    seen: SeenObject,
    rng: np.random.Generator,
) -> FirstClick:
    """A first click, in half of the cases after others on some other parts."""
    if not len(others) or rng.random() >= 0.5:
        return FirstClick(superpoint, PartState(), None)
    of_node = seen.encoding.superpoints.of_node
    size = np.bincount(of_node)
    chosen = rng.choice(others, int(rng.integers(1, len(others) + 1)), replace=False)
    foreign = dict.fromkeys(int(superpoints[q][0]) for q in chosen.tolist())
    negative = tuple(c for c in foreign if c != superpoint)
    taken = np.bincount(of_node, np.isin(seen.labels, chosen), len(size))
    blocked = taken > 0.5 * size
    blocked[superpoint] = False
    return FirstClick(superpoint, PartState(negative=negative, agreed=(0, len(negative))), blocked)


def clicks_in(
    region: npt.NDArray[np.bool_], number: int, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Pixels in the middle of what is seen of a part, or not far from it."""
    depth = depths(largest_piece(region)[0])
    close = np.argwhere(depth > _CLOSE * depth.max())
    picked = close[rng.integers(len(close), size=number - 1)]
    first = np.unravel_index(int(depth.argmax()), depth.shape)
    return [(int(r), int(c)) for r, c in [first, *picked]]


class Played(Protocol):
    """What came of playing with one object."""

    @property
    def share(self) -> npt.NDArray[np.floating]:
        """One number for each click or mask."""
        ...


C = TypeVar("C")
P = TypeVar("P", bound=Played)


def collected(
    play_one: Callable[[int, C], P], config: C, seeds: tuple[Seeds, ...], workers: int
) -> list[P]:
    """Rows of each object that had any; they do not depend on ``workers``."""
    numbers = [seed for one in seeds for seed in range(*one)]
    rows = in_order(partial(_played, play_one, config), numbers, workers)
    return [r for r in rows if len(r.share)]


def _played(play_one: Callable[[int, C], P], config: C, seed: int) -> P:
    return play_one(seed, config)


def fitted(
    rows: list[Rows],
    config: MovingTraining | MendingTraining | CloudTraining,
    kind: str,
    path: Path,
    fit: Callable[[Rows], Scorer],
) -> dict[str, float]:
    """Fit, measure and write a scorer of ``kind``; returns the scores of a fit without every n-th
    object.
    """
    test = joined_rows(rows[:: config.held_out])
    rest = joined_rows([r for i, r in enumerate(rows) if i % config.held_out])
    chosen, best = chosen_overlap(fit(rest), test)
    scores = {
        f"{kind}_iou": chosen,
        f"{kind}_best_possible": best,
        f"{kind}_clicks": float(sum(len(r.share) for r in rows)),
    }
    save_scorer(fit(joined_rows(rows)), path, {"training": asdict(config), "scores": scores})
    return scores


def fit_moving(rows: Rows, networks: int) -> Mlp:
    """The mean of ``networks`` networks that know what a mask shows on a front."""
    return fit_scorer(rows, networks, MOVING_FEATURE_NAMES)


def train_moving(config: MovingTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`fitted`."""
    rows = collected(play, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fitted(rows, config, "moving", folder / MOVING_SCORERS[0], fit)
