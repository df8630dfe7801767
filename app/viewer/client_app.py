"""One browser tab: what it looks at, its panels, and the two threads that serve it.

What a person does is put into a queue and carried out in order by the *action* thread; the *draw*
thread brings the screen up to date with the state, however many changes came meanwhile. viser's
callbacks only fill the queue, so its event loop never waits.
"""

from __future__ import annotations

import datetime
import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import viser

from app.viewer import palette
from app.viewer.animation import Animation
from app.viewer.annotate_panel import AnnotatePanel
from app.viewer.joints_panel import JointsPanel
from app.viewer.keys import KEYS, add_keys
from app.viewer.queue_panel import QueuePanel
from app.viewer.review_panel import ReviewPanel
from app.viewer.scene_view import AxisMark, SceneView, axis_length
from app.viewer.text import plain
from app.viewer.widgets import put
from app.workbench import OpenObject, Workbench
from model.errors import ArtiworldError
from model.geometry.picking import Camera
from model.kinematics.joint import Joint
from model.progress import Cancelled
from model.segmentation.prompts import MAX_PARTS, Click
from sessions import commands as cmd
from sessions.document import Document

log = logging.getLogger(__name__)
Stage = Literal["Annotate", "Joints", "Review"]
STAGES: tuple[Stage, ...] = ("Annotate", "Joints", "Review")
PICK_SECONDS = 30.0


class ClientApp:
    """The whole application as one tab sees it."""

    def __init__(self, client: viser.ClientHandle, bench: Workbench) -> None:
        self.client = client
        self.bench = bench
        self.who = bench.config.user
        self.object: OpenObject | None = None
        self.part = 1
        self.child: str | None = None
        self.q: dict[str, float] = {}
        self.stage: Stage = "Annotate"
        self.hidden: frozenset[int] = frozenset()
        self.touch_wanted = False
        self.gizmo_on = False
        self._gizmo: Any = None
        self._gizmo_key: Any = None
        self._actions: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._dirty = threading.Event()
        self._closed = False
        self._drawn_asset: Any = None
        self._seen: tuple[int, Any] | None = None
        self._unwatch: Callable[[], None] = lambda: None
        self.scene = SceneView(client)
        self.animation = Animation(self._animate)
        self._build()
        self._unqueue = bench.on_queue(self.invalidate)
        for target in (self._act_loop, self._draw_loop):
            threading.Thread(target=target, name=f"tab-{client.client_id}", daemon=True).start()
        self.act(self._start)

    # --- life

    def _build(self) -> None:
        gui = self.client.gui
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False)
        gui.set_panel_label("ArtiWorld")
        self.queue_panel = QueuePanel(self)
        self.status = gui.add_markdown("")
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self.cancel_button = gui.add_button(
            "Cancel", icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        self.cancel_button.on_click(lambda _: self.act(self.cancel))
        history = gui.add_button_group("History", ("Undo", "Redo"))
        history.on_click(lambda e: self.act(self.undo if e.target.value == "Undo" else self.redo))
        self._stages = gui.add_button_group("Step", STAGES)
        self._stages.on_click(lambda e: self._stage_clicked(e.target.value))
        self.folders = {s: gui.add_folder(None, visible=s == "Annotate") for s in STAGES}
        with self.folders["Annotate"]:
            self.annotate_panel = AnnotatePanel(self)
        with self.folders["Joints"]:
            self.joints_panel = JointsPanel(self)
        with self.folders["Review"]:
            self.review_panel = ReviewPanel(self)
        with gui.add_folder("Keys and mouse", expand_by_default=False):
            gui.add_markdown("\n".join(f"- **{k}** {plain(v)}" for k, v in KEYS))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(380)
        add_keys(self)
        self._listen()

    def _listen(self) -> None:
        scene = self.client.scene

        @scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self._clicked(event, True)

        @scene.on_click(modifier="shift")
        def _(event: viser.SceneClickEvent) -> None:
            self._clicked(event, False)

        @scene.on_rect_select(modifier="alt")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self._camera()
            self.act(lambda: self.box_select(event.screen_min, event.screen_max, camera, True))

        @scene.on_rect_select(modifier="alt+shift")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self._camera()
            self.act(lambda: self.box_select(event.screen_min, event.screen_max, camera, False))

    def _start(self) -> None:
        """Go back to where this browser was, else to the first object that is not done."""
        wanted = None
        try:
            stored = self.client.local_storage.get_item("artiworld", timeout=3.0)
            name, _, number = (stored or "").partition("\n")
            self.who = cmd.clean_text(name, 60, "your name") or self.who
            wanted = int(number) if number.isdigit() else None
        except (RuntimeError, TimeoutError, ArtiworldError):
            log.info("tab %s has no memory of its own", self.client.client_id)
        self.queue_panel.show_user(self.who)
        records = self.bench.records()
        if not records:
            self.notify("The queue is empty", "Start with: artiworld serve PATH", "yellow")
            return
        ids = [r.id for r in records]
        if wanted not in ids:
            open_ones = [r.id for r in records if r.state in ("todo", "in_progress", "rejected")]
            wanted = (open_ones or ids)[0]
        self.open(wanted)

    def close(self) -> None:
        """The tab is gone."""
        if self._closed:
            return
        self._closed = True
        self.animation.stop()
        self._unwatch()
        self._unqueue()
        self._actions.put(None)
        self._dirty.set()

    def act(self, action: Callable[[], None]) -> None:
        """Carry out ``action`` after those before it, off viser's threads."""
        self._actions.put(action)

    def on_update(self, handle: Any, action: Callable[[], None]) -> None:
        """Carry out ``action`` when a person changes a widget, not when we do."""
        handle.on_update(lambda event: self.act(action) if event.client is not None else None)

    def invalidate(self) -> None:
        """Draw again soon."""
        self._dirty.set()

    def _act_loop(self) -> None:
        while (action := self._actions.get()) is not None:
            try:
                action()
            except Cancelled:
                pass
            except ArtiworldError as error:
                self.notify("That can't be done", str(error), "yellow")
            except Exception:  # the boundary of a person's action: say it and go on
                if self._closed:
                    return
                log.exception("an action in tab %s failed", self.client.client_id)
                self.notify("Something broke", "Nothing was lost; see the server's log", "red")
            self.invalidate()

    def _draw_loop(self) -> None:
        while True:
            self._dirty.wait()
            self._dirty.clear()
            if self._closed:
                return
            try:
                self._draw()
            except Exception:  # the boundary of drawing: a closing tab must not end the server
                if not self._closed:
                    log.exception("drawing tab %s failed", self.client.client_id)
            time.sleep(0.01)

    def notify(self, title: str, body: str, color: Any = "blue") -> None:
        """A note in the corner."""
        if not self._closed:
            seconds = 10.0 if color == "red" else 5.0
            self.client.add_notification(title, body[:400], auto_close_seconds=seconds, color=color)

    # --- what a person does

    def open(self, object_id: int) -> None:
        """Show another object."""
        self._unwatch()
        self.animation.stop()
        self.object = self.bench.object(object_id)
        self._unwatch = self.object.watch(self.invalidate, self.notify)
        self.part, self.child, self.q = 1, None, {}
        self.hidden, self.gizmo_on, self._drawn_asset = frozenset(), False, None
        doc = self.object.document
        self.set_stage("Joints" if doc.tree is not None else "Annotate")
        self.remember()
        if self.object.problem:
            self.notify("Can't open this file", self.object.problem, "red")

    def remember(self) -> None:
        """Keep the person's name and place in the browser."""
        number = "" if self.object is None else str(self.object.record.id)
        self.client.local_storage.set_item("artiworld", f"{self.who}\n{number}")

    def step(self, by: int) -> None:
        """Next or previous object of the queue."""
        ids = [r.id for r in self.bench.records()]
        if self.object is not None and ids:
            self.open(ids[(ids.index(self.object.record.id) + by) % len(ids)])

    def do(self, command: cmd.Command) -> None:
        """Carry out one decision."""
        self.need_object().do(command, self.who)

    def need_object(self) -> OpenObject:
        """The open object.

        Raises:
            ArtiworldError: where none is open.
        """
        if self.object is None:
            raise ArtiworldError("no object is open: choose one in the queue")
        return self.object

    def undo(self) -> None:
        """Take back the last decision."""
        if self.need_object().state.can_undo:
            self.do(cmd.Undo())
        else:
            self.notify("Nothing to undo", "", "gray")

    def redo(self) -> None:
        """Do again what was taken back."""
        if self.need_object().state.can_redo:
            self.do(cmd.Redo())
        else:
            self.notify("Nothing to redo", "", "gray")

    def _stage_clicked(self, label: str) -> None:
        self.act(lambda: self.set_stage(label.removeprefix("● ")))  # type: ignore[arg-type]

    def set_stage(self, stage: Stage) -> None:
        """Annotate, Joints or Review."""
        if stage == "Annotate":
            self.animation.stop()
            self.q = {}
        self.stage = stage
        self.invalidate()

    def choose_part(self, part: int) -> None:
        """The part that the next clicks belong to; adds it if it is new."""
        if not 0 <= part < MAX_PARTS:
            return
        if self.stage != "Annotate":
            self.set_stage("Annotate")
        self.part = part
        doc = self.need_object().document
        if part and part not in {p.id for p in doc.parts}:
            self.do(cmd.AddPart(part))

    def _clicked(self, event: Any, positive: bool) -> None:
        origin = tuple(float(v) for v in event.ray_origin)
        direction = tuple(float(v) for v in event.ray_direction)
        self.act(lambda: self.click(origin, direction, positive))  # type: ignore[arg-type]

    def click(
        self,
        origin: tuple[float, float, float],
        direction: tuple[float, float, float],
        positive: bool,
    ) -> None:
        """A click in the picture: a prompt while annotating, else the choice of a joint."""
        from app import tasks

        obj = self.need_object()
        if obj.asset is None:
            return
        hit = self.bench.geometry.submit(
            tasks.pick, obj.asset.folder, origin, direction, priority=20
        ).result(PICK_SECONDS)
        if hit is None:
            return
        if self.stage != "Annotate":
            self._choose_joint_at(hit.element)
            return
        position = tuple(float(v) for v in hit.position)
        known = {p.id for p in obj.document.parts}
        if self.part and self.part not in known:
            self.do(cmd.AddPart(self.part))
        self.do(cmd.AddClick(Click(position, self.part, positive, int(hit.element))))  # type: ignore[arg-type]

    def _choose_joint_at(self, element: int) -> None:
        obj = self.need_object()
        if obj.labels is None or obj.asset is None or any(self.q.values()):
            return
        shown = np.flatnonzero(obj.asset.element == element)
        if not len(shown):
            return
        link = f"link_{int(obj.labels[shown[0]])}"
        tree = obj.document.tree
        if tree is not None and link in tree.joint_of:
            self.choose_joint(link)

    def box_select(self, low: Any, high: Any, camera: Camera, positive: bool) -> None:
        """Everything visible in a rectangle goes to the chosen part."""
        from app import tasks

        obj = self.need_object()
        if obj.asset is None or self.stage != "Annotate":
            return
        ref, count = self.bench.geometry.submit(
            tasks.select_box, obj.asset.folder, self.bench.workspace, camera, low, high, priority=20
        ).result(PICK_SECONDS)
        if not count:
            self.notify("Nothing in the box", "Drag it over the object", "gray")
            return
        if self.part and self.part not in {p.id for p in obj.document.parts}:
            self.do(cmd.AddPart(self.part))
        self.do(cmd.AddRegion(self.part, ref, positive, count, "box"))

    def _camera(self) -> Camera:
        view = self.client.camera
        return Camera(
            position=np.asarray(view.position, np.float64),
            world_from_camera=np.asarray(view.wxyz, np.float64),
            fov=float(view.fov),
            aspect=float(view.aspect),
        )

    def predict(self) -> None:
        """Ask for joints."""
        self.need_object().predict(self.who)

    def predict_here(self) -> None:
        """Ask this machine for joints where the backend is away."""
        self.need_object().predict(self.who, here=True)

    def cancel(self) -> None:
        """Stop what runs."""
        for what in ("predict", "save", "segment"):
            self.need_object().cancel(what)

    def accept(self) -> None:
        """Accept the object; its asset is written first."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        self.need_object().accept(self.review_panel.comment_text, self.who, now)

    def reject(self) -> None:
        """Send the object back to its annotator."""
        self.do(cmd.Reject(self.review_panel.chosen_reason, self.review_panel.comment_text))
        self.review_panel.clear_comment()
        self.notify("Rejected", "It is back with its annotator", "orange")

    def choose_joint(self, child: str) -> None:
        """The joint that the editor shows."""
        self.child = child
        self.gizmo_on = self.gizmo_on and self.stage == "Joints"
        self.invalidate()

    def next_choice(self) -> None:
        """While annotating the next mask for the part, else the next joint (Tab)."""
        if self.stage == "Annotate":
            self.annotate_panel.use_tool("Next mask")
        else:
            self.next_joint()

    def next_joint(self) -> None:
        """The next moving joint of the tree."""
        tree = self.need_object().document.tree
        if tree is None or not tree.joints:
            return
        children = [j.child for j in tree.joints]
        at = children.index(self.child) if self.child in children else -1
        self.choose_joint(children[(at + 1) % len(children)])
        if self.stage == "Annotate":
            self.set_stage("Joints")

    @property
    def joint(self) -> Joint | None:
        """The chosen joint."""
        if self.object is None or self.object.document.tree is None or self.child is None:
            return None
        return self.object.document.tree.joint_of.get(self.child)

    def set_joint(self, joint: Joint) -> None:
        """Replace the chosen joint."""
        self.do(cmd.SetJoint(joint))

    @property
    def drawn(self) -> bool:
        """Whether the open object's picture was sent."""
        return self.object is not None and self._drawn_asset is self.object.asset is not None

    @property
    def shows_labels(self) -> bool:
        """Whether the newest labels were sent."""
        return self.object is not None and self.scene.labels is self.object.labels

    # --- motion

    def set_q(self, name: str, value: float) -> None:
        """Move one joint; radians or metres."""
        if abs(self.q.get(name, 0.0) - value) > 1e-9:
            self.q[name] = value
            self._pose()

    def _animate(self, q: dict[str, float]) -> None:
        self.q.update(q)
        self._pose()
        self.joints_panel.show_q(self.q)

    def reset_pose(self) -> None:
        """All joints back to the scanned pose."""
        self.animation.stop()
        self.q = {}
        self.joints_panel.show_q({})
        self._pose()

    def play(self, name: str | None = None) -> None:
        """Start or stop moving one joint, or all of them."""
        tree = self.need_object().document.tree
        if tree is None:
            self.notify("No joints yet", "Predict them first (P)", "gray")
            return
        if self.stage == "Annotate":
            self.set_stage("Joints")
        chosen = [j for j in tree.joints if j.moves and j.mimic is None]
        self.animation.toggle([j for j in chosen if name in (None, j.name)], self.q)

    def _pose(self) -> None:
        tree = self.object.document.tree if self.object is not None else None
        if tree is None:
            return
        names = tree.by_name
        self.scene.pose(tree.pose({k: v for k, v in self.q.items() if k in names}))

    # --- drawing

    def _draw(self) -> None:
        self.queue_panel.draw()
        for stage, folder in self.folders.items():
            if folder.visible != (stage == self.stage):
                folder.visible = stage == self.stage
        labels = tuple(("● " if s == self.stage else "") + s for s in STAGES)
        if self._stages.options != labels:
            self._stages.options = labels
        obj = self.object
        if obj is None:
            return
        self._draw_status(obj)
        self._follow_prediction(obj)
        if obj.asset is not None and obj.asset is not self._drawn_asset:
            self.scene.show_asset(obj.asset)
            self._drawn_asset, self._gizmo, self._gizmo_key = obj.asset, None, None
        elif obj.asset is None and self._drawn_asset is not None:
            self.scene.clear()
            self._drawn_asset = None
        self._draw_scene(obj)
        self.annotate_panel.draw(obj)
        self.joints_panel.draw(obj)
        if self.stage == "Review":  # it reads the history, which no click should pay for
            self.review_panel.draw(obj)

    def _follow_prediction(self, obj: OpenObject) -> None:
        """A new prediction is what the person waited for: show its joints."""
        prediction = obj.document.prediction
        before, self._seen = self._seen, (obj.record.id, prediction)
        if prediction is None or before is None or before[0] != obj.record.id:
            return
        if prediction is not before[1] and self.stage == "Annotate":
            self.set_stage("Joints")

    def _draw_status(self, obj: OpenObject) -> None:
        doc, asset = obj.document, obj.asset
        lines = [f"**{plain(obj.record.name)}** · {palette.STATE_WORDS[doc.review.state]}"]
        if asset is not None:
            kind = {"face": "faces", "point": "points"}[asset.element_kind]
            size = (asset.bounds[1] - asset.bounds[0]) * 1000
            lines.append(
                f"{asset.element_count:,} {kind} · {size[0]:.0f} × {size[1]:.0f} × {size[2]:.0f} mm"
            )
        if obj.problem:
            lines.append(f"⚠ {plain(obj.problem, 400)}")
        if doc.prediction_stale:
            lines.append("⚠ The parts changed since the prediction: predict again (P)")
        shown = [w for w in ("open", "save", "predict", "segment", "encode") if w in obj.busy]
        words = {
            "open": "Opening",
            "save": "Saving",
            "predict": "Predicting",
            "segment": "Segmenting",
            "encode": "Preparing for clicks",
        }
        fraction = 0.0
        if shown:
            fraction, message = obj.busy[shown[0]]
            lines.append(f"*{words[shown[0]]}… {plain(message)}*")
        put(self.status, "content", "\n\n".join(lines))
        put(self.progress, "visible", bool(shown))
        put(self.progress, "value", round(100 * fraction, 1))
        stoppable = "predict" in obj.busy or "save" in obj.busy
        put(self.cancel_button, "visible", stoppable)

    def _draw_scene(self, obj: OpenObject) -> None:
        doc = obj.document
        if obj.asset is None:
            return
        moving = self.stage != "Annotate" and doc.tree is not None
        payloads = obj.part_payloads() if moving else None
        self.scene.show_labels(obj.labels, self.hidden)
        clicks = [(i, p) for i, p in enumerate(doc.prompts) if isinstance(p, Click)]
        self.scene.show_prompts(clicks, visible=self.stage == "Annotate")
        self.scene.show_parts(payloads, moving and payloads is not None)
        self.scene.hide_parts(self.hidden)
        self.scene.show_axes(self._axis_marks(obj, doc) if moving else ())
        self.scene.show_contacts(obj.checks, visible=moving)
        self._pose()
        self._draw_gizmo()
        pad = self.scene.touch
        new = self.scene.show_touch_pad(self.touch_wanted)
        if new is not None and new is not pad:
            new.on_click(lambda event: self._clicked(event, True))

    def _axis_marks(self, obj: OpenObject, doc: Document) -> list[AxisMark]:
        assert doc.tree is not None and obj.asset is not None
        payloads = obj.part_payloads()
        marks = []
        for joint in doc.tree.joints:
            if not joint.moves:
                continue
            chosen = joint.child == self.child
            length = axis_length(payloads, joint, obj.asset.diagonal)
            part = joint.child.removeprefix("link_")
            color = palette.part_color(int(part)) if part.isdigit() else palette.GHOST
            marks.append(
                AxisMark(
                    joint.name,
                    joint.origin,
                    joint.axis,
                    length,
                    palette.SELECTED if chosen else color,
                    chosen,
                )
            )
            predicted = None if doc.prediction is None else doc.prediction.joint(joint.child)
            if predicted is not None and predicted.moves and _moved(predicted, joint):
                marks.append(
                    AxisMark(
                        f"ghost-{joint.name}",
                        predicted.origin,
                        predicted.axis,
                        length,
                        palette.GHOST,
                        False,
                    )
                )
        return marks

    # --- gizmo

    def toggle_gizmo(self) -> None:
        """Show or hide the handles for the chosen joint's axis."""
        if self.joint is None or not self.joint.moves:
            self.notify("Choose a joint first", "Tab chooses the next one", "gray")
            return
        self.gizmo_on = not self.gizmo_on
        if self.gizmo_on:
            self.reset_pose()
            self.set_stage("Joints")
        self.invalidate()

    def _draw_gizmo(self) -> None:
        joint = self.joint
        wanted = joint if self.gizmo_on and joint is not None and joint.moves else None
        key = None if wanted is None else (wanted.child, wanted.origin, wanted.axis)
        if key == self._gizmo_key:
            return
        self._gizmo_key = key
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        if wanted is None or self.object is None or self.object.asset is None:
            return
        gizmo = self.client.scene.add_transform_controls(
            "/gizmo",
            scale=0.22 * self.object.asset.diagonal,
            position=wanted.origin,
            wxyz=_frame_along(wanted.axis),
            depth_test=False,
        )
        self._gizmo = gizmo
        gizmo.on_drag_end(lambda _: self.act(self.take_gizmo))

    def take_gizmo(self) -> None:
        """The handles were let go: their place is the joint's new axis."""
        import dataclasses

        from viser import transforms as vtf

        gizmo, joint = self._gizmo, self.joint
        if gizmo is None or joint is None:
            return
        axis = vtf.SO3(np.asarray(gizmo.wxyz)).as_matrix()[:, 2]
        origin = tuple(float(v) for v in gizmo.position)
        self.set_joint(
            dataclasses.replace(joint, origin=origin, axis=tuple(float(v) for v in axis))
        )


def _moved(a: Joint, b: Joint) -> bool:
    off = np.abs(np.subtract(a.origin, b.origin)).max() > 1e-9
    return bool(off or np.abs(np.subtract(a.axis, b.axis)).max() > 1e-9)


def _frame_along(axis: tuple[float, float, float]) -> Any:
    """A rotation whose z is ``axis``; quaternion wxyz."""
    from viser import transforms as vtf

    z = np.asarray(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return vtf.SO3.from_matrix(np.column_stack([x, np.cross(z, x), z])).wxyz
