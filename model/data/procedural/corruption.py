"""Corrupt clean objects: noisy, partial, badly cut clouds with their true joints.

Each fault can be set on its own, so that its cost can be measured on its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ConfigurationError
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.procedural.grammar import ProceduralObject
from model.data.procedural.shapes import rotation
from model.data.registry import GroundTruth
from model.geometry.casting import Caster
from model.geometry.sampling import sample_surface

Array = npt.NDArray[np.float64]
LEAST = 24
"""Fewest points that a part keeps."""

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "door": ("rotation_door",),
    "lid": ("rotation_lid", "cover", "cap"),
    "knob": ("dial", "rotation_knob"),
    "button": ("push_button",),
    "lever": ("handle", "switch"),
    "drawer": ("tray",),
    "switch": ("toggle_button", "lever"),
    "screen": ("lid", "display"),
}
"""Other words that people and data sets use for a part."""


@dataclass(frozen=True)
class Corruption:
    """Faults of the input. All are off by default; lengths are shares of the diagonal.

    Attributes:
        points: sampled a part.
        noise: standard deviation of the points' places, up to 0.05.
        outliers: share of the points that are thrown anywhere into the box.
        one_sided: keep what one camera before the object sees.
        split: chance a part that a piece of it is cut off, fixed to the rest (over-segmentation).
        merge: chance that a part that carries nothing is merged into its parent.
        bleed: points nearer than this to another part may get its label.
        turn: any yaw; tilt: radians (standard deviation) off the vertical.
        shuffle: random order and numbers of the parts.
        rename: chance a part that another word is used for it.
    """

    points: int = 1024
    noise: float = 0.0
    outliers: float = 0.0
    one_sided: bool = False
    split: float = 0.0
    merge: float = 0.0
    bleed: float = 0.0
    turn: bool = False
    tilt: float = 0.0
    shuffle: bool = True
    rename: float = 0.0

    def __post_init__(self) -> None:
        for name in ("outliers", "split", "merge", "rename"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigurationError(f"{name} is a share of 0..1, got {getattr(self, name)}")
        if self.noise < 0 or self.bleed < 0 or self.points < LEAST:
            raise ConfigurationError(
                f"noise and bleed must not be negative and points be {LEAST} or more, "
                f"got {self.noise}, {self.bleed}, {self.points}"
            )


MIXED = Corruption(
    noise=0.02,
    outliers=0.01,
    one_sided=True,
    split=0.2,
    merge=0.1,
    bleed=0.01,
    turn=True,
    tilt=0.03,
    rename=0.2,
)
"""A bit of everything: use with :func:`sometimes` in training."""


FAULTS: Mapping[str, Corruption] = {
    "clouds": Corruption(),
    "noise": Corruption(noise=0.01),
    "heavy-noise": Corruption(noise=0.05),
    "outliers": Corruption(outliers=0.02),
    "one-sided": Corruption(one_sided=True),
    "split": Corruption(split=0.5),
    "merge": Corruption(merge=0.3),
    "bleed": Corruption(bleed=0.02),
    "turned": Corruption(turn=True, tilt=0.05),
    "mixed": MIXED,
}
"""One fault each, to measure its cost; ``clouds`` has none but that meshes become points."""


def sometimes(worst: Corruption, rng: np.random.Generator) -> Corruption:
    """A draw between clean and ``worst``: each fault is off half of the time."""

    def share(value: float) -> float:
        return value * float(rng.random()) if rng.random() < 0.5 else 0.0

    return replace(
        worst,
        noise=share(worst.noise),
        outliers=share(worst.outliers),
        split=share(worst.split),
        merge=share(worst.merge),
        bleed=share(worst.bleed),
        tilt=share(worst.tilt),
        rename=share(worst.rename),
        one_sided=worst.one_sided and bool(rng.random() < 0.35),
        turn=worst.turn and bool(rng.random() < 0.7),
    )


def corrupted(
    made: ProceduralObject, settings: Corruption, rng: np.random.Generator, *, name: str = ""
) -> GroundTruth:
    """Cut an object into clouds as ``settings`` say, with the tree that is true for those parts.

    Fragments of a split part are joined to it by a fixed joint; merged parts lose their joint, and
    a part that can't be seen at all is left out where nothing hangs on it.
    """
    obj = made.object
    if settings.turn or settings.tilt:
        obj = obj.moved(_turn(settings, rng))
    points, colors, part, piece = _sampled(made, obj, settings, rng)
    tree = obj.tree
    names = {p.link: p.name for p in obj.parts}
    links = [p.link for p in obj.parts]
    part, tree = _merged(part, links, tree, settings.merge, rng)
    part, tree = _split_parts(part, piece, points, links, names, tree, settings.split, rng)
    if settings.one_sided:
        seen = _seen(obj, points, rng)
        part, tree = _dropped(part, seen, links, tree)
        kept = (seen | _needed(part, seen, len(links), rng)) & (part >= 0)
        points, colors, part = points[kept], colors[kept], part[kept]
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    if settings.bleed:
        part = _bled(points, part, settings.bleed * diagonal, rng)
    points = points + rng.standard_normal(points.shape) * settings.noise * diagonal
    away = rng.random(len(points)) < settings.outliers
    low, high = points.min(0), points.max(0)
    points[away] = rng.uniform(low, high, (int(away.sum()), 3))
    out = _assembled(obj, points, colors, part, links, names, tree, settings, rng)
    return GroundTruth(name or obj.name, out)


def _turn(settings: Corruption, rng: np.random.Generator) -> Array:
    out = np.eye(4)
    yaw = rng.uniform(-np.pi, np.pi) if settings.turn else 0.0
    out[:3, :3] = rotation((0, 0, 1), yaw)
    if settings.tilt:
        heading = rng.uniform(-np.pi, np.pi)
        axis = (np.cos(heading), np.sin(heading), 0.0)
        out[:3, :3] = rotation(axis, rng.normal(0, settings.tilt)) @ out[:3, :3]
    return out


def _sampled(
    made: ProceduralObject, obj: ArticulatedObject, settings: Corruption, rng: np.random.Generator
) -> tuple[Array, npt.NDArray[np.uint8], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Points, colours, part and piece (unique over all parts) of samples on every part."""
    count = settings.points * (3 if settings.one_sided else 1)
    points, colors, part, piece, used = [], [], [], [], 0
    for number, p in enumerate(obj.parts):
        assert p.mesh is not None
        cloud, face = sample_surface(p.mesh, count, rng)
        points.append(cloud.points.astype(np.float64))
        gray = np.full((len(cloud), 3), 180, np.uint8)
        colors.append(gray if cloud.colors is None else cloud.colors)
        part.append(np.full(len(cloud), number))
        own = made.pieces[p.link]
        piece.append(own[face].astype(np.int64) + used)
        used += int(own.max()) + 1
    return (
        np.concatenate(points),
        np.concatenate(colors),
        np.concatenate(part),
        np.concatenate(piece),
    )


def _without(tree: KinematicTree, link: str) -> KinematicTree:
    """Remove a leaf from the tree, and helpers without children afterwards."""
    parent = tree.joint_of[link].parent
    links = tuple(x for x in tree.links if x != link)
    out = KinematicTree(links, tuple(j for j in tree.joints if j.child != link))
    if not parent.startswith("link_") and not out.children(parent) and parent != out.root:
        return _without(out, parent)
    return out


def _bearer(tree: KinematicTree, link: str) -> str | None:
    """The nearest ancestor with geometry."""
    while link in tree.joint_of:
        link = tree.joint_of[link].parent
        if link.startswith("link_"):
            return link
    return None


def _merged(
    part: npt.NDArray[np.int64],
    links: list[str],
    tree: KinematicTree,
    chance: float,
    rng: np.random.Generator,
) -> tuple[npt.NDArray[np.int64], KinematicTree]:
    part = part.copy()
    for number, link in enumerate(links):
        if link not in tree.joint_of or tree.children(link) or rng.random() >= chance:
            continue
        bearer = _bearer(tree, link)
        # One moving part always remains.
        if bearer is None or sum(x.startswith("link_") for x in tree.links) <= 2:
            continue
        part[part == number] = links.index(bearer)
        tree = _without(tree, link)
    return part, tree


def _split_parts(
    part: npt.NDArray[np.int64],
    piece: npt.NDArray[np.int64],
    points: Array,
    links: list[str],
    names: dict[str, str | None],
    tree: KinematicTree,
    chance: float,
    rng: np.random.Generator,
) -> tuple[npt.NDArray[np.int64], KinematicTree]:
    """Cut off some solids of a part, or all beyond a plane; appends to ``links`` and ``names``."""
    part = part.copy()
    for number in range(len(links)):
        rows = np.flatnonzero(part == number)
        if len(rows) < 4 * LEAST or rng.random() >= chance:
            continue
        solids = np.unique(piece[rows])
        if len(solids) > 1 and rng.random() < 0.6:
            chosen = rng.choice(
                solids, rng.integers(1, max(2, len(solids) // 2 + 1)), replace=False
            )
            cut = np.isin(piece[rows], chosen)
        else:
            normal = rng.standard_normal(3)
            along = points[rows] @ normal
            cut = along > np.quantile(along, rng.uniform(0.4, 0.8))
        if min(cut.sum(), (~cut).sum()) < LEAST:
            continue
        link = f"link_{len(links)}"
        part[rows[cut]] = len(links)
        owner = links[number]
        links.append(link)
        names[link] = names[owner]
        fixed = Joint(f"fixed_{link}", "fixed", owner, link)
        tree = KinematicTree((*tree.links, link), (*tree.joints, fixed))
    return part, tree


def _seen(obj: ArticulatedObject, points: Array, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Which points a camera somewhere before the object, or round its corner, sees."""
    low, high = obj.bounds
    diagonal = float(np.linalg.norm(high - low))
    yaw, pitch = rng.uniform(-np.pi, np.pi), rng.uniform(0.15, 0.9)
    away = np.array([np.sin(yaw) * np.cos(pitch), -np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    eye = (low + high) / 2 + 2.0 * diagonal * away
    way = eye - points
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return ~Caster.of(obj).occluded(points + 1e-3 * diagonal * way, way)


def _dropped(
    part: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_], links: list[str], tree: KinematicTree
) -> tuple[npt.NDArray[np.int64], KinematicTree]:
    """Drop hidden parts without children; their points get -1."""
    part = part.copy()
    for number in range(len(links) - 1, -1, -1):
        link = links[number]
        here = part == number
        few = here.any() and int((here & seen).sum()) < LEAST
        parts_left = sum(x.startswith("link_") for x in tree.links)
        if few and link in tree.joint_of and not tree.children(link) and parts_left > 2:
            part[here] = -1
            tree = _without(tree, link)
    return part, tree


def _needed(
    part: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_], count: int, rng: np.random.Generator
) -> npt.NDArray[np.bool_]:
    """A few hidden points of parts with children that would vanish otherwise."""
    out = np.zeros(len(part), bool)
    for number in range(count):
        rows = np.flatnonzero(part == number)
        if len(rows) and seen[rows].sum() < LEAST:
            out[rng.choice(rows, min(LEAST, len(rows)), replace=False)] = True
    return out


def _bled(
    points: Array, part: npt.NDArray[np.int64], reach: float, rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Half of the points near another part take its label."""
    from scipy.spatial import KDTree

    distance, near = KDTree(points).query(points, k=8, distance_upper_bound=reach)
    found = np.where(np.isfinite(distance), near, 0)
    other = np.isfinite(distance) & (part[found] != part[:, None])
    column = other.argmax(axis=1)
    taken = other.any(axis=1) & (rng.random(len(points)) < 0.5)
    out = part.copy()
    out[taken] = part[found[np.flatnonzero(taken), column[taken]]]
    # No part may lose its last points.
    for number in np.unique(part):
        if (out == number).sum() < LEAST:
            out[part == number] = number
    return out


def _assembled(
    obj: ArticulatedObject,
    points: Array,
    colors: npt.NDArray[np.uint8],
    part: npt.NDArray[np.int64],
    links: list[str],
    names: Mapping[str, str | None],
    tree: KinematicTree,
    settings: Corruption,
    rng: np.random.Generator,
) -> ArticulatedObject:
    present = [n for n in range(len(links)) if links[n] in tree.links]
    order = list(rng.permutation(present)) if settings.shuffle else present
    renamed = {links[n]: f"link_{i}" for i, n in enumerate(order)}
    parts = []
    for n in order:
        rows = np.flatnonzero(part == n)
        if len(rows) > settings.points:
            rows = rng.choice(rows, settings.points, replace=False)
        cloud = PointCloud(points[rows].astype(np.float32), None, colors[rows])
        name = _word(names[links[n]], settings, rng)
        parts.append(Part(renamed[links[n]], cloud=cloud, name=name))
    return ArticulatedObject(obj.name, tuple(parts), tree.renamed(renamed), obj.category)


def _word(name: str | None, settings: Corruption, rng: np.random.Generator) -> str | None:
    if name is not None and name in SYNONYMS and rng.random() < settings.rename:
        return str(rng.choice(SYNONYMS[name]))
    return name
