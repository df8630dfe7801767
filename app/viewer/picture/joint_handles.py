"""Handles in 3D for the axis of the selected joint, and for its limits: an arc round the axis or a
bar along it with a grip at each end.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.viewer.picture import palette
from app.viewer.picture.stage import add_ball
from app.viewer.tab import Step, Tab
from app.viewer.words.joints import limit_label
from model.core.joint import Joint
from sessions import commands as cmd

Pose = npt.NDArray[np.float64]


class AxisHandles:
    """Handles that the user drags; letting go of them moves the joint's axis.

    Args:
        parent_pose: of a joint: (4, 4) posed_from_rest of its parent now.
        grabbed: called when the user takes hold of the handles.

    Attributes:
        on: whether the selected joint has handles.
    """

    def __init__(
        self, tab: Tab, parent_pose: Callable[[Joint], Pose], grabbed: Callable[[], None]
    ) -> None:
        self._tab = tab
        self._parent_pose = parent_pose
        self._grabbed = grabbed
        self.on = False
        self._handles: Any = None
        self._key: Any = None
        self._dragged = False
        tab.selection.on_step(self._step_begins)

    def _step_begins(self, step: Step) -> None:
        self.on = self.on and step == "Joints"

    def forget(self) -> None:
        """Note that the picture was cleared, and the handles with it."""
        self._handles, self._key, self._dragged = None, None, False

    def draw(self) -> None:
        """Bring the handles up to date."""
        joint, obj = self._tab.selection.joint, self._tab.selection.object
        wanted = joint if self.on and joint is not None and joint.moves else None
        key = None if wanted is None else (wanted.child, wanted.parent, wanted.origin, wanted.axis)
        if key == self._key:
            return
        self._key, self._dragged = key, False
        if self._handles is not None:
            self._handles.remove()
            self._handles = None
        if wanted is None or obj is None or obj.asset is None:
            return
        position, wxyz = _axis_frame(wanted, self._parent_pose(wanted))
        self._handles = self._tab.client.scene.add_transform_controls(
            "/gizmo",
            scale=0.22 * obj.asset.diagonal,
            position=position,
            wxyz=wxyz,
            depth_test=False,
        )

        @self._handles.on_update
        def _(event: Any) -> None:
            if event.phase == "start":
                self._dragged = True
                self._tab.act(self._grabbed)
            elif event.phase == "end":
                self._tab.act(self.release)

    def place(self, poses: Mapping[str, Pose]) -> None:
        """Move the handles with the joint's parent, unless the user drags them."""
        joint, handles = self._tab.selection.joint, self._handles
        if handles is None or joint is None or self._dragged or joint.parent not in poses:
            return
        position, wxyz = _axis_frame(joint, poses[joint.parent])
        if not np.allclose(position, handles.position, atol=1e-9):
            handles.position = position
        if not np.allclose(wxyz, handles.wxyz, atol=1e-9):
            handles.wxyz = wxyz

    def release(self) -> None:
        """Give the joint the axis at which the handles were let go."""
        self._dragged = False
        handles, joint = self._handles, self._tab.selection.joint
        if handles is None or joint is None:
            return
        self._key = None  # drawn again where the joint is now, also if this is refused
        rest = np.linalg.inv(self._parent_pose(joint))
        axis = rest[:3, :3] @ vtf.SO3(np.asarray(handles.wxyz)).as_matrix()[:, 2]
        origin = rest[:3, :3] @ np.asarray(handles.position, np.float64) + rest[:3, 3]
        moved = dataclasses.replace(
            joint, origin=tuple(float(v) for v in origin), axis=tuple(float(v) for v in axis)
        )
        self._tab.do(cmd.SetJoint(moved))


def _axis_frame(joint: Joint, posed_from_rest: Pose) -> tuple[Any, Any]:
    """Position of a joint's axis, and a rotation, wxyz, whose z is the axis."""
    turn = vtf.SO3.from_matrix(posed_from_rest[:3, :3])
    place = posed_from_rest[:3, :3] @ np.asarray(joint.origin) + posed_from_rest[:3, 3]
    return place, (turn @ vtf.SO3(_frame_along(joint.axis))).wxyz


def _frame_along(axis: tuple[float, float, float]) -> Any:
    """A rotation whose z is ``axis``; quaternion wxyz."""
    z = np.asarray(axis)
    x = _across(z)
    return vtf.SO3.from_matrix(np.column_stack([x, np.cross(z, x), z])).wxyz


Array = npt.NDArray[np.float64]
Side = Literal["lower", "upper"]

STEP: Final[dict[bool, float]] = {True: math.radians(5.0), False: 0.005}
"""Steps of Shift, by whether the joint rotates: 5° or 5 mm."""
FINE: Final[dict[bool, float]] = {True: math.radians(0.1), False: 1e-4}
"""Without Shift: as the fields show it, 0.1° or 0.1 mm."""
_OUTSIDE = 1.06
"""The arc's radius over that of the part, so that the part doesn't hide it."""
_LEAST, _MOST = 0.09, 0.9
"""Bounds of the arc's radius, shares of the object's diagonal."""
_SLANTED = 0.15
"""Sine of the angle between ray and the arc's plane, below which the plane is seen edge-on."""
_ARC_STEP = math.radians(4.0)


@dataclass(frozen=True, eq=False)
class LimitGauge:
    """An arc or a bar in the frame of the joint's parent at rest.

    Attributes:
        rotates: whether it is an arc.
        center: (3,) metres, middle of the arc, or where the bar has its zero.
        axis: (3,) unit.
        zero: (3,) unit, from the arc's middle to its zero; across the bar.
        radius: of the arc, metres.
    """

    rotates: bool
    center: Array
    axis: Array
    zero: Array
    radius: float

    @classmethod
    def of(cls, joint: Joint, points: Array, diagonal: float) -> LimitGauge:
        """The gauge of a joint beside its part.

        Args:
            points: (N, 3) of the part that it moves, at rest; metres.
            diagonal: of the object, metres.
        """
        axis, origin = np.asarray(joint.axis, np.float64), np.asarray(joint.origin, np.float64)
        points = np.asarray(points, np.float64)
        if not len(points):
            points = origin[None]
        along = (points - origin) @ axis
        away = points - origin - along[:, None] * axis
        if not joint.rotates:
            lead = float(along.max()) + 0.01 * diagonal
            middle = (points.min(axis=0) + points.max(axis=0)) / 2
            return cls(
                False, middle + (lead - (middle - origin) @ axis) * axis, axis, _across(axis), 0.0
            )
        reach = np.linalg.norm(away, axis=1)
        zero = away.mean(axis=0)
        if np.linalg.norm(zero) < 0.05 * max(float(reach.max()), 1e-9):  # as of a knob
            zero = away[int(np.argmax(reach))]
        if np.linalg.norm(zero) < 1e-9:
            zero = _across(axis)
        radius = np.clip(_OUTSIDE * reach.max(), _LEAST * diagonal, _MOST * diagonal)
        # Of an upright axis the upper end, where one looks onto the arc.
        upright = abs(axis[2]) > 0.5
        at = (along.max() if axis[2] > 0 else along.min()) if upright else along.mean()
        return cls(
            True, origin + float(at) * axis, axis, zero / np.linalg.norm(zero), float(radius)
        )

    def place(self, q: float) -> Array:
        """(3,) where a value, radians or metres, is."""
        if not self.rotates:
            return self.center + q * self.axis
        side = np.cross(self.axis, self.zero)
        return self.center + self.radius * (math.cos(q) * self.zero + math.sin(q) * side)

    def value(self, eye: Array, target: Array, near: float) -> float:
        """The value at which a ray points.

        Args:
            eye, target: (3,) two points of the ray.
            near: the value before: turns are counted from there, and seen edge-on it stays.
        """
        along = target - eye
        length = float(np.linalg.norm(along))
        if length < 1e-12:
            return near
        along = along / length
        if not self.rotates:
            return self._nearest_on_axis(eye, along, near)
        slope = float(along @ self.axis)
        if abs(slope) < _SLANTED:
            point = target  # on the plane of the screen through the grip
        else:
            point = eye + ((self.center - eye) @ self.axis / slope) * along
        away = point - self.center
        angle = math.atan2(away @ np.cross(self.axis, self.zero), away @ self.zero)
        return near + math.remainder(angle - near, math.tau)

    def _nearest_on_axis(self, eye: Array, along: Array, near: float) -> float:
        """Coordinate along the bar's line, metres from its centre, that is nearest to a ray."""
        cosine = float(along @ self.axis)
        if 1.0 - cosine * cosine < 1e-4:  # seen end-on
            return near
        away = self.center - eye
        return float((cosine * (away @ along) - away @ self.axis) / (1.0 - cosine * cosine))

    def line(self, low: float, high: float) -> npt.NDArray[np.float32]:
        """(N, 2, 3) segments of the arc or bar from one value to another."""
        count = max(2, math.ceil(abs(high - low) / _ARC_STEP) + 1) if self.rotates else 2
        path = np.array([self.place(q) for q in np.linspace(low, high, count)])
        return np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)

    def fan(
        self, low: float, high: float
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """(V, 3) vertices and (F, 3) faces of the sector between two values, at most one turn."""
        high = min(high, low + math.tau)
        path = self.line(low, high)
        rim = np.concatenate([path[:, 0], path[-1:, 1]])
        vertices = np.concatenate([self.center[None].astype(np.float32), rim])
        first = np.arange(1, len(rim), dtype=np.uint32)
        return vertices, np.stack([np.zeros_like(first), first, first + 1], axis=1)


def snapped(q: float, rotates: bool, *, coarse: bool) -> float:
    """``q`` in steps of 5° or 5 mm where ``coarse``, else as the fields show it."""
    step = (STEP if coarse else FINE)[rotates]
    return round(q / step) * step


def limits_with(joint: Joint, side: Side, q: float) -> tuple[float, float]:
    """The limits of a joint once one of them is ``q``: they don't pass each other."""
    assert joint.lower is not None and joint.upper is not None
    if side == "lower":
        return min(q, joint.upper), joint.upper
    return joint.lower, max(q, joint.lower)


def _across(axis: Array) -> Array:
    """(3,) a unit vector at right angles to ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = np.cross(helper, axis)
    return across / np.linalg.norm(across)


_ROOT: Final = "/limits"
_GRIP = 0.013
"""Radius of a grip, a share of the object's diagonal."""
_LINE_PIXELS = 3.0
_FAN_OPACITY = 0.16
_PAUSE = 0.25
"""Seconds after which a drag is over: where Shift is pressed or let go, viser ends it and begins
another one 0.1 s later."""
_SIDES: Final[tuple[Side, Side]] = ("lower", "upper")


class LimitHandles:
    """Two grips that the user drags; letting go of one sets that limit.

    Args:
        parent_pose: of a joint: (4, 4) posed_from_rest of its parent now.
        points: of a joint: (N, 3) of the part that it moves, at rest; None while it is unknown.
        preview: shows the part with other limits at a value, before they are decided; None ends it.

    Attributes:
        gauge: what is drawn, or None.
    """

    def __init__(
        self,
        tab: Tab,
        parent_pose: Callable[[Joint], Pose],
        points: Callable[[Joint], npt.NDArray[np.floating] | None],
        preview: Callable[[Joint | None, float], None],
    ) -> None:
        self._tab, self._parent_pose = tab, parent_pose
        self._points, self._preview = points, preview
        self._root: Any = None
        self._nodes: dict[str, Any] = {}
        self.gauge: LimitGauge | None = None
        self._key: Any = None
        self._grip: tuple[Side, Joint] | None = None
        self._drag: tuple[Side, Any] | None = None
        self._segments = 0

    def forget(self) -> None:
        """Note that the picture was cleared, and the handles with it."""
        self._root, self._nodes, self.gauge = None, {}, None
        self._key = self._grip = None

    def draw(self) -> None:
        """Bring the handles up to date; a grip that is dragged stays with the pointer."""
        selection = self._tab.selection
        obj, joint = selection.object, selection.joint
        wanted = None
        if obj is not None and obj.asset is not None and joint is not None and joint.limited:
            editable = obj.document.review.state != "accepted"
            if selection.step == "Joints" and editable:
                wanted = joint, self._points(joint), obj.asset.diagonal
        key = None if wanted is None or wanted[1] is None else (obj and obj.record.id, wanted[0])
        if key == self._key or self._grip is not None:
            return
        self._clear()
        self._key = key
        if wanted is not None and wanted[1] is not None:
            self._make(wanted[0], wanted[1], wanted[2])

    def _clear(self) -> None:
        if self._root is not None:
            self._root.remove()
        self.forget()

    def _make(self, joint: Joint, points: npt.NDArray[np.floating], diagonal: float) -> None:
        scene = self._tab.client.scene
        gauge = self.gauge = LimitGauge.of(joint, np.asarray(points, np.float64), diagonal)
        low, high = joint.lower or 0.0, joint.upper or 0.0
        position, wxyz = _place_of(self._parent_pose(joint))
        self._root = scene.add_frame(_ROOT, show_axes=False, position=position, wxyz=wxyz)
        self._nodes["line"] = scene.add_line_segments(
            f"{_ROOT}/line",
            gauge.line(low, high),
            palette.SELECTED,
            thickness=_LINE_PIXELS,
            thickness_units="screen",
        )
        if gauge.rotates:
            vertices, faces = gauge.fan(low, high)
            self._nodes["fan"] = scene.add_mesh_simple(
                f"{_ROOT}/fan",
                vertices,
                faces,
                color=palette.SELECTED,
                opacity=_FAN_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        for side, q in zip(_SIDES, (low, high), strict=True):
            place, radius = gauge.place(q), _GRIP * diagonal
            grip = add_ball(scene, f"{_ROOT}/{side}", place, radius, palette.SELECTED)
            self._nodes[side] = grip
            below = side == "lower"  # the labels of a small range don't cover each other
            self._nodes[f"{side} label"] = scene.add_label(
                f"{_ROOT}/{side}/label",
                limit_label(side, q, joint.rotates),
                position=(0.0, 0.0, (-1.6 if below else 1.6) * _GRIP * diagonal),
                anchor="top-center" if below else "bottom-center",
            )
            for modifier in (None, "shift"):
                grip.on_drag("left", modifier=modifier)(self._listener(side))

    def _listener(self, side: Side) -> Any:
        async def dragged(event: Any) -> None:  # async: viser keeps the order then
            if event.phase == "end":
                self._segments += 1
                ended = self._segments
                timer = threading.Timer(_PAUSE, lambda: self._tab.act(lambda: self._end(ended)))
                timer.daemon = True
                timer.start()
                return
            self._segments += event.phase == "start"
            waiting = self._drag is not None
            self._drag = side, event
            if not waiting:  # one action takes the newest place
                self._tab.act(self._follow)

        return dragged

    def _follow(self) -> None:
        """Bring the limit to where the pointer is."""
        newest, self._drag = self._drag, None
        joint, gauge = self._tab.selection.joint, self.gauge
        if newest is None or joint is None or gauge is None or not joint.limited:
            return
        side, event = newest
        held = joint if self._grip is None or self._grip[0] != side else self._grip[1]
        if held.child != joint.child:
            return
        rest = np.linalg.inv(self._parent_pose(joint))
        eye = np.asarray(self._tab.client.camera.position, np.float64)
        eye, target = (
            rest[:3, :3] @ p + rest[:3, 3] for p in (eye, np.asarray(event.end_position))
        )
        before = (held.lower if side == "lower" else held.upper) or 0.0
        q = gauge.value(eye, target, before)
        q = snapped(q, joint.rotates, coarse=event.modifier == "shift")
        if joint.rotates:
            q = min(max(q, -math.tau), math.tau)
        lower, upper = limits_with(joint, side, q)
        changed = replace(joint, lower=lower, upper=upper)
        self._grip = side, changed
        self._show(changed, side)

    def _show(self, joint: Joint, side: Side) -> None:
        """Draw the gauge and the part as they would be."""
        gauge = self.gauge
        assert gauge is not None and joint.lower is not None and joint.upper is not None
        q = joint.lower if side == "lower" else joint.upper
        with self._tab.selection.lock, self._tab.client.atomic():
            self._nodes["line"].points = gauge.line(joint.lower, joint.upper)
            self._nodes[side].position = gauge.place(q)
            self._nodes[f"{side} label"].text = limit_label(side, q, joint.rotates)
            if "fan" in self._nodes:
                self._nodes["fan"].visible = False  # as large as it is then, once let go
        self._preview(joint, q)

    def _end(self, segment: int) -> None:
        """Decide on the limit, unless the drag goes on."""
        if segment != self._segments or self._grip is None:
            return
        (_, changed), joint = self._grip, self._tab.selection.joint
        self._grip = self._key = None  # drawn again, also where this is refused
        try:
            if joint is not None and joint.child == changed.child and joint != changed:
                self._tab.do(cmd.SetJoint(changed))
        finally:
            self._preview(None, 0.0)
            self._tab.invalidate()

    def place(self, poses: Mapping[str, Pose]) -> None:
        """Move the handles with the joint's parent."""
        joint = self._tab.selection.joint
        if self._root is None or joint is None or joint.parent not in poses:
            return
        position, wxyz = _place_of(poses[joint.parent])
        if not np.allclose(position, self._root.position, atol=1e-9):
            self._root.position = position
        if not np.allclose(wxyz, self._root.wxyz, atol=1e-9):
            self._root.wxyz = wxyz


def _place_of(pose: Pose) -> tuple[Any, Any]:
    """Position, and rotation as wxyz."""
    return pose[:3, 3], vtf.SO3.from_matrix(pose[:3, :3]).wxyz
