"""What a mechanism may look at when it proposes the joint of one part."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from model.core.part_names import category_key, words
from model.prediction.geometric.assembly import TOUCHING, Scene
from model.prediction.geometric.hypothesis import UP, unit
from model.prediction.geometric.shape import Protrusion, Shape

Array = npt.NDArray[np.float64]

SQUARE = np.deg2rad(8)
"""How far off the object's directions a panel may be that counts as shut."""
IN_FRONT = 0.1
"""Largest gap (diagonals) between a shut panel and what it shuts."""


@dataclass(eq=False)
class Assembly:
    """A scene with its tree.

    Attributes:
        scene: the parts. root: index of the base. parent: index of each part's parent, -1 at the
            root.
        front: where the object faces, (3,) horizontal unit vector, and how sure that is (0..1).
    """

    scene: Scene
    root: int
    parent: list[int]
    front: Array = field(default_factory=lambda: np.array([-1.0, 0.0, 0.0]))
    front_certainty: float = 0.0

    @cached_property
    def category(self) -> str:
        """Key of the category, "" where unknown."""
        return category_key(self.scene.category)


@dataclass(eq=False)
class PartContext:
    """One part within its assembly."""

    assembly: Assembly
    part: int
    barrels: dict[bytes, tuple[Array, int] | None] = field(default_factory=dict)
    """By axis and place of an edge: its mechanisms share what is found there."""

    @property
    def scene(self) -> Scene:
        """All parts."""
        return self.assembly.scene

    @property
    def category(self) -> str:
        """Key of the category, "" where unknown."""
        return self.assembly.category

    @property
    def shape(self) -> Shape:
        """The part."""
        return self.scene.shapes[self.part]

    @property
    def parent(self) -> int:
        """Index of the part that it hangs on."""
        return self.assembly.parent[self.part]

    @property
    def base(self) -> Shape:
        """The part that it hangs on."""
        return self.scene.shapes[self.parent]

    @cached_property
    def words(self) -> tuple[str, ...]:
        """Words of its name."""
        return words(self.shape.name)

    @cached_property
    def distance(self) -> Array:
        """(N,) of each sample to the parent."""
        return self.scene.distances(self.part, self.parent)

    @cached_property
    def contact(self) -> Array:
        """(K, 3) samples nearest to the parent."""
        return self.scene.contact(self.part, self.parent)

    @cached_property
    def contact_center(self) -> Array:
        """(3,) of the contact."""
        return self.contact.mean(0)

    @cached_property
    def touching(self) -> bool:
        """Whether the part touches its parent."""
        return bool(self.scene.gap[self.part, self.parent] < 2 * TOUCHING)

    @cached_property
    def directions(self) -> Array:
        """(6, 3) the part's box axes, both ways."""
        axes = self.shape.box.axes.T
        return np.concatenate([axes, -axes])

    @cached_property
    def covers(self) -> Array:
        """(6,) how much of the part the parent lies in front of, along :attr:`directions`."""
        return self.covers_of((self.parent,))

    def covers_of(self, others: tuple[int, ...]) -> Array:
        """(6,) the same for other parts."""
        axes = self.shape.box.axes
        return np.array([self.scene.cover(self.part, d, others, axes) for d in self.directions])

    @cached_property
    def outward(self) -> Array:
        """(3,) box direction in which the part is freest and the parent lies behind it."""
        return self.directions[int(np.argmax(self.outwardness))]

    @cached_property
    def outwardness(self) -> Array:
        """(6,) for each direction: parent behind, nothing in front, thin, away from the parent."""
        covers = self.covers
        behind = np.roll(covers, 3)
        away = self.directions @ unit(self.shape.center - self.base.center)
        half = self.shape.box.half
        thin = 1 - half / max(float(half.max()), 1e-9)
        return behind - 1.3 * covers + 0.35 * away + 0.5 * np.concatenate([thin, thin])

    def panel_outward(self, axis: Array) -> Array:
        """``axis`` turned to the side that faces away from the parent."""
        there = self.scene.cover(self.part, axis, (self.parent,), self.shape.box.axes)
        back = self.scene.cover(self.part, -axis, (self.parent,), self.shape.box.axes)
        away = float(axis @ (self.shape.center - self.base.center))
        score = back - there + 0.6 * np.tanh(6 * away)
        normal = self.shape.panel.normal
        along = float(self.shape.box.axes[:, normal] @ axis)
        if abs(along) > 0.9:
            for side in (-1.0, 1.0):
                out = self.shape.panel.beyond(side * np.sign(along))
                if out is not None and out.share < 0.15:
                    score += 0.2 * side
        return axis if score >= 0 else -axis

    @cached_property
    def panel_normal(self) -> Array:
        """(3,) the panel's normal, away from the parent."""
        return self.panel_outward(self.shape.box.axes[:, self.shape.panel.normal])

    @cached_property
    def handle(self) -> Protrusion | None:
        """What sticks out of the panel's outer face."""
        panel = self.shape.panel
        return panel.beyond(float(self.shape.box.axes[:, panel.normal] @ self.panel_normal))

    @cached_property
    def grips(self) -> list[tuple[Array, Array, float]]:
        """What a hand would take on the panel: (place, spread) in box coordinates, and strength.

        Handles of its own, latches at its rim, and knobs that are parts of their own.
        """
        panel, box, scene = self.shape.panel, self.shape.box, self.scene
        out: list[tuple[Array, Array, float]] = []
        front = float(box.axes[:, panel.normal] @ self.panel_normal)
        for side in (front, -front):
            found = panel.beyond(side)
            if found is None or found.strength == 0:
                continue
            rim = np.abs(np.delete(found.center / np.maximum(box.half, 1e-6), panel.normal)).max()
            if side == front or (rim > 0.85 and found.share < 0.05):
                out.append((found.center, found.spread, found.strength))
        for j, above in enumerate(self.assembly.parent):
            if above == self.part and scene.shapes[j].size < 0.5 * self.shape.size:
                other = scene.shapes[j]
                out.append((box.local(other.center[None])[0], box.local(other.points).std(0), 1.0))
        return out

    @cached_property
    def closed(self) -> bool:
        """Whether the panel lies in or on its parent's box, as closed doors and lids do."""
        shape, base = self.shape, self.base
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
        """Whether a door, a drawer or a lid was scanned shut: :attr:`closed`, or square to the
        object and in front of its parent, with a gap between them."""
        if self.closed:
            return True
        shape, base = self.shape, self.base
        normal = self.panel_normal
        across = np.abs(normal) > 0.5
        if np.abs(normal).max() < np.cos(SQUARE):
            return False
        # An open one stands beside what it shuts, seen along its own normal.
        overlap = np.minimum(shape.high, base.high) - np.maximum(shape.low, base.low)
        shared = np.maximum(overlap + 0.03, 0) / np.maximum(shape.high - shape.low, 1e-6)
        return bool(
            np.minimum(shared, 1.0)[~across].prod() >= 0.75 and -overlap[across].max() < IN_FRONT
        )

    @cached_property
    def hand(self) -> bool:
        """Whether it is a hand on a dial: called so, or a sliver on the face of a flat disc."""
        if "hand" in self.words:
            return True
        shape, base = self.shape, self.base
        if shape.slenderness > 0.35 or base.thinness > 0.5:
            return False
        face = base.roundest
        axis = face.axis if face is not None else base.box.axes[:, base.order[0]]
        if abs(float(shape.box.axes[:, shape.order[0]] @ axis)) < 0.95:
            return False
        if face is not None:
            return shape.size < 1.2 * face.radius
        # On a dial that isn't round only two that cross are hands.
        return 0.1 < shape.size < 0.5 * base.size and any(
            self.scene.shapes[j].slenderness < 0.35
            and self.scene.shapes[j].size > 0.1
            and self.assembly.parent[j] == self.parent
            and abs(float(self.scene.shapes[j].box.axes[:, self.scene.shapes[j].order[0]] @ axis))
            > 0.95
            and self.scene.gap[self.part, j] < 0.02
            for j in self.scene.others(self.part)
            if j != self.parent
        )

    def upright(self) -> Array:
        """The part's box axis nearest to +z, pointing up."""
        axes = self.shape.box.axes
        k = int(np.argmax(np.abs(axes[2])))
        return axes[:, k] * (1.0 if axes[2, k] >= 0 else -1.0) if abs(axes[2, k]) > 0.9 else UP
