"""Moving joints: sliders, animation, and the handles for a joint's axis."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.viewer.picture.animation import Animation
from model.core.joint import Joint
from model.validation.report import Finding

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp


class Motion:
    """What moves in one tab, and how far.

    Attributes:
        q: joint name → radians or metres; a joint that isn't in it rests.
        gizmo_on: whether the chosen joint's axis has handles.
    """

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self.q: dict[str, float] = {}
        self.gizmo_on = False
        self._gizmo: Any = None
        self._gizmo_key: Any = None
        self._gizmo_held = False
        self._moment: dict[str, float] | None = None
        self._animation = Animation(self._animate)

    def begin(self) -> None:
        """Another object: everything rests."""
        self.stop()
        self.q, self.gizmo_on = {}, False

    def stop(self) -> None:
        """End the animation where it is."""
        self._animation.stop()

    def forget_scene(self) -> None:
        """The scene was cleared, and the handles and marks with it."""
        self._gizmo_held = False
        self._gizmo, self._gizmo_key, self._moment = None, None, None

    def set_q(self, name: str, value: float) -> None:
        """Move one joint; radians or metres."""
        if abs(self.q.get(name, 0.0) - value) > 1e-9:
            self.q[name] = value
            self.pose()

    def _animate(self, q: dict[str, float]) -> None:
        self.q.update(q)
        self.pose()
        self._app.joints_panel.show_q(self.q)

    def reset(self) -> None:
        """All joints back to the scanned pose."""
        self.stop()
        self.q = {}
        self._app.joints_panel.show_q({})
        self.pose()

    def play(self, name: str | None = None) -> None:
        """Start or stop moving one joint, or all of them."""
        app = self._app
        tree = app.need_object().document.tree
        if tree is None:
            app.notify("No joints yet", "Predict them first (P)", "gray")
            return
        if app.stage == "Annotate":
            app.set_stage("Joints")
        chosen = [j for j in tree.joints if j.moves and j.mimic is None]
        self._animation.toggle([j for j in chosen if name in (None, j.name)], self.q)

    def pose(self) -> None:
        """Draw the links where ``q`` has them."""
        app = self._app
        tree = app.object.document.tree if app.object is not None else None
        if tree is None:
            return
        names = tree.by_name
        if self._moment is not None and self.q != self._moment:
            self.clear_moment()
        poses = tree.pose({k: v for k, v in self.q.items() if k in names})
        with app.client.atomic():
            app.scene.parts.pose(poses)
            app.scene.marks.pose(poses)
            self._place_gizmo(poses)

    def show_moment(self, moment: Finding | None, text: str) -> None:
        """Pose everything as at a moment, and mark it until the pose changes; None is rest."""
        app = self._app
        self.reset()
        self.clear_moment()
        if moment is None:
            return
        tree = app.need_object().document.tree
        names = {} if tree is None else tree.by_name
        self.q = {k: v for k, v in moment.q.items() if k in names}
        app.joints_panel.show_q(self.q)
        self.pose()
        app.scene.marks.show_moment(moment.where, text)
        self._moment = dict(self.q)

    def clear_moment(self) -> None:
        """Take the mark of a moment away."""
        if self._moment is not None:
            self._moment = None
            self._app.scene.marks.show_moment(None, "")

    # --- handles

    def toggle_gizmo(self) -> None:
        """Show or hide the handles for the chosen joint's axis."""
        app = self._app
        if app.joint is None or not app.joint.moves:
            app.notify("Choose a joint first", "Tab chooses the next one", "gray")
            return
        self.gizmo_on = not self.gizmo_on
        if self.gizmo_on:
            self.reset()
            app.set_stage("Joints")
        app.invalidate()

    def draw_gizmo(self) -> None:
        """Bring the handles up to date."""
        app = self._app
        joint = app.joint
        wanted = joint if self.gizmo_on and joint is not None and joint.moves else None
        key = None if wanted is None else (wanted.child, wanted.parent, wanted.origin, wanted.axis)
        if key == self._gizmo_key:
            return
        self._gizmo_key, self._gizmo_held = key, False
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        if wanted is None or app.object is None or app.object.asset is None:
            return
        position, wxyz = _posed(wanted, self._parent_pose(wanted))
        self._gizmo = app.client.scene.add_transform_controls(
            "/gizmo",
            scale=0.22 * app.object.asset.diagonal,
            position=position,
            wxyz=wxyz,
            depth_test=False,
        )

        @self._gizmo.on_update
        def _(event: Any) -> None:
            if event.phase == "start":
                self._gizmo_held = True
                app.act(self.stop)
            elif event.phase == "end":
                app.act(self.take_gizmo)

    def _parent_pose(self, joint: Joint) -> npt.NDArray[np.float64]:
        """(4, 4) posed_from_rest of what carries a joint, as it is now."""
        tree = None if self._app.object is None else self._app.object.document.tree
        if tree is None or joint.parent not in tree.links:
            return np.eye(4)
        names = tree.by_name
        return tree.pose({k: v for k, v in self.q.items() if k in names})[joint.parent]

    def _place_gizmo(self, poses: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """The handles go with what carries the joint, unless a person holds them."""
        joint = self._app.joint
        if self._gizmo is None or joint is None or self._gizmo_held or joint.parent not in poses:
            return
        position, wxyz = _posed(joint, poses[joint.parent])
        if not np.allclose(position, self._gizmo.position, atol=1e-9):
            self._gizmo.position = position
        if not np.allclose(wxyz, self._gizmo.wxyz, atol=1e-9):
            self._gizmo.wxyz = wxyz

    def take_gizmo(self) -> None:
        """The handles were let go: their place is the joint's new axis."""
        self._gizmo_held = False
        gizmo, joint = self._gizmo, self._app.joint
        if gizmo is None or joint is None:
            return
        self._gizmo_key = None  # drawn again where the joint is now, also if this is refused
        rest = np.linalg.inv(self._parent_pose(joint))
        axis = rest[:3, :3] @ vtf.SO3(np.asarray(gizmo.wxyz)).as_matrix()[:, 2]
        origin = rest[:3, :3] @ np.asarray(gizmo.position, np.float64) + rest[:3, 3]
        self._app.set_joint(
            dataclasses.replace(
                joint,
                origin=tuple(float(v) for v in origin),
                axis=tuple(float(v) for v in axis),
            )
        )


def _posed(joint: Joint, posed_from_rest: npt.NDArray[np.float64]) -> tuple[Any, Any]:
    """Where a joint's axis is: its place, and a rotation, wxyz, whose z is the axis."""
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
