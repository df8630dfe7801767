"""One part within its object: cues for its joint, scored proposals, evidence for the confidence.

Joints of a proposal are in the object's frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.files import read_json, static_assets
from model.core.joint import JOINT_KINDS, Joint, JointType, canonical_axis_sign
from model.core.motion_lexicon import MECHANISM_TABLE, Mechanism
from model.core.names import category_key, known_word, mechanism_of, words
from model.core.progress import attempt
from model.prediction.builder import left_out
from model.prediction.geometric.sampled_object import CONTACT_GAP, SampledObject
from model.prediction.geometric.shape import NOTHING, TINY, PartShape, Protrusion

Array = npt.NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class JointProposal:
    """One possible joint of a part, in the working frame.

    Attributes:
        type: joint type.
        axis: (3,) unit; positive q opens. origin: (3,) on the axis.
        lower, upper: rad or diagonals; meaningless for continuous joints.
        score: sum of the cues; only differences between proposals for one part have a meaning.
        mechanism: that proposes it; None for a joint without one. reasons: the decisive cues.
        travel: range (diagonals) of a preceding prismatic joint along the same axis, on a helper
            link; for screw caps and seats that rise.
    """

    type: JointType
    axis: Array
    origin: Array
    lower: float = 0.0
    upper: float = 0.0
    score: float = 0.0
    mechanism: Mechanism | None = None
    reasons: tuple[str, ...] = ()
    travel: tuple[float, float] | None = None


def unit(v: Array) -> Array:
    """``v`` at length 1; +z if it has none."""
    length = float(np.linalg.norm(v))
    return v / length if length > 1e-12 else UP.copy()


def snapped(axis: Array, candidates: Array, tolerance: float = 0.05) -> Array:
    """The nearest of some unit axes (rows) within ``tolerance`` (rad), sign kept; else ``axis``."""
    dots = candidates @ axis
    k = int(np.argmax(np.abs(dots)))
    if abs(dots[k]) >= np.cos(tolerance):
        return candidates[k] * np.sign(dots[k])
    return axis


def best_share(proposals: list[JointProposal]) -> float:
    """Share of the best proposal in a softmax over the scores, 0..1."""
    if not proposals:
        return 0.0
    return float(softmax(2.0 * np.array([p.score for p in proposals])).max())


def distinct_motions(
    proposals: list[JointProposal], *, signed: bool = False
) -> list[JointProposal]:
    """Proposals, best first, without those that repeat the motion of a better one.

    Args:
        signed: the opposite direction is another motion.
    """
    kept: list[JointProposal] = []
    for p in proposals:
        if not any(
            k.type == p.type
            and (float(k.axis @ p.axis) if signed else abs(float(k.axis @ p.axis))) > 0.99
            and (
                JOINT_KINDS[p.type].slides
                or np.linalg.norm(np.cross(k.axis, p.origin - k.origin)) < 0.02
            )
            for k in kept
        ):
            kept.append(p)
    return kept


@lru_cache(maxsize=1024)
def usual_stop(name: str | None) -> float:
    """Metres after which a part of this name usually stops, infinite where none is known."""
    stops = read_json(static_assets() / "physics" / "stops.json")["stops"]
    known = (known_word(w, tuple(stops)) for w in words(name))
    return min((float(stops[w]["metres"]) for w in known if w is not None), default=math.inf)


def joints_of(
    sampled: SampledObject, part: int, parent: int, proposal: JointProposal
) -> list[Joint]:
    """A proposal's joints, object frame: that of the part, after a helper's if it has travel."""
    frame = sampled.frame
    link, above = sampled.shapes[part].link, sampled.shapes[parent].link
    axis = three(frame.direction_in_object(proposal.axis))
    origin = three(frame.point_in_object(proposal.origin))
    scale = 1.0 if JOINT_KINDS[proposal.type].rotates else frame.diagonal
    lower, upper = proposal.lower * scale, proposal.upper * scale
    if JOINT_KINDS[proposal.type].slides and not left_out("usual stops"):
        stop = usual_stop(sampled.shapes[part].name)
        lower, upper = max(lower, -stop), min(upper, stop)
    joint = Joint(f"joint_{link}", proposal.type, above, link, axis, origin, lower, upper)
    if proposal.travel is None:
        return [canonical_axis_sign(joint)]
    helper = f"helper_{link.removeprefix('link_')}"
    low, high = (end * frame.diagonal for end in proposal.travel)
    slide = Joint(f"joint_{helper}", "prismatic", above, helper, axis, origin, low, high)
    return [canonical_axis_sign(slide), canonical_axis_sign(replace(joint, parent=helper))]


def three(v: Array) -> tuple[float, float, float]:
    """A vector (3,) as plain numbers."""
    return float(v[0]), float(v[1]), float(v[2])


T = TypeVar("T")

SQUARE = np.deg2rad(8)
"""Largest angle (rad) between a shut panel and the object's directions."""
IN_FRONT = 0.1
"""Largest gap (diagonals) between a shut panel and its parent."""
HAND, SLENDER_HAND = 0.1, 0.35
"""Least size (diagonals) and largest middle over long extent of a clock hand."""
ACROSS, UPWARD, PARALLEL = 0.5, 0.9, 0.95
"""Cosines: below the first an axis is across another, above the last it is the same direction."""
KNOB, WHEELS = 0.2, {"wheel", "roller", "tire", "caster"}
"""Largest size (diagonals) of a knob; names of parts that turn about an axis of their own."""
OF_PANEL, EVEN = 0.94, 0.5
"""Cosine between normals of one panel, and their least share of those beside a knob; choices."""
LIKE, EQUALS, BESIDE = 0.75, 8, 32
"""Least ratio of the sizes of equal knobs; how many of them, and how many points beside each, tell
their panel's normal. The last was chosen among 12, 24 and 32 on Infinigen's choosing half."""
FLAT = 0.35
"""Largest thickness of a front, without its handle, over its shorter side; a choice."""
BAR = 0.2
"""Least size of a push bar over that of its door; buttons are smaller."""


@dataclass(eq=False)
class Assembly:
    """The sampled parts with their tree.

    Attributes:
        sampled: the parts. root: index of the base.
        parent: index of each part's parent, -1 for the root.
        front: (3,) horizontal unit vector in which the object faces. front_certainty: 0..1.
    """

    sampled: SampledObject
    root: int
    parent: list[int]
    front: Array = field(default_factory=lambda: np.array([-1.0, 0.0, 0.0]))
    front_certainty: float = 0.0
    faults: list[str] = field(default_factory=list)
    """Rules that failed and were left out, for people."""

    @cached_property
    def category(self) -> str:
        """Key of the category, "" if unknown."""
        return category_key(self.sampled.category)


@dataclass(eq=False)
class PartContext:
    """One part within its assembly."""

    assembly: Assembly
    part: int
    barrels: dict[bytes, tuple[Array, int] | None] = field(default_factory=dict)
    """Hinge barrels by axis and origin of an edge, cached for all mechanisms."""

    def attempt(self, name: str, rule: Callable[[], T], default: T) -> T:
        """:func:`attempt` a rule on this part."""
        return attempt(self.assembly.faults, f"{self.shape.link}: {name}", rule, default)

    @property
    def sampled(self) -> SampledObject:
        """All parts."""
        return self.assembly.sampled

    @property
    def category(self) -> str:
        """Key of the category, "" if unknown."""
        return self.assembly.category

    @property
    def shape(self) -> PartShape:
        """The part."""
        return self.sampled.shapes[self.part]

    @property
    def parent(self) -> int:
        """Index of the parent."""
        return self.assembly.parent[self.part]

    @property
    def parent_shape(self) -> PartShape:
        """Shape of the parent."""
        return self.sampled.shapes[self.parent]

    @cached_property
    def words(self) -> tuple[str, ...]:
        """Words of the part's name."""
        return words(self.shape.name)

    @cached_property
    def distance(self) -> Array:
        """(N,) distance of each of the part's points to the parent."""
        return self.sampled.distances(self.part, self.parent)

    @cached_property
    def contact(self) -> Array:
        """(K, 3) the part's points nearest to the parent."""
        return self.sampled.contact(self.part, self.parent)

    @cached_property
    def contact_center(self) -> Array:
        """(3,) mean of :attr:`contact`."""
        return self.contact.mean(0)

    @cached_property
    def in_contact(self) -> bool:
        """True if the part is in contact with its parent."""
        return bool(self.sampled.gap[self.part, self.parent] < 2 * CONTACT_GAP)

    @cached_property
    def directions(self) -> Array:
        """(6, 3) the part's box axes, then their opposites."""
        axes = self.shape.box.axes.T
        return np.concatenate([axes, -axes])

    @cached_property
    def covers(self) -> Array:
        """(6,) how much the parent covers the part along :attr:`directions`, 0..1."""
        return self.covers_of((self.parent,))

    def covers_of(self, others: tuple[int, ...]) -> Array:
        """(6,) how much ``others`` cover the part along :attr:`directions`, 0..1."""
        axes = self.shape.box.axes
        return np.array([self.sampled.cover(self.part, d, others, axes) for d in self.directions])

    @cached_property
    def outward(self) -> Array:
        """(3,) the most open of :attr:`directions`, with the parent behind."""
        return self.directions[int(np.argmax(self.outwardness))]

    @cached_property
    def outwardness(self) -> Array:
        """(6,) score: parent behind, nothing in front, thin, away from the parent."""
        covers = self.covers
        behind = np.roll(covers, 3)
        away = self.directions @ unit(self.shape.center - self.parent_shape.center)
        half = self.shape.box.half
        thin = 1 - half / max(float(half.max()), NOTHING)
        return behind - 1.3 * covers + 0.35 * away + 0.5 * np.concatenate([thin, thin])

    def panel_outward(self, axis: Array) -> Array:
        """``axis`` or its opposite, whichever points away from the parent."""
        there = self.sampled.cover(self.part, axis, (self.parent,), self.shape.box.axes)
        back = self.sampled.cover(self.part, -axis, (self.parent,), self.shape.box.axes)
        away = float(axis @ (self.shape.center - self.parent_shape.center))
        score = back - there + 0.6 * np.tanh(6 * away)
        score -= sum(float(np.sign(axis @ away)) for away in self.push_bars)
        return axis if score >= 0 else -axis

    @cached_property
    def push_bars(self) -> list[Array]:
        """(3,) from the part's centre to each bar on it that is pushed: it opens away from them."""
        sampled, shape = self.sampled, self.shape
        return [
            sampled.shapes[j].center - shape.center
            for j, above in enumerate(self.assembly.parent)
            if above == self.part
            and sampled.shapes[j].size > BAR * shape.size
            and mechanism_of(sampled.shapes[j].name, sampled.category)[0] == "press"
        ]

    @cached_property
    def panel_normal(self) -> Array:
        """(3,) the panel's normal away from the parent."""
        return self.panel_outward(self.shape.box.axes[:, self.shape.panel.normal])

    @cached_property
    def normals_around(self) -> Array:
        """(K, 3) normals of the parent's surface around the part."""
        reach = max(0.6 * self.shape.size, 0.03)
        index = self.sampled.tree(self.parent).query_ball_point(self.shape.center, reach)
        return self.parent_shape.normals[np.asarray(index, int)]

    @cached_property
    def _beside(self) -> npt.NDArray[np.int64]:
        """(K,) the points of the parent that are nearest to the part."""
        far = self.sampled.distances(self.parent, self.part)
        nearest = np.argsort(far)[:BESIDE]
        return nearest[far[nearest] < max(self.shape.size, 0.03)]

    @cached_property
    def surface_normal(self) -> Array | None:
        """(3,) direction shared by most of :attr:`normals_around`; None if they don't agree."""
        normals = self.normals_around
        if len(normals) < 6:
            return None
        values, vectors = np.linalg.eigh(normals.T @ normals / len(normals))
        return vectors[:, 2] if values[2] > 0.75 else None

    @cached_property
    def knob_normal(self) -> Array | None:
        """(3,) normal of the panel on which a small part, and those of its name and size, sit; None
        for other parts, wheels, and those of a mesh that are round about another axis."""
        if self.shape.size > KNOB or not len(self._beside):
            return None
        normals = np.concatenate([self.parent_shape.normals[c._beside] for c in self._equals()])
        alike = np.abs(normals @ normals.T) > OF_PANEL
        near = normals[alike[alike.sum(1).argmax()]]
        if len(normals) < BESIDE / 2 or len(near) < EVEN * len(normals):
            return None
        normal = np.linalg.eigh(near.T @ near)[1][:, 2]
        round_about = None if self.shape.scanned else self.shape.roundest
        if round_about is not None and abs(float(round_about.axis @ normal)) < PARALLEL:
            return None
        low = self.shape.low[2] - self.sampled.low[2]
        up = self.shape.center - self.parent_shape.points[self._beside].mean(0)
        on_top = abs(float(normal[2])) > ACROSS and up[2] > 0  # of something flat, as a hob
        if WHEELS & set(self.words) or (low < 0.5 * self.shape.size and not on_top):
            return None
        return snapped(normal, np.eye(3), SQUARE)

    def _equals(self) -> list[PartContext]:
        """The part, and the nearest others on its parent of the same words and about its size."""
        found = [
            PartContext(self.assembly, j)
            for j, s in enumerate(self.sampled.shapes)
            if self.assembly.parent[j] == self.parent
            and words(s.name) == self.words
            and LIKE < s.size / max(self.shape.size, NOTHING) < 1 / LIKE
        ]
        found.sort(key=lambda c: float(np.linalg.norm(c.shape.center - self.shape.center)))
        return found[:EQUALS]

    @cached_property
    def front_normal(self) -> Array | None:
        """(3,) level normal of a part that is a standing front, without a body; None for others."""
        shape, panel = self.shape, self.shape.panel
        normal = shape.box.axes[:, panel.normal]
        thick = (panel.high - panel.low) / 2
        flat = thick < FLAT * float(shape.box.half[shape.order[1]])
        return normal if flat and abs(float(normal[2])) < ACROSS else None

    @cached_property
    def handle(self) -> Protrusion | None:
        """The protrusion of the panel's outer face."""
        panel = self.shape.panel
        return panel.beyond(float(self.shape.box.axes[:, panel.normal] @ self.panel_normal))

    @cached_property
    def grips(self) -> list[tuple[Array, Array, float]]:
        """Handles or else latches at the rim behind, and knobs that are separate parts.

        Each is (centre, spread) in the panel's box coordinates, and strength 0..1.
        """
        panel, box, sampled = self.shape.panel, self.shape.box, self.sampled
        out: list[tuple[Array, Array, float]] = []
        front = float(box.axes[:, panel.normal] @ self.panel_normal)
        # Where the front has a handle, what lies behind the rim is a side of the panel or its body.
        for side in (front, -front):
            found = None if out else panel.beyond(side)
            if found is None or found.strength == 0:
                continue
            rim = np.abs(np.delete(found.center / np.maximum(box.half, TINY), panel.normal)).max()
            if side == front or (rim > 0.85 and found.share < 0.05):
                out.append((found.center, found.spread, found.strength))
        for j, above in enumerate(self.assembly.parent):
            if above == self.part and sampled.shapes[j].size < 0.5 * self.shape.size:
                other = sampled.shapes[j]
                out.append((box.local(other.center[None])[0], box.local(other.points).std(0), 1.0))
        return out

    @cached_property
    def closed(self) -> bool:
        """True if the panel lies in or on its parent's box, as shut doors and lids do."""
        shape, base = self.shape, self.parent_shape
        panel, box = shape.panel, shape.box
        low, high = -box.half.copy(), box.half.copy()
        low[panel.normal], high[panel.normal] = panel.low, panel.high
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        world = corners @ box.axes.T + box.center
        slack = 0.03 + (panel.high - panel.low)
        inside = (world > base.low - slack) & (world < base.high + slack)
        return bool(inside.all(1).mean() >= 0.75)

    @cached_property
    def shut(self) -> bool:
        """True if a door, drawer or lid is shut: :attr:`closed`, or square to the object and close
        in front of its parent."""
        if self.closed:
            return True
        shape, base = self.shape, self.parent_shape
        normal = self.panel_normal
        across = np.abs(normal) > ACROSS
        if np.abs(normal).max() < np.cos(SQUARE):
            return False
        # Seen along its normal, an open door stands beside its parent.
        overlap = np.minimum(shape.high, base.high) - np.maximum(shape.low, base.low)
        shared = np.maximum(overlap + 0.03, 0) / np.maximum(shape.high - shape.low, TINY)
        return bool(
            np.minimum(shared, 1.0)[~across].prod() >= 0.75 and -overlap[across].max() < IN_FRONT
        )

    @cached_property
    def clock_hand(self) -> bool:
        """True if the part is a clock hand: by name, or a slender part on the face of a disc."""
        if "hand" in self.words:
            return True
        shape, base = self.shape, self.parent_shape
        if shape.slenderness > SLENDER_HAND or base.thinness > 0.5:
            return False
        face = base.roundest
        axis = face.axis if face is not None else base.box.axes[:, base.order[0]]
        if abs(float(shape.box.axes[:, shape.order[0]] @ axis)) < PARALLEL:
            return False
        if face is not None:
            return shape.size < 1.2 * face.radius
        # On a dial that isn't round, hands are two slender parts that cross.
        return HAND < shape.size < 0.5 * base.size and any(
            self.sampled.shapes[j].size > HAND and self.sampled.gap[self.part, j] < 0.02
            for j in self.crossing_hands(axis)
            if j != self.parent
        )

    def crossing_hands(self, axis: Array) -> list[int]:
        """Other slender parts on the same parent that lie across ``axis`` (3,)."""
        there = [(j, self.sampled.shapes[j]) for j in self.sampled.others(self.part)]
        return [
            j
            for j, other in there
            if other.slenderness < SLENDER_HAND
            and self.assembly.parent[j] == self.parent
            and abs(float(other.box.axes[:, other.order[0]] @ axis)) > PARALLEL
        ]

    def upright(self) -> Array:
        """The part's box axis nearest to +z, pointing up; +z if none is near."""
        axes = self.shape.box.axes
        k = int(np.argmax(np.abs(axes[2])))
        return axes[:, k] * (1.0 if axes[2, k] >= 0 else -1.0) if abs(axes[2, k]) > UPWARD else UP


GROUPS = tuple(dict.fromkeys(row.group for row in MECHANISM_TABLE.values() if row.group))


def part_evidence(context: PartContext, mechanism: Mechanism | None) -> dict[str, float]:
    """Name → number, 0..1 unless stated otherwise; see :mod:`model.prediction.builder`.

    Args:
        mechanism: of the predicted joint; None if none was chosen.
    """
    sampled, shape = context.sampled, context.shape
    named, _ = mechanism_of(shape.name, sampled.category)
    group = "" if mechanism is None else MECHANISM_TABLE[mechanism].group
    panel = group == "panel"
    out = {
        "named": float(named is not None),
        "scanned": float(sampled.scanned),
        "apart": float(sampled.gap[context.part, context.parent] > 2 * CONTACT_GAP),
        # Standard deviation in percent of the diagonal, and decades below it.
        "noise": min(100 * float(sampled.noise), 5.0),
        "small": float(np.clip(-np.log10(max(shape.size, 1e-3)), 0, 3)),
        "shut panel": float(panel and context.closed),
        "panel with a handle": float(panel and bool(context.grips)),
    }
    return out | {name: float(name == group) for name in GROUPS}
