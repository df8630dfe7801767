"""Brings the picture of the open object up to date with its state: the object, preparation of a
scan and light in the surface; with the light of a tab and its theme.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.display_tasks import LitMesh, OpenedAsset, lit_mesh
from app.server.jobs import Job
from app.server.names import moved_part
from app.server.open_object import OpenObject
from app.server.page import call_page
from app.viewer.panels.widgets import Presses
from app.viewer.picture import palette
from app.viewer.picture.marks import AxisMark, axis_length
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import GRID, LIGHT_ROOT, SCENE_ROOT, set_backdrop
from app.viewer.tab import AT_REST, Tab
from app.viewer.words import common as words
from app.viewer.words import keys
from model.core.joint import Joint
from model.segmentation.prompts import Click
from sessions.document import Document

_PRIORITY: Final = -1
"""After all that a person waits for."""
_EDGE_COLOR: Final = (38, 42, 48)
_EDGE_PIXELS: Final = 1.2


class SurfaceDetail:
    """Surface detail of the open object in one tab; workers compute it after the first drawing.

    Attributes:
        edges_on: whether edges are drawn.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture) -> None:
        self._tab, self._picture = tab, picture
        self.edges_on = True
        self._asset: OpenedAsset | None = None
        self._lit: LitMesh | None = None
        self._shown = False
        self._key: Any = None

    @property
    def lit(self) -> bool:
        """True if the light in the surface is drawn."""
        return self._shown

    def draw(self, obj: OpenObject, moving: bool) -> None:
        """Bring light and edges up to date."""
        asset = obj.asset
        if asset is not self._asset:
            self._asset, self._lit, self._shown, self._key = asset, None, False, None
            if asset is not None and asset.glb is not None:
                job = obj.lane.geometry.submit(lit_mesh, asset.folder, priority=_PRIORITY)
                job.add_done_callback(lambda done: self._done(done, asset))
        if self._lit is None:
            return
        if not self._shown:
            self._shown = True
            self._picture.show_lit(self._lit.glb, self._lit.glb_order)
        self._draw_edges(obj, self._lit, moving)

    def _done(self, job: Job[LitMesh | None], asset: OpenedAsset) -> None:
        if job.error is None:  # without it, the picture stays as it is
            self._tab.act(lambda: self._take(job.result(0), asset))

    def _take(self, lit: LitMesh | None, asset: OpenedAsset) -> None:
        if asset is self._asset:
            self._lit = lit
            self._tab.invalidate()

    def _draw_edges(self, obj: OpenObject, lit: LitMesh, moving: bool) -> None:
        hidden, labels = self._tab.selection.hidden, obj.labels
        key = (self.edges_on, moving, hidden, id(labels), id(self._picture.parts.payloads))
        if key == self._key:
            return
        self._key = key
        scene, edges = self._tab.client.scene, lit.edges
        of_edge = None if labels is None else labels[edges.face]
        shown = np.full(len(edges.face), self.edges_on)
        if of_edge is not None:
            shown &= ~np.isin(of_edge, list(hidden))
        names: dict[str, Any] = {"/edges": shown & (not moving)}
        for part in self._picture.parts.drawn:
            mine = shown & moving if of_edge is None else shown & moving & (of_edge == part)
            names[f"/part/{part}/edges"] = mine
        with self._tab.client.atomic():
            for name, which in names.items():
                if which.any():
                    scene.add_line_segments(
                        name,
                        edges.points[which],
                        _EDGE_COLOR,
                        thickness=_EDGE_PIXELS,
                        thickness_units="screen",
                    )
                elif scene.get_handle_by_name(name) is not None:
                    scene.remove_by_name(name)


PLAIN = "plain"
"""Stored in the browser where there are no reflections."""
_ABOVE, _BESIDE = (0.0, 0.0, 1.0), (-2.0, -3.0, 2.0)
"""From where sky and lamp shine on the origin."""


class LightSwitch:
    """Checkboxes for the light of one tab and for edges."""

    def __init__(self, tab: Tab, detail: SurfaceDetail, remember: Callable[[], None]) -> None:
        """Make the checkboxes; ``remember`` is called once the light was switched."""
        self._tab, self._remember = tab, remember
        self._lamps: list[viser.SceneNodeHandle] = []
        self._box = tab.client.gui.add_checkbox(
            words.SIMPLE_LIGHT,
            False,
            hint=words.SIMPLE_LIGHT_HINT,
        )
        self._box.on_update(lambda _: tab.act(self._switched))
        self._edges = tab.client.gui.add_checkbox(keys.EDGES, True, hint=keys.EDGES_HINT)
        tab.on_update(self._edges, lambda: self._show_edges(detail))

    @property
    def plain(self) -> bool:
        """True if there are no reflections."""
        return self._box.value

    @plain.setter
    def plain(self, plain: bool) -> None:
        self._box.value = plain  # this triggers the same callback as a click

    def _switched(self) -> None:
        self._light(self.plain)
        self._remember()

    def _show_edges(self, detail: SurfaceDetail) -> None:
        detail.edges_on = self._edges.value
        self._tab.invalidate()

    def _light(self, plain: bool) -> None:
        """Plainly, or by viser's own map of surroundings.

        Looking up surroundings takes most of a frame's time where a processor draws it.
        """
        scene = self._tab.client.scene
        for lamp in self._lamps:
            lamp.remove()
        self._lamps = []
        scene.configure_environment_map(None if plain else "warehouse")
        if plain:
            self._lamps = [
                scene.add_light_hemisphere(
                    f"{LIGHT_ROOT}/sky",
                    ground_color=(190, 180, 170),
                    intensity=1.9,
                    position=_ABOVE,
                ),
                scene.add_light_directional(
                    f"{LIGHT_ROOT}/lamp", color=(255, 250, 244), intensity=0.9, position=_BESIDE
                ),
            ]


class Theme:
    """Light or dark, as the browser's system has it, and how scans are colored."""

    def __init__(
        self, tab: Tab, presses: Presses, pictures: tuple[ObjectPicture, *tuple[ScenePicture, ...]]
    ) -> None:
        self._tab, self._pictures = tab, pictures
        self._set("light")
        presses.on("theme", self._set)
        presses.on("colors", self._color)
        call_page(tab.client, "Markup.theme")  # it answers, and again when it changes

    def _set(self, theme: str) -> None:
        dark = theme == "dark"
        self._tab.client.gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=dark
        )
        scene = self._tab.client.scene
        set_backdrop(scene, dark=dark)
        for picture in self._pictures:
            picture.dark = dark
        for name in ("/ground", f"{SCENE_ROOT}/ground"):
            floor: Any = scene.get_handle_by_name(name)
            if floor is not None:
                floor.cell_color, floor.section_color = GRID[dark]

    def _color(self, kind: str) -> None:
        self._pictures[0].plain = kind == "parts"
        self._tab.invalidate()


Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
_DOT = 0.0015
"""Size of removed points, in diagonals: small enough to look through."""
_CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], float)
_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


class PrepareMarks:
    """Marks in one tab's scene.

    Args:
        turned: gets the (3, 3) rotation, in the asset's frame, at which the handle was let go.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture, turned: Callable[[Array], None]) -> None:
        self._tab, self._picture, self._turned = tab, picture, turned
        self._drawn: tuple[Any, ...] = ()
        self._removed: Any = None
        self._box: Any = None
        self._handle: Any = None

    def forget(self) -> None:
        """Note that the picture was cleared, and the marks with it."""
        self._drawn, self._removed, self._box, self._handle = (), None, None, None

    def draw(
        self, box: Box | None, frame: Array | None = None, *, removed: bool, handle: bool
    ) -> None:
        """Show the crop box and the other marks that are requested.

        Args:
            box: in a frame, (4, 4) from the asset's.
        """
        obj = self._tab.selection.object
        asset = None if obj is None else obj.asset
        frame = np.eye(4) if frame is None else frame
        now = (id(asset), box, removed, handle, frame.tobytes())
        if asset is None or now == self._drawn:
            return
        self._drawn = now
        for old in (self._removed, self._box, self._handle):
            if old is not None:
                old.remove()
        self.forget()
        self._drawn = now
        scene, turn = self._tab.client.scene, np.linalg.inv(frame)
        if removed and asset.removed is not None:
            self._removed = scene.add_point_cloud(
                "/removed",
                asset.removed,
                palette.MARKED,
                point_size=_DOT * asset.diagonal,
                point_shape="circle",
                precision="float32",
            )
        if box is not None:
            low, high = np.array(box)
            corners = (low + _CORNERS * (high - low)) @ turn[:3, :3].T + turn[:3, 3]
            self._box = scene.add_line_segments(
                "/crop",
                corners[_EDGES].astype(np.float32),
                palette.SELECTED,
                thickness=2.0,
                thickness_units="screen",
            )
        if handle:
            self._add_handle(asset, self._picture.shown_upright[:3, :3].T)

    def _add_handle(self, asset: Any, rotation: Array) -> None:
        middle = np.median(asset.display_centers, axis=0)
        start = vtf.SO3.from_matrix(rotation)
        self._handle = handle = self._tab.client.scene.add_transform_controls(
            "/turn",
            scale=0.35 * asset.diagonal,
            position=middle,
            wxyz=start.wxyz,
            disable_axes=True,
            disable_sliders=True,
            depth_test=False,
        )

        @handle.on_update
        def _(event: Any) -> None:
            turn = vtf.SO3(np.asarray(handle.wxyz)) @ start.inverse()
            scan = self._picture.scan
            if event.phase == "end":
                self._tab.act(lambda: self._turned(np.asarray(turn.as_matrix(), np.float64)))
            elif scan is not None:
                scan.wxyz = turn.wxyz
                scan.position = middle - turn.as_matrix() @ middle


class ObjectDrawing:
    """Sends to one tab what changed of the open object.

    Args:
        shown: gets, once another asset was sent, whether it lies where the last one did.
        tapped: gets what a finger taps.

    Attributes:
        detail: light and edges of objects without a texture.
    """

    def __init__(
        self,
        tab: Tab,
        picture: ObjectPicture,
        motion: Motion,
        shown: Callable[[bool], None],
        tapped: Callable[[Any], None],
    ) -> None:
        self._tab, self._picture, self._motion = tab, picture, motion
        self._shown, self._tapped = shown, tapped
        self.detail = SurfaceDetail(tab, picture)
        self._asset: Any = None
        self._id: int | None = None
        tab.selection.on_open(self._forget)

    def _forget(self) -> None:
        self._asset = None

    @property
    def drawn(self) -> bool:
        """True if the open object's picture was sent."""
        obj = self._tab.selection.object
        return obj is not None and self._asset is obj.asset is not None

    @property
    def shows_labels(self) -> bool:
        """True if the newest labels were sent."""
        obj = self._tab.selection.object
        return obj is not None and self._picture.labels is obj.labels

    def draw(self, obj: OpenObject, *, touch: bool) -> None:
        """Send what changed; ``touch`` where taps are clicks."""
        if obj.asset is not None and obj.asset is not self._asset:
            before = self._asset if self._id == obj.record.id else None
            stays = before is not None and np.array_equal(before.bounds, obj.asset.bounds)
            self._picture.show_asset(obj.asset, keep_view=stays)
            self._id, self._asset = obj.record.id, obj.asset
            self._motion.forget()
            self._shown(stays)
        elif self._id and obj.asset is None and (obj.problem or self._id != obj.record.id):
            self.clear()  # else it is read again, with new faces
        if obj.asset is not None:
            self._draw(obj, obj.document, touch)

    def leave(self) -> None:
        """Clear the picture where it is of another object than the open one."""
        obj = self._tab.selection.object
        if obj is not None and self._id != obj.record.id:
            self.clear()

    def clear(self) -> None:
        """Clear the picture: it is of another object, or of a file that can't be read now."""
        if self._id is not None:
            self._picture.clear()
            self._asset = self._id = None
            self._motion.forget()

    def _draw(self, obj: OpenObject, doc: Document, touch: bool) -> None:
        selection, picture = self._tab.selection, self._picture
        assert obj.asset is not None
        moving = selection.step not in AT_REST and doc.tree is not None
        payloads = obj.part_payloads() if moving else None
        selection.hidden &= {p.id for p in doc.parts}  # a new part of the same number is seen
        picture.show_labels(obj.labels, selection.hidden)
        clicks = [
            (i, p)
            for i, p in enumerate(doc.prompts)
            if isinstance(p, Click) and p.part not in selection.hidden
        ]
        picture.show_prompts(clicks, visible=selection.step == "Annotate")
        picture.show_parts(payloads, moving, selection.hidden)
        self.detail.draw(obj, moving and payloads is not None)
        picture.marks.show_axes(self._axis_marks(obj, doc) if moving else ())
        choosing = moving and selection.step == "Joints"
        picture.marks.show_directions(obj.asset.bounds[0] if choosing else None)
        picture.marks.show_contacts(obj.checks, doc.tree if moving else None)
        self._motion.pose()
        self._motion.handles.draw()
        self._motion.limits.draw()
        pad = picture.touch
        new = picture.show_touch_pad(touch)
        if new is not None and new is not pad:
            new.on_click(self._tapped)

    def _axis_marks(self, obj: OpenObject, doc: Document) -> list[AxisMark]:
        assert doc.tree is not None and obj.asset is not None
        payloads, marks, selection = obj.part_payloads(), [], self._tab.selection
        hidden = {f"link_{part}" for part in selection.hidden}
        for joint in doc.tree.joints:
            chosen = joint.child == selection.child
            moved = moved_part(doc.tree, joint.child)
            if not joint.moves or (moved in hidden and not chosen):
                continue
            length = axis_length(payloads, moved, joint.axis, obj.asset.diagonal)
            color = palette.SELECTED if chosen else palette.link_color(moved)
            marks.append(_mark(joint.name, joint, length, color, chosen))
            likely = doc.likely_joints(joint) if chosen and selection.step == "Joints" else ()
            if len(likely) > 1 and doc.review.state != "accepted":
                for rank, other in enumerate(likely, 1):
                    if other.moves and _axis_differs(other, joint):
                        mark = _mark(f"likely-{rank}", other, length, palette.GHOST, False)
                        marks.append(replace(mark, label=str(rank)))
                continue
            predicted = None if doc.prediction is None else doc.prediction.joint(joint.child)
            if predicted is not None and predicted.moves and _axis_differs(predicted, joint):
                marks.append(_mark(f"ghost-{joint.name}", predicted, length, palette.GHOST, False))
        return marks


def _mark(key: str, joint: Joint, length: float, color: palette.Rgb, thick: bool) -> AxisMark:
    return AxisMark(key, joint.parent, joint.origin, joint.axis, length, color, thick)


def _axis_differs(a: Joint, b: Joint) -> bool:
    off = np.abs(np.subtract(a.origin, b.origin)).max() > 1e-9
    return bool(off or np.abs(np.subtract(a.axis, b.axis)).max() > 1e-9)
