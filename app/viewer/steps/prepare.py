"""The step before annotating: level, size and clean a scan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.server.display_tasks import OpenedAsset
from app.server.open_object import OpenObject
from app.server.prepare_tasks import Marks, ScanProposal
from app.server.preparing import CLUTTERING, UPRIGHT, odd_unit, untouched
from app.viewer.input.pointing import Pointing
from app.viewer.panels.widgets import put
from app.viewer.picture.drawing import PrepareMarks
from app.viewer.picture.object_picture import ObjectPicture, View
from app.viewer.picture.stage import may_be_a_room
from app.viewer.tab import Step, Tab, path_with_tooltip, plain
from app.viewer.words import prepare as words
from app.viewer.words.common import warning
from model.core.errors import CommandError
from model.geometry.prepare import standing
from model.geometry.units import UNITS, OddSize, odd_size, unusual_height
from sessions import commands as cmd
from sessions.document import Document

Array = npt.NDArray[np.float64]
_VIEWS: dict[str, View] = dict(zip(words.VIEW_ACTIONS, ("front", "side", "top"), strict=True))  # type: ignore[arg-type]
_LEVEL_KEYS = {words.LEVEL_ACTIONS[1]: "floor", words.LEVEL_ACTIONS[2]: "edge"}


class PrepareStep:
    """Controls of the prepare step.

    Attributes:
        noticed: whether the open object needs preparing.
    """

    def __init__(self, tab: Tab, pointing: Pointing, picture: ObjectPicture) -> None:
        self._tab, self._pointing, self._picture = tab, pointing, picture
        self._marks = PrepareMarks(tab, picture, self._handle_released)
        self._handle = False
        self._length: float | None = None
        self._typed = False  # a size that nothing has taken yet
        self._waits = False  # to apply what is still being found
        self._shown_for: Any = None
        self._marked_for: Any = None
        self._switched: Any = None
        self._build()
        tab.selection.on_open(self._forget)
        tab.selection.on_step(self._step_begins)

    def _build(self) -> None:
        tab, gui, act = self._tab, self._tab.client.gui, self._tab.act
        self._hint = gui.add_markdown("")
        self._apply = gui.add_button(words.APPLY, color="blue")
        self._view = gui.add_button_group(words.VIEW, words.VIEW_ACTIONS, hint=words.VIEW_HINT)
        level = gui.add_button_group(words.LEVEL, words.LEVEL_ACTIONS, hint=words.LEVEL_HINT)
        rotate = gui.add_button_group(words.ROTATE, words.ROTATE_ACTIONS, hint=words.ROTATE_HINT)
        self._unit = gui.add_dropdown(words.UNIT, tuple(UNITS))
        self._size = gui.add_number(words.HEIGHT, 1.0, min=0.001, step=0.001)
        self._scale = gui.add_button_group(
            words.SCALE, words.SCALE_ACTIONS, hint=words.MEASURE_HINT
        )
        self._usual = gui.add_button("", color="gray", visible=False)
        self._kinds = {
            k: gui.add_checkbox(words.KINDS[k], True, hint=words.KINDS_HINT) for k in CLUTTERING
        }
        self._confidence = gui.add_slider(words.CONFIDENCE, 0.0, 1.0, 0.01, 0.0, visible=False)
        self._crop = gui.add_checkbox(words.CROP, False)
        self._sides = [
            gui.add_multi_slider(name, 0.0, 100.0, 0.5, (0.0, 100.0), visible=False)
            for name in words.CROP_AXES
        ]
        clean = gui.add_button_group(words.REMOVE, words.REMOVE_ACTIONS, hint=words.REMOVE_HINT)
        self._note = gui.add_markdown("")
        self._apply.on_click(lambda _: act(self.apply))
        self._view.on_click(lambda e: act(lambda: self.look(_VIEWS[e.target.value])))
        level.on_click(lambda e: act(lambda: self._level(e.target.value)))
        rotate.on_click(lambda e: act(lambda: self.rotate(e.target.value)))
        self._scale.on_click(lambda e: act(lambda: self._scale_clicked(e.target.value)))
        self._usual.on_click(lambda _: act(self._use_usual))
        clean.on_click(lambda e: act(lambda: self._clean(e.target.value)))
        tab.on_update(self._unit, self._unit_chosen)
        tab.on_update(self._size, self._size_typed)
        for widget in (*self._kinds.values(), self._confidence, self._crop, *self._sides):
            tab.on_update(widget, tab.invalidate)

    # --- the open object

    def _forget(self) -> None:
        """Another object is opened."""
        self._handle, self._length, self._switched = False, None, None
        self._typed = self._waits = False
        self._marked_for = None

    def _reset_marks(self, raw: bool = False) -> None:
        """Mark nothing, or in a raw scan what isn't the object."""
        self._confidence.value, self._crop.value = 0.0, False
        for box in self._kinds.values():
            put(box, value=raw)
        for side in self._sides:
            side.value = (0.0, 100.0)

    def _step_begins(self, step: Step) -> None:
        if step != "Prepare":
            self._handle = False

    def asset_shown(self) -> None:
        """Note that the picture was drawn anew."""
        self._marks.forget()
        self._handle, self._length, self._typed = False, None, False

    def noticed(self, obj: OpenObject) -> bool:
        """True if the object needs preparing, as far as is known."""
        asset, preparing = obj.asset, obj.preparing
        if self._tab.in_scene or asset is None or not untouched(obj.document):
            return False
        if obj.document.left_out is not None:
            return False
        odd = _odd_size(obj)
        kinds = {} if may_be_a_room(asset.bounds) else preparing.noticed()
        return bool(preparing.tilt or preparing.doubtful or kinds or odd)

    def show_if_tilted(self, obj: OpenObject) -> None:
        """Show the step at once for a scan that is tilted, unless it is being worked on."""
        tilted = obj.preparing.tilt and self.noticed(obj)
        selection = self._tab.selection
        if not tilted or self._switched == obj.record.id or obj.state.seq:
            return
        self._switched = obj.record.id
        if selection.step == "Annotate" and not selection.picking:
            selection.set_step("Prepare")

    def notice(self, obj: OpenObject) -> str | None:
        """Notice for the annotate step; None if nothing needs preparing."""
        if not self.noticed(obj):
            return None
        odd = _odd_size(obj)
        lines = [words.bold(odd.question)] if odd else []
        kinds = obj.preparing.noticed()
        lines += [*self._orientation(obj), *([words.also(kinds)] if kinds else [])]
        return " ".join(lines)

    def _orientation(self, obj: OpenObject) -> list[str]:
        """Notice about the scan's orientation, unless it is upright."""
        found, preparing = obj.preparing.current, obj.preparing
        if found is not None and preparing.tilt:
            level = found.levelling
            return [words.tilted(level.tilt, level.up, level.confidence)]
        return [words.DOUBTFUL] if preparing.doubtful else []

    # --- what is offered

    def _frame(self, obj: OpenObject) -> Array:
        """(4, 4) the frame that Enter gives the object, in its present one."""
        found = obj.preparing.current
        frame = None if found is None else obj.preparing.frame(self._chosen(found))
        return np.eye(4) if frame is None else frame

    def _chosen(self, found: ScanProposal) -> tuple[int, ...]:
        return tuple(k for k in CLUTTERING if found.counts[k] and self._kinds[k].value)

    def _marked(self, obj: OpenObject) -> Marks:
        found = obj.preparing.current
        if found is None:
            return Marks()
        box = None
        if self._crop.value:
            low, high = self._bounds(obj.need_asset(), found)
            share = np.array([s.value for s in self._sides]).T / 100
            corners = low + share * (high - low)
            box = (tuple(corners[0].tolist()), tuple(corners[1].tolist()))
        return Marks(self._chosen(found), box, float(self._confidence.value))

    def _bounds(self, asset: OpenedAsset, found: ScanProposal) -> Array:
        """(2, 3) of all that is drawn, in the proposed frame."""
        turned = _moved(asset.display_centers, found.object_from_asset)
        return np.stack([turned.min(0), turned.max(0)]) + [[-1e-6], [1e-6]]

    # --- decisions

    def apply(self) -> None:
        """Level and clean as shown, then annotate; where nothing is offered, just go there."""
        tab = self._tab
        obj = tab.selection.need_object()
        if not self._waits and _searching(obj):
            self._waits = True  # a second time goes on without it
            tab.say(words.APPLIED_WHEN_FOUND)
            return
        self._waits = False
        metres = odd_unit(obj.need_asset())
        frame, marks, size = self._frame(obj), self._marked(obj), ""
        if self._typed:
            ratio, size = self._asked_size(obj)
            frame, metres, self._typed = np.diag([ratio, ratio, ratio, 1.0]) @ frame, None, False

        def done() -> None:
            tab.act(lambda: tab.selection.set_step("Annotate"))

        if np.array_equal(frame, np.eye(4)) and marks == Marks() and metres is None:
            done()
        else:
            self._prepare(obj, frame, marks, done, metres, size)

    def remove_marked(self) -> None:
        """Remove what is grey; the object stays as it lies."""
        obj = self._tab.selection.need_object()
        marks = self._marked(obj)
        if marks == Marks():
            self._tab.notify(words.NOTHING_MARKED, "", "gray")
        else:
            self._prepare(obj, np.eye(4), marks, lambda: None)

    def _prepare(
        self,
        obj: OpenObject,
        frame: Array,
        marks: Marks,
        done: Callable[[], None],
        metres: float | None = None,
        size: str = "",
    ) -> None:
        found = obj.preparing.current
        still = found is None or np.array_equal(frame, np.diag(frame.diagonal()))
        tilt = 0.0 if still or found is None else found.levelling.tilt
        more = marks.box is not None or marks.confidence > 0
        text = words.applied(tilt, marks.kinds, more, size)
        obj.preparing.apply(frame, marks, text, self._tab.user, done, metres=metres)

    def _clean(self, action: str) -> None:
        if action == words.REMOVE_ACTIONS[0]:
            self.remove_marked()
        elif action == words.REMOVE_ACTIONS[3]:
            self._tab.do(cmd.LeaveOut(None))
        else:
            self._pointing.set_tool("lasso" if action == words.REMOVE_ACTIONS[1] else "brush")

    def look(self, view: View) -> None:
        """Look from the front, the side or above."""
        self._picture.frame_camera(view)

    def _level(self, action: str) -> None:
        if action == words.LEVEL_ACTIONS[0]:
            self._tab.selection.need_object().preparing.propose(anew=True)
        elif action == words.LEVEL_ACTIONS[3]:
            self.toggle_handle()
        else:
            self._pointing.arm(_LEVEL_KEYS[action])  # type: ignore[arg-type]

    def toggle_handle(self) -> None:
        """Show or hide the rotation handle."""
        self._handle = not self._handle
        self._tab.invalidate()

    def next_up(self, step: int) -> None:
        """Propose the next likely up direction, or with -1 the one before."""
        self._tab.selection.need_object().preparing.next_up(step)

    def rotate(self, about: str = words.ROTATE_ACTIONS[3], degrees: float = 90.0) -> None:
        """Rotate what is shown by a quarter turn about an axis, or about the view's direction."""
        shown = self._picture.shown_upright
        axis = words.ROTATE_ACTIONS.index(about)
        if axis < 3:
            vector = np.eye(3)[axis]
        else:
            camera = self._tab.client.camera
            toward = shown[:3, :3] @ (np.asarray(camera.position) - np.asarray(camera.look_at))
            axis = int(np.abs(toward).argmax())
            vector = np.eye(3)[axis] * np.sign(toward[axis])
        turn = vtf.SO3.exp(np.radians(degrees) * vector).as_matrix()
        self._turn(turn @ shown[:3, :3], words.rotated("XYZ"[axis]))

    def flip(self) -> None:
        """Turn what is shown upside down."""
        shown = self._picture.shown_upright
        self._turn(np.diag([1.0, -1.0, -1.0]) @ shown[:3, :3], words.FLIPPED)

    def _handle_released(self, turn: Array) -> None:
        self._turn(self._picture.shown_upright[:3, :3] @ turn, words.TURNED)

    def _turn(self, rotation: Array, what: str) -> None:
        """Give the object a (3, 3) rotation, in its present frame."""
        obj = self._tab.selection.need_object()
        frame = standing(obj.need_asset().display_centers.astype(np.float64), rotation)
        obj.preparing.turn(frame, what, self._tab.user)

    def places_chosen(self, kind: str, places: tuple[tuple[float, float, float], ...]) -> None:
        """Three clicks on the floor, two on an upright edge, or two ends of a length."""
        preparing = self._tab.selection.need_object().preparing
        points = np.array(places)
        if kind == "length":
            self._length = float(np.linalg.norm(points[1] - points[0]))
            self._size.value, self._typed = round(self._length, 4), False
            self._tab.invalidate()
            return
        up = points[1] - points[0]
        if kind == "floor":
            up = np.cross(up, points[2] - points[0])
            asset = self._tab.selection.need_object().need_asset()
            beyond = np.median((asset.display_centers - points[0]) @ up)
            up = up if beyond >= 0 else -up
        length = float(np.linalg.norm(up))
        if length < 1e-12:
            raise CommandError(words.SAME_PLACE)
        x, y, z = (up / length).tolist()
        preparing.propose((x, y, z), anew=True)

    # --- size

    def _height(self, obj: OpenObject) -> float:
        asset = obj.need_asset()
        frame, found = self._frame(obj), obj.preparing.current
        points = asset.display_centers
        if found is not None:
            points = points[found.kinds == 0] if (found.kinds == 0).any() else points
        z = points @ frame[2, :3]
        low, high = np.percentile(z, [0.05, 99.95])
        return float(high - low)

    def _scale_clicked(self, action: str) -> None:
        if action == words.SCALE_ACTIONS[1]:
            self.measure()
            return
        self._rescale(*self._asked_size(self._tab.selection.need_object()))

    def _size_typed(self) -> None:
        self._typed = True
        self._tab.invalidate()

    def _asked_size(self, obj: OpenObject) -> tuple[float, str]:
        """Factor that gives the object the size in the field, and the words for it."""
        size = float(self._size.value)
        if self._length is not None:
            return size / self._length, words.measured(f"{size:g}")
        return size / self._height(obj), words.resized(f"{size:g}")

    def measure(self) -> None:
        """Ask for two points whose distance is known."""
        self._pointing.arm("length")

    def _use_usual(self) -> None:
        """Put the usual height in the field; it is applied with all else that is proposed."""
        obj = self._tab.selection.need_object()
        odd = unusual_height(obj.document.category, self._height(obj))
        if odd is not None:
            self._length, self._size.value = None, float(f"{odd.proposed:.2g}")
            self._size_typed()

    def _rescale(self, ratio: float, what: str) -> None:
        if not (np.isfinite(ratio) and ratio > 0):
            raise CommandError(words.BAD_SIZE)
        self._length, self._typed = None, False
        preparing = self._tab.selection.need_object().preparing
        preparing.turn(np.diag([ratio, ratio, ratio, 1.0]), what, self._tab.user)

    def _unit_chosen(self) -> None:
        unit = self._unit.value
        preparing = self._tab.selection.need_object().preparing
        preparing.set_unit(UNITS[unit], words.unit_set(unit), self._tab.user)

    # --- drawing

    def draw(self, obj: OpenObject) -> None:
        """Bring the picture and, in this step, the widgets up to date."""
        overlay = self._picture.overlay
        if obj.asset is None:  # being read: what is shown stays until then
            return
        if self._tab.selection.step != "Prepare":
            if self._shown_for is not None and overlay is not None:
                self._picture.preview(None)
                overlay.mark(None)
                self._marks.draw(None, removed=False, handle=False)
            self._shown_for = None
            return
        obj.preparing.propose_for_step()
        self._mark_by_default(obj)
        if self._waits and not _searching(obj):
            self._tab.act(lambda: self.apply() if self._waits else None)
        found = obj.preparing.current
        frame, marks = self._frame(obj), self._marked(obj)
        here = (self._handle, self._length, self._typed)
        now = (id(obj.asset), id(found), frame.tobytes(), marks, here, obj.document, (*obj.busy,))
        if now == self._shown_for:
            return
        self._shown_for = now
        self._draw_widgets(obj, obj.document, found, marks)
        asset = obj.asset  # another thread may let it be read anew
        if overlay is None or asset is None:
            return
        self._picture.preview(frame)
        if found is not None:
            points = _moved(asset.display_centers, found.object_from_asset)
            overlay.mark(marks.of(points, found.kinds, asset.display_confidence))
        box = marks.box if found is not None else None
        self._marks.draw(
            box,
            None if found is None else found.object_from_asset,
            removed=True,
            handle=self._handle,
        )

    def _mark_by_default(self, obj: OpenObject) -> None:
        """Mark what a raw scan has beside the object, and nothing in a clean one."""
        found, preparing, raw = obj.preparing.current, obj.preparing, obj.document.left_out is None
        now = (obj.record.id, raw, None if found is None else found.up, found is None)
        if now == self._marked_for:
            return
        self._marked_for = now
        self._reset_marks(raw and bool(preparing.noticed() or preparing.frame() is not None))

    def _draw_widgets(
        self, obj: OpenObject, doc: Document, found: ScanProposal | None, marks: Marks
    ) -> None:
        asset = obj.need_asset()
        for kind, box in self._kinds.items():
            count = 0 if found is None else found.counts[kind]
            put(box, visible=count > 0, label=words.kind(kind, count))
        put(self._confidence, visible=asset.display_confidence is not None)
        if asset.display_confidence is not None:  # some count from 1 without end
            most = max(1.0, float(np.percentile(asset.display_confidence, 95)))
            put(self._confidence, max=round(most, 2))
        for side in self._sides:
            put(side, visible=bool(self._crop.value))
        height = self._height(obj)
        put(self._size, label=words.HEIGHT if self._length is None else words.LENGTH)
        if self._length is None and not self._typed:
            put(self._size, value=round(height, 3))
        odd = None if self._typed else unusual_height(doc.category, height)
        put(self._usual, visible=odd is not None)
        lines = self._hints(obj, doc, found, marks)
        if odd is not None:
            put(self._usual, label=words.use_height(odd.proposed))
            lines.append(odd.question)
        for word, scale in UNITS.items():
            if abs(scale - doc.unit_scale) < 1e-9:
                put(self._unit, value=word)
        put(self._hint, content="\n\n".join(lines))
        offers = self._typed or marks != Marks() or not np.array_equal(self._frame(obj), np.eye(4))
        put(self._apply, label=words.APPLY if offers else words.CONTINUE)
        note = [] if doc.left_out is None else [words.removed(doc.left_out.count)]
        note += [
            path_with_tooltip(str(obj.record.path)),
            *(warning(plain(w, 300)) for w in asset.warnings),
        ]
        put(self._note, content="\n\n".join(note))

    def _hints(
        self, obj: OpenObject, doc: Document, found: ScanProposal | None, marks: Marks
    ) -> list[str]:
        if found is None:
            return [words.SEARCHING if "prepare" in obj.busy else words.NOT_FOUND]
        lines = [] if not (doc.prompts or doc.tree) else [words.DISCARDS]
        odd = _odd_size(obj)
        if odd is not None:
            lines.append(words.bold(odd.question))
        if found.up not in (None, UPRIGHT):
            lines.append(words.GIVEN)
        lines += self._orientation(obj)
        does = words.enter(obj.preparing.frame() is not None, marks != Marks())
        return [*lines, does] if lines or does else [words.UPRIGHT]


def _searching(obj: OpenObject) -> bool:
    """True while it isn't known yet what is proposed."""
    return obj.preparing.current is None and not obj.busy.keys().isdisjoint(("open", "prepare"))


def _odd_size(obj: OpenObject) -> OddSize | None:
    asset = obj.asset
    return None if asset is None else odd_size(asset.bounds, asset.source.unit_scale)


def _moved(points: npt.NDArray[np.floating], matrix: Array) -> Array:
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])
