"""Marks over an object: joints with axes, collisions and the worst pose; comments with their
numbers; the preview of a click and points of a cut.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.display_tasks import PartPayload
from app.server.validating import JointCollision
from app.viewer.picture import palette
from app.viewer.picture.stage import add_ball
from model.core.tree import KinematicTree

_TOWARD_CAMERA = 0.006
_DOT = 0.0032
_MARK = 0.006
_LINE_PIXELS = 3.0


class Overlays:
    """Short-lived marks in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no mark is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client = client
        self._diagonal = diagonal
        self._dots: dict[str, Any] = {}
        self._places: list[Any] = []
        self._measure: list[Any] = []

    def show_hover(
        self,
        gained: npt.NDArray[np.float32] | None,
        lost: npt.NDArray[np.float32] | None,
        color: palette.Rgb,
    ) -> None:
        """Draw dots on elements that a click would add, dark ones on those it would remove."""
        if self._diagonal is None:
            return
        with self._client.atomic():
            self._put("gained", gained, _light(color), self._diagonal)
            self._put("lost", lost, palette.NEGATIVE, self._diagonal)

    def show_finds(self, finds: Sequence[npt.NDArray[np.float32]], at: int) -> None:
        """Draw dots on what a tool found, strong ones on the piece that keys act on."""
        if self._diagonal is None:
            return
        others = [points for k, points in enumerate(finds) if k != at]
        rest = np.concatenate(others) if others else None
        with self._client.atomic():
            self._put("gained", rest, _light(palette.SELECTED), self._diagonal)
            self._put("lost", finds[at] if finds else None, palette.SELECTED, self._diagonal)

    def _put(
        self,
        name: str,
        points: npt.NDArray[np.float32] | None,
        color: palette.Rgb,
        diagonal: float,
    ) -> None:
        if points is None or not len(points):
            if name in self._dots:
                self._dots.pop(name).remove()
            return
        # A little nearer to the camera, so that the dots win over the surface they lie on.
        camera = np.asarray(self._client.camera.position, np.float32)
        near = points + _TOWARD_CAMERA * (camera - points)
        self._dots[name] = self._client.scene.add_point_cloud(
            f"/hover/{name}",
            near.astype(np.float32),
            color,
            point_size=_DOT * diagonal,
            point_shape="circle",
            precision="float32",
        )

    def show_places(self, places: tuple[tuple[float, float, float], ...]) -> None:
        """Mark the points of a cut."""
        if self._diagonal is None:
            return
        for handle in self._places:
            handle.remove()
        self._places = self._balls("/place", places, palette.CONTACT, self._diagonal)

    def _balls(
        self, name: str, places: Sequence[Any], color: palette.Rgb, diagonal: float
    ) -> list[Any]:
        """Draw a small ball at each place, (3,); returns the handles."""
        scene, radius = self._client.scene, _MARK * diagonal
        return [add_ball(scene, f"{name}/{k}", at, radius, color) for k, at in enumerate(places)]

    def show_measure(self, places: Sequence[npt.NDArray[np.float64]], text: str) -> None:
        """Mark one or two points, (3,) each, and the line between them with ``text``."""
        if self._diagonal is None:
            return
        for handle in self._measure:
            handle.remove()
        scene = self._client.scene
        self._measure = self._balls("/measure", places, palette.SELECTED, self._diagonal)
        if len(places) == 2:
            ends = np.stack(places).astype(np.float32)
            self._measure += [
                scene.add_line_segments(
                    "/measure/line",
                    ends[None],
                    palette.SELECTED,
                    thickness=_LINE_PIXELS,
                    thickness_units="screen",
                ),
                scene.add_label(
                    "/measure/label", text, position=ends.mean(axis=0), anchor="bottom-center"
                ),
            ]


def _light(color: palette.Rgb) -> palette.Rgb:
    """A lighter color."""
    r, g, b = (int(c + 0.45 * (255 - c)) for c in color)
    return (r, g, b)


_RADIUS = 0.014
"""Radius of a marker, and :data:`_REACH`, tolerance of a click on it; in the object's diagonal."""
_REACH = 0.02
Point = tuple[float, float, float]


@dataclass(frozen=True)
class CommentMark:
    """A comment: its number, its place (3,) at rest, and the text that is shown beside it."""

    number: int
    place: Point
    text: str
    chosen: bool


class CommentMarks:
    """The markers of one object in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no marker is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client, self._diagonal = client, diagonal
        self._shown: dict[CommentMark, list[Any]] = {}

    def show(self, marks: Sequence[CommentMark]) -> None:
        """Draw markers; only those that changed are sent."""
        if self._diagonal is None:
            return
        for mark in [m for m in self._shown if m not in marks]:
            for handle in self._shown.pop(mark):
                handle.remove()
        for mark in marks:
            if mark not in self._shown:
                self._shown[mark] = self._draw(mark, self._diagonal)

    def _draw(self, mark: CommentMark, diagonal: float) -> list[Any]:
        scene, radius = self._client.scene, _RADIUS * diagonal
        name = f"/comment/{mark.number}"
        color = palette.SELECTED if mark.chosen else palette.COMMENT
        ball = add_ball(scene, name, mark.place, radius, color)
        label = scene.add_label(
            f"{name}/label", mark.text, position=(0.0, 0.0, 1.6 * radius), anchor="bottom-center"
        )
        return [label, ball]

    def hit(self, origin: Point, direction: Point) -> int | None:
        """Return the number of the nearest marker that a ray passes, or None."""
        if self._diagonal is None:
            return None
        unit = np.asarray(direction) / np.linalg.norm(direction)
        found = []
        for mark in self._shown:
            away = np.subtract(mark.place, origin)
            along = float(away @ unit)
            if along > 0 and np.linalg.norm(away - along * unit) < _REACH * self._diagonal:
                found.append((along, mark.number))
        return min(found)[1] if found else None


Poses = Mapping[str, npt.NDArray[np.float64]]
"""Link → posed_from_rest."""

NEAR_TURN, NEAR_SHIFT = np.radians(4.0), 0.025
"""Distance from a contact's pose up to which its mark shows: radians, diagonals at the contact."""


@dataclass(frozen=True)
class AxisMark:
    """One axis to draw: an arrow through ``origin`` along ``axis`` in its parent's pose, with a
    ``label`` at its head.
    """

    key: str
    parent: str
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    length: float
    color: palette.Rgb
    thick: bool
    label: str = ""


@dataclass(frozen=True, eq=False)
class _Contact:
    """The mark of a contact.

    Attributes:
        where: (3,) in the pose in which it was found.
        moved, held: the links that meet, and ``rest_from_posed`` of each there.
    """

    ball: Any
    where: npt.NDArray[np.float64]
    moved: tuple[str, npt.NDArray[np.float64]]
    held: tuple[str, npt.NDArray[np.float64]]


class JointMarks:
    """The marks of one object in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no mark is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client = client
        self._diagonal = diagonal
        self._lock = threading.Lock()  # animations pose from a thread of their own
        self._axes: dict[str, tuple[AxisMark, Any]] = {}
        self._contacts: list[_Contact] = []
        self._contact_key: Any = None
        self._moment: list[Any] = []
        self._directions: list[Any] = []

    def show_axes(self, marks: Iterable[AxisMark]) -> None:
        """Draw joint axes as arrows; only those that changed are sent."""
        if self._diagonal is None:
            return
        wanted = {m.key: m for m in marks}
        with self._lock:
            for key in [k for k, (m, _) in self._axes.items() if wanted.get(k) != m]:
                self._axes.pop(key)[1].remove()
            for key, mark in wanted.items():
                if key not in self._axes:
                    self._axes[key] = (mark, self._arrow(mark, self._diagonal))

    def _arrow(self, mark: AxisMark, diagonal: float) -> Any:
        origin, axis = np.asarray(mark.origin), np.asarray(mark.axis)
        width = diagonal * (0.0042 if mark.thick else 0.0026)
        ends = np.stack([origin - 0.5 * mark.length * axis, origin + 0.62 * mark.length * axis])
        name = f"/axis/{mark.key}"
        arrow = self._client.scene.add_arrows(
            name,
            ends[None].astype(np.float32),
            mark.color,
            shaft_radius=width,
            head_radius=2.6 * width,
            head_length=6.5 * width,
        )
        if mark.label:  # a child of the arrow, which goes with it
            self._client.scene.add_label(f"{name}/label", mark.label, position=ends[1])
        return arrow

    def show_directions(self, corner: npt.NDArray[np.float64] | None) -> None:
        """Show arrows X, Y and Z beside the corner (3,) of the object; None removes them."""
        if self._diagonal is None or (corner is None) == (not self._directions):
            return
        gone, self._directions = self._directions, []
        for handle in gone:
            handle.remove()
        if corner is None:
            return
        at, length = corner - 0.04 * self._diagonal, 0.12 * self._diagonal
        for axis, name, color in zip(np.eye(3), "XYZ", palette.DIRECTIONS, strict=True):
            way, middle = tuple(axis), tuple(at + 0.5 * length * axis)
            arrow = self._arrow(
                AxisMark(f"of-{name}", "", middle, way, length, color, False), self._diagonal
            )
            label = self._client.scene.add_label(
                f"/direction/{name}", name, position=at + 1.3 * length * axis
            )
            self._directions += [arrow, label]

    def show_contacts(self, checks: Sequence[JointCollision], tree: KinematicTree | None) -> None:
        """Mark where a sweep hits something; without a tree nothing is marked."""
        hits = [c for c in checks if tree is not None and c.joint in tree.by_name]
        key = (tree, tuple((c.joint, c.q, c.where, c.other) for c in hits))
        if key == self._contact_key or self._diagonal is None:
            return
        self._contact_key = key
        with self._lock:
            for contact in self._contacts:
                contact.ball.remove()
            self._contacts = [
                self._contact(f"/contact/{k}", check, tree, 0.009 * self._diagonal)
                for k, check in enumerate(hits)
                if tree is not None
            ]

    def _contact(
        self, name: str, check: JointCollision, tree: KinematicTree, radius: float
    ) -> _Contact:
        joint, then = tree.by_name[check.joint], tree.pose({check.joint: check.q})
        other = check.other if check.other in then else joint.parent
        ball = add_ball(self._client.scene, name, check.where, radius, palette.CONTACT, 0.85)
        ball.visible = False
        back = {k: np.asarray(np.linalg.inv(then[k]), np.float64) for k in (joint.child, other)}
        moved, held = (joint.child, back[joint.child]), (other, back[other])
        return _Contact(ball, np.array(check.where), moved, held)

    def pose(self, poses: Poses) -> None:
        """Move the axes with their parents, and show the contacts that belong to the pose."""
        with self._lock:
            turned: dict[str, Any] = {}
            for mark, handle in self._axes.values():
                transform = poses.get(mark.parent, np.eye(4))
                if mark.parent not in turned:
                    turned[mark.parent] = vtf.SO3.from_matrix(transform[:3, :3]).wxyz
                handle.wxyz, handle.position = turned[mark.parent], transform[:3, 3]
            for contact in self._contacts:
                self._pose_contact(contact, poses)

    def _pose_contact(self, contact: _Contact, poses: Poses) -> None:
        assert self._diagonal is not None
        moved, held = (
            poses.get(link, np.eye(4)) @ back for link, back in (contact.moved, contact.held)
        )
        at = (held @ [*contact.where, 1.0])[:3]
        apart = float(np.linalg.norm((moved @ [*contact.where, 1.0])[:3] - at))
        cosine = (float(np.trace(held[:3, :3].T @ moved[:3, :3])) - 1.0) / 2.0
        contact.ball.position = at
        near = apart <= NEAR_SHIFT * self._diagonal and cosine >= np.cos(NEAR_TURN)
        contact.ball.visible = bool(near)

    def show_moment(self, where: tuple[float, float, float] | None, text: str) -> None:
        """Mark one contact, visible through the parts; None removes the mark."""
        gone, self._moment = self._moment, []
        for handle in gone:
            handle.remove()
        if where is None or self._diagonal is None:
            return
        radius = 0.016 * self._diagonal
        ball = add_ball(self._client.scene, "/moment", where, radius, palette.CONTACT, 0.9)
        # Labels are drawn over everything, the ball is inside of what meets there.
        cross = self._client.scene.add_label("/moment/cross", "✖", anchor="center-center")
        label = self._client.scene.add_label(
            "/moment/label", text, position=(0.0, 0.0, 2.5 * radius), anchor="bottom-center"
        )
        self._moment = [cross, label, ball]


def axis_length(
    payloads: Sequence[PartPayload] | None,
    link: str,
    axis: tuple[float, float, float],
    diagonal: float,
) -> float:
    """The length of an arrow along ``axis`` that sticks out of a link's part at both ends."""
    part = link.removeprefix("link_")
    for payload in payloads or ():
        if str(payload.part) == part and len(payload.shape):
            along = payload.shape @ np.asarray(axis, np.float32)
            return float(np.clip(1.25 * np.ptp(along), 0.12 * diagonal, 1.1 * diagonal))
    return 0.3 * diagonal
