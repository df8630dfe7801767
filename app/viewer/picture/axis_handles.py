"""Handles in 3D for the axis of the selected joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.viewer.tab import Step, Tab
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
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return vtf.SO3.from_matrix(np.column_stack([x, np.cross(z, x), z])).wxyz
