"""One browser tab: what it looks at, and its panels.

viser's callbacks only put actions into the queue of :mod:`app.viewer.tab_threads`, so its event
loop never waits.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, Literal

import viser

from app.server.app_state import AppState
from app.server.display_names import in_words
from app.server.open_object import OpenObject
from app.viewer.in_scene import InScene
from app.viewer.input.commands import Commands
from app.viewer.input.decision_guard import Seen
from app.viewer.input.keys import add_keys
from app.viewer.input.pointing import Pointing
from app.viewer.panels.annotate_panel import AnnotatePanel
from app.viewer.panels.joints_panel import JointsPanel
from app.viewer.panels.queue_panel import QueuePanel
from app.viewer.panels.rejecting import Rejecting
from app.viewer.panels.review_panel import ReviewPanel
from app.viewer.panels.scene_list import SceneList
from app.viewer.panels.source_panel import SourcePanel
from app.viewer.picture.light import PLAIN, LightSwitch
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_picture import SceneView
from app.viewer.redraw import STAGES, Redraw
from app.viewer.tab_threads import TabThreads
from model.core.errors import ArtiworldError
from model.core.joint import Joint
from model.segmentation.prompts import MAX_PARTS
from sessions import commands as cmd

log = logging.getLogger(__name__)
Stage = Literal["Annotate", "Joints", "Review"]


class ClientApp:
    """The whole application as one tab sees it."""

    def __init__(self, client: viser.ClientHandle, app_state: AppState) -> None:
        self.client = client
        self.app_state = app_state
        self.who = app_state.config.user
        self.object: OpenObject | None = None
        self.part = 1
        self.child: str | None = None
        self.stage: Stage = "Annotate"
        self.hidden: frozenset[int] = frozenset()
        self.touch_wanted = False
        self.skipped: set[int] = set()
        self._unwatch: Callable[[], None] = lambda: None
        self._heard: set[OpenObject] = set()
        self.scene = SceneView(client, in_scene=app_state.scene is not None)
        self._in_scene: InScene | None = None
        self.commands = Commands(self)
        self.motion = Motion(self)
        self.pointing = Pointing(self)
        self.redraw = Redraw(self)
        self.seen = Seen(self)
        self.rejecting = Rejecting(self, self.commands.about, self.commands.reject_because)
        name = f"tab-{client.client_id}"
        self._threads = TabThreads(name, self.redraw.draw, self.notify)
        self._build()
        self._unqueue = app_state.queue.subscribe(self.invalidate)
        self._threads.start()
        self.act(self._start)

    # --- life

    def _build(self) -> None:
        gui = self.client.gui
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False)
        gui.set_panel_label("ArtiWorld")
        if self.app_state.scene is None:
            self.queue_panel: QueuePanel | SceneList = QueuePanel(self)
        else:
            self._in_scene = InScene(self, self.app_state.scene)
            self.queue_panel = self._in_scene.list
            self._in_scene.build_card()
        self.object_folder = gui.add_folder(None, visible=self._in_scene is None)
        with self.object_folder:
            self._build_object()
        keys = gui.add_button("Keys and mouse (?)", icon=viser.Icon.KEYBOARD, color="gray")
        keys.on_click(lambda _: self.act(self.commands.show_keys))
        self.light = LightSwitch(self)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(380)
        add_keys(self)
        self.pointing.listen()

    def _build_object(self) -> None:
        gui = self.client.gui
        if self._in_scene is not None:
            back = gui.add_button(
                "Back to the scene (Backspace)", icon=viser.Icon.ARROW_LEFT, color="dark"
            )
            back.on_click(lambda _: self.act(self.in_scene.leave))
            self._in_scene.build_pick_panel()
        self.status = gui.add_markdown("")
        self.again_button = gui.add_button(
            "Try again", icon=viser.Icon.REFRESH, color="gray", visible=False
        )
        self.again_button.on_click(lambda _: self.act(lambda: self.need_object().try_again()))
        self.off_button = gui.add_button(
            "Take it off the list", icon=viser.Icon.X, color="gray", visible=False,
            hint="The file stays, and so does what was decided about it",
        )  # fmt: skip
        self.off_button.on_click(lambda _: self.act(self.take_off))
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self.cancel_button = gui.add_button(
            "Cancel", icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        # At once: the tab's actions may be waiting for what is to be stopped.
        self.cancel_button.on_click(lambda _: self.commands.cancel())
        history = gui.add_button_group("History", ("Undo", "Redo"))
        history.on_click(
            lambda e: self.act(
                self.commands.undo if e.target.value == "Undo" else self.commands.redo
            )
        )
        self.stage_buttons = gui.add_button_group("Step", STAGES)
        self.stage_buttons.on_click(lambda e: self._stage_clicked(e.target.value))
        self.play_buttons = gui.add_button_group(
            "Motion", ("Play / stop (Space)", "Reset pose (R)"), visible=False
        )
        self.play_buttons.on_click(
            lambda e: self.act(
                self.commands.play if e.target.value.startswith("Play") else self.motion.reset
            )
        )
        self.folders = {s: gui.add_folder(None, visible=s == "Annotate") for s in STAGES}
        with self.folders["Annotate"]:
            self.annotate_panel = AnnotatePanel(self)
            self.source_panel = SourcePanel(self)
        with self.folders["Joints"]:
            self.joints_panel = JointsPanel(self)
        with self.folders["Review"]:
            self.review_panel = ReviewPanel(self)

    def _start(self) -> None:
        """Go back to where this browser was, else to the first object that is not done."""
        wanted, inside, chosen = None, "", ""
        try:
            stored = self.client.local_storage.get_item("artiworld", timeout=3.0)
            kept = [*(stored or "").split("\n"), "", "", "", ""]
            name, number, inside, light, chosen = kept[:5]
            self.light.plain = light == PLAIN
            self.who = cmd.clean_text(name, 60, "your name") or self.who
            wanted = int(number) if number.isdigit() else None
        except (RuntimeError, TimeoutError, ArtiworldError):
            log.info("tab %s has no memory of its own", self.client.client_id)
        self.queue_panel.show_user(self.who)
        if self._in_scene is not None:
            if inside or chosen:
                self._in_scene.come_back(inside, chosen)
            return
        records = self.app_state.queue.records()
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
        if self._threads.closed:
            return
        self._threads.close()
        self.pointing.close()
        self.motion.stop()
        if self._in_scene is not None:
            self._in_scene.close()
        self._unwatch()
        self._unqueue()

    def act(self, action: Callable[[], None]) -> None:
        """Carry out ``action`` after those before it, off viser's threads."""
        self._threads.act(action)

    def decide(self, action: Callable[[], None]) -> None:
        """Carry out a decision, unless it was asked for before what it is about could be seen."""
        pressed_at = time.monotonic()

        def carry_out() -> None:
            if self.seen.long_enough(pressed_at):
                action()
            else:
                self.notify("Look at it first", "It had only just come on the screen", "gray")

        self.act(carry_out)

    def on_update(self, handle: Any, action: Callable[[], None]) -> None:
        """Carry out ``action`` when a person changes a widget, not when we do."""
        handle.on_update(lambda event: self.act(action) if event.client is not None else None)

    def invalidate(self) -> None:
        """Draw again soon."""
        self._threads.invalidate()

    def notify(
        self, title: str, body: str, color: Any = "blue", seconds: float | None = 5.0
    ) -> None:
        """A note in the corner; it stays until it is closed where ``seconds`` is None."""
        if not self._threads.closed:
            obj = self.object  # another thread may close it
            body = body if obj is None else in_words(obj.document, body)
            seconds = 10.0 if color == "red" else seconds
            self.client.add_notification(title, body[:400], auto_close_seconds=seconds, color=color)

    # --- what a person does

    def open(self, object_id: int) -> None:
        """Show another object."""
        self.skipped.discard(object_id)
        self._hear_out(self.object)
        self._unwatch()
        self.motion.begin()
        self.pointing.begin()
        self.object = self.app_state.object(object_id)
        self._unwatch = self.object.watch(self.invalidate, self.notify)
        self.part, self.child = 1, None
        self.hidden, self.redraw.asset = frozenset(), None
        doc = self.object.document
        self.set_stage("Joints" if doc.tree is not None else "Annotate")
        if self.object.held:
            self.set_stage("Review")
            self.review_panel.gate.show_soon(self.object)
        self.remember()
        if self.object.problem:
            self.notify("Can't open this file", self.object.problem, "red")

    def _hear_out(self, obj: OpenObject | None) -> None:
        """What comes of an acceptance is told here, too, once another object is looked at."""
        if obj is None or obj in self._heard or not self.app_state.is_accepting(obj.record.id):
            return

        def over() -> bool:
            return not obj.judging.waiting and "save" not in obj.jobs

        def end() -> None:
            self._heard.discard(obj)
            stop()

        def tell(title: str, body: str, color: str) -> None:
            if over():
                end()
            if self.object is obj:  # come back to, it tells so by itself
                return
            name = self.app_state.display_name(obj.record)
            said = in_words(obj.document, body).removeprefix(f"{name}: ")
            self.notify(title, f"{name}: {said}", color)

        def changed() -> None:
            self.invalidate()
            if over() and obj.document.review.state != "accepted":
                end()  # why it was refused is told by whoever asked for it

        self._heard.add(obj)
        stop = obj.watch(changed, tell)

    def close_object(self) -> None:
        """Show no object: the scene is all there is."""
        self._hear_out(self.object)
        self._unwatch()
        self._unwatch = lambda: None
        self.motion.begin()
        self.pointing.begin()
        self.object, self.child = None, None
        self.invalidate()

    def remember(self) -> None:
        """Keep the person's name, place and light in the browser."""
        number = "" if self.object is None else str(self.object.record.id)
        scene = self._in_scene
        inside = "" if scene is None else scene.inside or ""
        chosen = "" if scene is None else scene.selected or ""
        light = PLAIN if self.light.plain else ""
        kept = "\n".join((self.who, number, inside, light, chosen))
        self.client.local_storage.set_item("artiworld", kept)

    @property
    def in_scene(self) -> InScene:
        """The scene as this tab sees it.

        Raises:
            ArtiworldError: where single objects are open.
        """
        if self._in_scene is None:
            raise ArtiworldError("no scene is open: start with artiworld serve SCENE --assets DIR")
        return self._in_scene

    @property
    def overview(self) -> InScene | None:
        """The scene while none of its objects is worked on, else None."""
        return self._in_scene if self.object is None else None

    @property
    def picking_out(self) -> bool:
        """Whether the open object is there to have another one picked out of it."""
        return self._in_scene is not None and self._in_scene.picking

    def step(self, by: int) -> None:
        """Next or previous object of the queue, or of the scene; going past one skips it."""
        if self._in_scene is not None:
            self._in_scene.step(by)
            return
        ids = [r.id for r in self.app_state.queue.records()]
        if self.object is not None and ids:
            current = self.object.record.id
            if by > 0:
                self.skipped.add(current)
            if current in ids:
                self.open(ids[(ids.index(current) + by) % len(ids)])
            else:  # another tab took it off the list
                self.open(ids[0 if by > 0 else -1])

    def take_off(self) -> None:
        """Take what can't be read off the list, and go on with the next object."""
        ids, current = [r.id for r in self.app_state.queue.records()], self.need_object().record.id
        self.app_state.queue.remove(current)
        left = [i for i in ids if i != current]
        if left:
            self.open(left[ids.index(current) % len(left)] if current in ids else left[0])
        else:
            self.close_object()

    def do(self, command: cmd.Command) -> None:
        """Carry out one decision."""
        self.need_object().do(command, self.who)

    def need_object(self) -> OpenObject:
        """The open object.

        Raises:
            ArtiworldError: where none is open.
        """
        if self.object is None:
            where = "the queue" if self._in_scene is None else "the scene and press Enter"
            raise ArtiworldError(f"no object is open: choose one in {where}")
        return self.object

    def _stage_clicked(self, label: str) -> None:
        self.act(lambda: self.set_stage(label.removeprefix("● ")))  # type: ignore[arg-type]

    def set_stage(self, stage: Stage) -> None:
        """Annotate, Joints or Review."""
        if stage == "Annotate":
            self.motion.stop()
            self.motion.q = {}
        else:
            self.pointing.disarm()
        if stage != "Review":
            self.motion.clear_moment()
            self.rejecting.cancel()
        self.stage = stage
        self.invalidate()

    def choose_part(self, part: int) -> None:
        """The part that the next clicks belong to; a new one is there once it gets something."""
        if not 0 <= part < MAX_PARTS:
            return
        self.need_object()
        if self.stage != "Annotate":
            self.set_stage("Annotate")
        self.part = part
        self.invalidate()

    def choose_joint(self, child: str) -> None:
        """The joint that the editor shows."""
        self.child = child
        self.motion.gizmo_on = self.motion.gizmo_on and self.stage == "Joints"
        self.invalidate()

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
        return self.object is not None and self.redraw.asset is self.object.asset is not None

    @property
    def shows_labels(self) -> bool:
        """Whether the newest labels were sent."""
        return self.object is not None and self.scene.labels is self.object.labels
