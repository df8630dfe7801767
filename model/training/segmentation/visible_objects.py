"""Train the scorers of clicks on moving parts, by the visible-click protocol.

People don't click the base: what no click claims belongs to it. So the scorer of first clicks
learns only from moving parts, clicked where they are visible, with and without clicks on other
parts, on objects with ornaments, many of them scanned by simulated depth cameras.

For corrective clicks a simulated person clicks a part where it is visible, then the middle of the
largest visible error, and so on. Mostly the best mask is followed, sometimes another one, so that
errors occur as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from model.core.articulated_object import Part, SegmentedObject
from model.core.asset import Asset
from model.data.simulated.depth_camera import simulate_scan
from model.data.simulated.scans import (
    FLUSH,
    SMALL_PARTED,
    SQUARE,
    Shape,
    build,
    depth_cameras,
    ornamented,
    scan,
)
from model.evaluation.segmentation_clicks import (
    LEAST_PIXELS,
    Picture,
    depths,
    largest_component,
    picture_of,
)
from model.segmentation.arrays import Bool, Int16, Int32, Int64
from model.segmentation.encoding import Encoding, encode
from model.segmentation.graph import shipped_edge_model
from model.segmentation.models import Mlp
from model.segmentation.object_features import MOVING_FEATURE_NAMES
from model.segmentation.proposals import PartState
from model.segmentation.scores import MOVING_SCORERS, shipped_moving_scorers, shipped_scorers
from model.segmentation.solver import PartSolver, solver_of
from model.training.segmentation.rows import (
    Log,
    Rows,
    Seeds,
    asked_by_size,
    collected,
    fit_and_save,
    fit_scorer,
)

_COUNT_CHANCE = (0.6, 0.2, 0.2)
"""Probability of each number of points of a cloud."""
_NEAR_MIDDLE = 0.35
"""Share of the greatest depth of a visible part above which clicks land."""
_SIDES = 8
_NOISE = (0.0003, 0.001, 0.002)
"""Noise of points, in diagonals."""


@dataclass(frozen=True)
class MovingPartTraining:
    """Settings that trained ``first_click_moving.npz``.

    Attributes:
        seeds: of the objects that are clicked, as ranges.
        small_seed, flush_seed: from there on objects have small parts, and flush fronts.
        square: share of them that are furniture, appliances and the like.
        ornaments: share of them that get ornaments.
        camera, one_sided, mesh: shares that are clouds of depth cameras, one-sided clouds and
            meshes; the rest are clouds seen from all around.
        points: numbers of points of clouds, the likeliest first.
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
    points: tuple[int, int, int] = (100_000, 60_000, 30_000)
    parts: int = 5
    clicks: int = 3
    held_out: int = 6
    networks: int = 3
    workers: int = 2


@dataclass(frozen=True, eq=False)
class VisibleObject:
    """An encoded object with the true part of every node, and a picture of it.

    Attributes:
        labels: (N,) the true part of each node, -1 for none.
        base: the part that does not move.
        shown: (rows, columns) the true part in each pixel of the picture.
    """

    encoding: Encoding
    labels: Int16
    base: int
    picture: Picture
    shown: Int16


def _base_of(shape: Shape) -> int:
    """The part that does not move; of assemblies the first."""
    if shape.object is None:
        return 0
    links = [p.link for p in shape.object.parts]
    return links.index(shape.object.tree.root)


def _segmented(shape: Shape) -> tuple[SegmentedObject, Int16]:
    """The parts of a shape for a simulated camera, and the number of each."""
    mesh, numbers = shape.mesh, np.unique(shape.part)
    faces = [shape.part == number for number in numbers]
    parts = tuple(
        Part(
            f"link_{n}", replace(mesh, faces=mesh.faces[own], face_material=mesh.face_material[own])
        )
        for n, own in zip(numbers.tolist(), faces, strict=True)
    )
    return SegmentedObject(shape.family, parts), numbers


def _photographed(
    shape: Shape, ahead: float, count: int, rng: np.random.Generator
) -> tuple[Asset, Int16]:
    """The cloud of one to five depth cameras, most of them near the azimuth ``ahead``, and the part
    of each point, -1 for none.
    """
    parts, numbers = _segmented(shape)
    ahead = rng.uniform(-np.pi, np.pi) if rng.random() < 0.1 else ahead
    around = ahead + rng.uniform(-0.9, 0.9, rng.integers(1, 6))
    noise = float(rng.choice(_NOISE))
    settings = replace(
        depth_cameras(shape, around, count, noise, rng),
        color_noise=float(rng.choice([3, 6, 10])),
        outliers=float(rng.choice([0, 0.0005, 0.002])),
    )
    found = simulate_scan(parts, settings, rng)
    labels = np.where((found.part < 0) | found.smeared, -1, numbers[found.part])
    return Asset(shape.family, cloud=found.cloud), labels.astype(np.int16)


def _facing(azimuth: float) -> tuple[float, float, float]:
    """Direction of an object that a camera at an azimuth sees from the front."""
    return (np.sin(azimuth), -np.cos(azimuth), 0.0)


def _ahead(shape: Shape, base: int) -> float:
    """Azimuth from which a camera sees most of the moving parts."""
    asset = Asset("sides", mesh=shape.mesh)
    best, most = 0.0, -1
    for azimuth in np.linspace(-np.pi, np.pi, _SIDES, endpoint=False):
        part = picture_of(asset, _facing(azimuth)).of(shape.part)
        number = int(((part >= 0) & (part != base)).sum())
        if number > most:
            best, most = float(azimuth), number
    return best


def visible_object(
    seed: int, config: MovingPartTraining, rng: np.random.Generator
) -> VisibleObject:
    """A procedural object with a picture from about its front."""
    families = SQUARE if rng.random() < config.square else None
    if seed >= config.small_seed:
        families = FLUSH if seed >= config.flush_seed else SMALL_PARTED
    shape = build(seed, families)
    base = _base_of(shape)
    if rng.random() < config.ornaments:
        shape = ornamented(shape, rng)
    ahead = _ahead(shape, base)
    count = int(rng.choice(config.points, p=_COUNT_CHANCE))
    chance = rng.random()
    if chance < config.mesh:
        asset, labels = Asset(shape.family, mesh=shape.mesh), shape.part
    elif chance < config.mesh + config.camera:
        asset, labels = _photographed(shape, ahead, count, rng)
    else:
        aside = chance < config.mesh + config.camera + config.one_sided
        made = scan(
            shape,
            count,
            "one-sided" if aside else "surface",
            float(rng.choice((0.0, *_NOISE))),
            seed,
        )
        asset, labels = Asset(shape.family, cloud=made.cloud), made.labels
    picture = picture_of(asset, _facing(ahead + rng.uniform(-0.3, 0.3)))
    encoding = encode(asset, shipped_edge_model())
    of_node = labels[encoding.nodes.elements.element_of_node]
    return VisibleObject(encoding, of_node, base, picture, picture.of(labels))


@dataclass(frozen=True, eq=False)
class FirstClick:
    """A first click on a part.

    Attributes:
        state: other parts' clicks. blocked: (C,) superpoints of other parts.
    """

    superpoint: int
    state: PartState
    blocked: Bool | None


def first_clicks(
    visible: VisibleObject, config: MovingPartTraining, rng: np.random.Generator
) -> Iterator[tuple[int, Iterator[FirstClick]]]:
    """Some of the visible moving parts, each with first clicks on it."""
    encoding, of_node = visible.encoding, visible.encoding.superpoints.of_node
    pixels = {
        part: clicks_in(visible.shown == part, config.clicks, rng)
        for part in np.unique(visible.labels[visible.labels >= 0]).tolist()
        if part != visible.base and (visible.shown == part).sum() >= LEAST_PIXELS
    }
    clicked = {
        part: of_node[encoding.nodes.tree.query([visible.picture.position[at] for at in spots])[1]]
        for part, spots in pixels.items()
    }
    there = np.where(np.isin(visible.labels, list(clicked)), visible.labels, np.int16(-1))
    for part in asked_by_size(rng, there, config.parts):
        others = np.array([q for q in clicked if q != part])
        yield part, (_beside(c, others, clicked, visible, rng) for c in clicked[part].tolist())


def _beside(
    superpoint: int,
    others: Int64,
    clicked: dict[int, Int32],
    visible: VisibleObject,
    rng: np.random.Generator,
) -> FirstClick:
    """A first click, in half of the cases after clicks on some other parts."""
    if not len(others) or rng.random() >= 0.5:
        return FirstClick(superpoint, PartState(), None)
    of_node = visible.encoding.superpoints.of_node
    size = np.bincount(of_node)
    chosen = rng.choice(others, int(rng.integers(1, len(others) + 1)), replace=False)
    foreign = dict.fromkeys(int(clicked[q][0]) for q in chosen.tolist())
    negative = tuple(c for c in foreign if c != superpoint)
    taken = np.bincount(of_node, np.isin(visible.labels, chosen), len(size))
    blocked = taken > 0.5 * size
    blocked[superpoint] = False
    state = PartState(negative=negative, confirmed=(0, len(negative)))
    return FirstClick(superpoint, state, blocked)


def clicks_in(region: Bool, number: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Pixels in the middle of a visible part, or not far from it."""
    depth = depths(largest_component(region)[0])
    close = np.argwhere(depth > _NEAR_MIDDLE * depth.max())
    picked = close[rng.integers(len(close), size=number - 1)]
    first = np.unravel_index(int(depth.argmax()), depth.shape)
    return [(int(r), int(c)) for r, c in [first, *picked]]


def play(seed: int, config: MovingPartTraining) -> Rows:
    """First clicks on the moving parts of one object; rows of their proposals."""
    rng = np.random.default_rng([seed, 7])
    visible = visible_object(seed, config, rng)
    log = Log(MOVING_FEATURE_NAMES)
    # The app lays out no fronts on meshes, but they teach as well as clouds.
    solver = solver_of(visible.encoding, *shipped_scorers(), with_fronts=True)
    if visible.encoding.room is not None:
        return log.rows()  # taken for a room
    for part, clicks in first_clicks(visible, config, rng):
        for click in clicks:
            found = solver.answer(click.state, click.superpoint, True, click.blocked)
            log.add(found, visible.encoding, visible.labels == part)
    return log.rows()


def fit_moving(rows: Rows, networks: int) -> Mlp:
    """The mean of ``networks`` networks on the features of moving parts."""
    return fit_scorer(rows, networks, MOVING_FEATURE_NAMES)


def train_moving(config: MovingPartTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.fit_and_save`."""
    rows = collected(play, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fit_and_save(rows, config, "moving", folder / MOVING_SCORERS[0], fit)


_OFF_MIDDLE = 0.4
"""Share of corrective clicks that are not in the very middle of the error."""


def _clouds() -> MovingPartTraining:
    return MovingPartTraining(camera=0.5, one_sided=0.25, mesh=0.0, clicks=2)


@dataclass(frozen=True)
class CorrectiveClickTraining:
    """Settings that trained ``later_click_moving.npz``.

    Attributes:
        seeds: of the objects that are clicked, as ranges.
        objects: how they are made and scanned; ``clicks`` sessions for each part.
        later: most clicks after the first one in each session.
        explore: probability of going on from a mask that is not the best one.
        held_out: every n-th object measures in a fit of its own.
        networks: that are fitted and averaged.
        workers: processes.
    """

    seeds: tuple[Seeds, ...] = ((201_200, 201_480, 1), (260_100, 260_140, 1), (280_300, 280_360, 1))
    objects: MovingPartTraining = field(default_factory=_clouds)
    later: int = 4
    explore: float = 0.2
    held_out: int = 6
    networks: int = 3
    workers: int = 2


def play_sessions(seed: int, config: CorrectiveClickTraining) -> Rows:
    """Sessions on the moving parts of one object; rows of the later clicks' proposals."""
    rng = np.random.default_rng([seed, 11])
    visible = visible_object(seed, config.objects, rng)
    encoding, log = visible.encoding, Log(MOVING_FEATURE_NAMES)
    scorers = shipped_scorers("mesh" if encoding.nodes.of_mesh else "cloud")
    solver = solver_of(encoding, *scorers, shipped_moving_scorers())
    if encoding.room is None:  # not taken for a room
        for part, clicks in first_clicks(visible, config.objects, rng):
            for click in clicks:
                _session(solver, visible, part, click, config, rng, log)
    return log.rows()


def _session(
    solver: PartSolver,
    visible: VisibleObject,
    part: int,
    click: FirstClick,
    config: CorrectiveClickTraining,
    rng: np.random.Generator,
    log: Log,
) -> None:
    encoding, truth = visible.encoding, visible.labels == part
    of_node = encoding.superpoints.of_node
    node = encoding.nodes.elements.node_of_element[visible.picture.element]
    there, wanted = visible.shown >= 0, visible.shown == part
    state, superpoint, positive = click.state, click.superpoint, True
    found = solver.answer(state, superpoint, True, click.blocked)
    for _ in range(config.later):
        mask = found.best
        if rng.random() < config.explore:
            near = np.argsort(-found.scores)[: 1 + len(found.scores) // 3]
            mask = found.proposals.masks[int(rng.choice(near))]
        state = solver.moved(state, superpoint, positive, mask)
        given = mask[of_node][node]
        errors = (wanted & ~given, there & given & ~wanted)
        missing, extra = (largest_component(error) for error in errors)
        error, size = max(missing, extra, key=lambda component: component[1])
        if size < LEAST_PIXELS:
            return
        at = clicks_in(error, 2, rng)[int(rng.random() < _OFF_MIDDLE)]
        superpoint, positive = int(of_node[node[at]]), missing[1] >= extra[1]
        if mask[superpoint] == positive:
            return  # the error is smaller than a superpoint
        blocked = click.blocked
        if blocked is not None and positive:
            blocked = blocked.copy()
            blocked[superpoint] = False
        found = solver.answer(state, superpoint, positive, blocked)
        log.add(found, encoding, truth)


def train_corrective(config: CorrectiveClickTraining, folder: Path) -> dict[str, float]:
    """Play, fit, measure and write the scorer into ``folder``; see :func:`.fit_and_save`."""
    rows = collected(play_sessions, config, config.seeds, config.workers)
    fit = partial(fit_moving, networks=config.networks)
    return fit_and_save(rows, config, "mending", folder / MOVING_SCORERS[1], fit)
