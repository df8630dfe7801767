"""Handles in 3D for the limits of the selected joint: an arc or a bar with a grip at each end."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.viewer.picture import palette
from app.viewer.picture.limit_gauge import LimitGauge, Side, limits_with, snapped
from app.viewer.tab import Tab
from app.viewer.words.joints import limit_label
from model.core.joint import Joint
from sessions import commands as cmd

Pose = npt.NDArray[np.float64]
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
            f"{_ROOT}/line", gauge.line(low, high), palette.SELECTED, thickness=_LINE_PIXELS,
            thickness_units="screen",
        )  # fmt: skip
        if gauge.rotates:
            vertices, faces = gauge.fan(low, high)
            self._nodes["fan"] = scene.add_mesh_simple(
                f"{_ROOT}/fan", vertices, faces, color=palette.SELECTED, opacity=_FAN_OPACITY,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        for side, q in zip(_SIDES, (low, high), strict=True):
            grip = scene.add_icosphere(
                f"{_ROOT}/{side}", radius=_GRIP * diagonal, color=palette.SELECTED,
                subdivisions=2, position=gauge.place(q), cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
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
        with self._tab.client.atomic():
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
