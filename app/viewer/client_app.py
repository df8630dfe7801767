"""One browser tab: makes its screens, connects them, and draws them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.server.app_state import AppState
from app.server.open_object import OpenObject
from app.viewer.commands import Commands, bindings
from app.viewer.input.keys import DecisionGuard, KeySheet, add_keys
from app.viewer.input.pointing import PointerActions, Pointing
from app.viewer.input.queries import Point, PointerQueries
from app.viewer.input.views import Views
from app.viewer.navigation import Memory, Navigation
from app.viewer.panels.comments import Comments, History
from app.viewer.panels.queue_panel import QueuePanel
from app.viewer.panels.reviewing import Exporting
from app.viewer.panels.step_bar import ObjectHeader, RailActions, StepBar, ToolRail, Tour
from app.viewer.panels.widgets import Presses, put
from app.viewer.picture.drawing import PLAIN, LightSwitch, ObjectDrawing, Theme
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.steps.annotate import AnnotateStep
from app.viewer.steps.joints import JointsStep
from app.viewer.steps.prepare import PrepareStep
from app.viewer.steps.review import ReviewActions, ReviewStep
from app.viewer.steps.scene import SceneStep
from app.viewer.steps.scene_selection import SceneHost
from app.viewer.tab import AT_REST, STEPS, Panel, Step, Tab
from sessions import commands as cmd
from sessions.credentials import Person

PANELS: tuple[tuple[Step, Callable[[Tab], Panel]], ...] = (("Review", History),)
"""Panels that need only the tab, below the other widgets of their step."""


class ClientApp:
    """The user interface of one tab.

    Attributes:
        tab: the browser, its user, and what is selected.
        picture, motion, drawing: the open object in 3D.
        queries: to the workers about places in the picture.
        pointing: what clicks and drags mean.
        prepare, annotate, joints, review: the steps of the work.
        scene: the scene, or None where single objects are open.
        queue: the list of all objects.
        guard: lets decisions through about what was seen.
        comments: of reviewers, with their markers.
        light: of the picture.
        theme: light or dark, as the browser has it.
        rail: the icons beside the picture.
        views: from where one looks, and at which parts.
        commands: what keys and buttons ask for.
    """

    def __init__(self, client: viser.ClientHandle, app_state: AppState, person: Person) -> None:
        in_scene = app_state.scene is not None
        self.tab = tab = Tab(client, person.name, in_scene=in_scene, account=person.account)
        self._app_state = app_state
        self._prediction: tuple[int, Any] | None = None
        self.picture = ObjectPicture(client, in_scene=in_scene)
        self.motion = Motion(tab, self.picture)
        self.queries = PointerQueries(tab, app_state.workspace, app_state.config.segmenter)
        self.pointing = Pointing(tab, self.picture, self.motion, self.queries)
        self.drawing = ObjectDrawing(
            tab, self.picture, self.motion, self._asset_shown, self._tapped
        )
        self.guard = DecisionGuard(tab, self._subject)
        self._navigation = Navigation(tab, app_state, self._opened, self._remember)
        self.commands = Commands(tab, self._navigation)
        self._sheet = KeySheet(tab)
        self._presses = Presses(tab)
        self._bar = StepBar(tab, self._presses, app_state.bulk, self.commands.cancel)
        self._exporting = Exporting(
            tab, app_state.bulk, app_state.workspace, app_state.store.project
        )
        rejecting = self.commands.rejecting
        self.views = Views(
            tab, self.picture, self._presses, self.commands.number, lambda: rejecting.asking
        )
        self._tour = Tour(tab, self._presses, self.motion, self._remember)
        self.rail = ToolRail(tab, self._presses, self.pointing, self._rail_actions())
        self._build()
        steps = (self.prepare, self.annotate, self.joints, self.review)
        self.commands.connect(steps, self.scene, self.comments, self.queue.open_held)
        view = (self.pointing, self.motion, self.picture, self._sheet, self.rail, self.views)
        add_keys(tab, bindings(tab, self.commands, steps, self.scene, view), self.guard.decide)
        self.pointing.listen(self._pointer_actions())
        self._unqueue = app_state.queue.subscribe(tab.invalidate)
        client.camera.on_update(lambda _: self.picture.refit())
        tab.start(self._draw)
        tab.act(self._start)

    # --- widgets

    def _build(self) -> None:
        tab, app_state, gui = self.tab, self._app_state, self.tab.client.gui
        gui.set_panel_label("ArtiWorld")
        self.scene: SceneStep | None = None
        self.queue = QueuePanel(
            tab,
            app_state,
            self._presses,
            self._open_listed,
            self.commands.step,
            self._remember,
            self._exporting.ask,
            self._listed,
        )
        if app_state.scene is not None:
            host = SceneHost(
                self._navigation.open, self._remember, self._accept_seen, self._reject_seen
            )
            rejecting = self.commands.rejecting
            self.scene = SceneStep(tab, app_state.scene, rejecting, host, self._presses)
        self._object_folder = gui.add_folder(None, visible=self.scene is None)
        with self._object_folder:
            if self.scene is not None:
                self.scene.build_object_widgets()
            self._build_object()
        self.light = LightSwitch(tab, self.drawing.detail, self._remember)
        scene = () if self.scene is None else (self.scene.picture,)
        self.theme = Theme(tab, self._presses, (self.picture, *scene))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(340)

    def _open_listed(self, id: int) -> None:
        """Open an object of the list, or choose it in the scene."""
        if self._app_state.scene is None or self.scene is None:
            self._navigation.open(id)
        else:
            self.scene.choice.choose(list(self._app_state.scene.items)[id], look=True)

    def _listed(self) -> int | None:
        """The id in the list of the open or chosen object."""
        scene, obj = self._app_state.scene, self.tab.selection.object
        if scene is None or self.scene is None:
            return None if obj is None else obj.record.id
        chosen = self.scene.choice.selected
        return list(scene.items).index(chosen) if chosen in scene.items else None

    def _rail_actions(self) -> RailActions:
        return RailActions(
            undo=self.commands.undo,
            redo=self.commands.redo,
            play=self.motion.play,
            reset_pose=self.motion.reset,
            show_keys=self._sheet.toggle,
            tour=self._tour.begin,
            isolate=self.views.isolate,
            category=lambda: self.annotate.likely_category,
        )

    def _build_object(self) -> None:
        tab, app_state, gui = self.tab, self._app_state, self.tab.client.gui
        self._header = ObjectHeader(
            tab,
            self._name_of,
            self._navigation.remove,
            lambda: tab.do(cmd.Reopen(self.review.comment_text)),
            lambda: self._exporting.ask([tab.selection.need_object().record.id]),
        )
        self.comments = Comments(tab, self._presses, lambda: self.picture.comments)
        self._folders = {s: gui.add_folder(None, visible=s == "Annotate") for s in STEPS}
        with self._folders["Prepare"]:
            self.prepare = PrepareStep(tab, self.pointing, self.picture)
        with self._folders["Annotate"]:
            self.annotate = AnnotateStep(
                tab,
                self.pointing,
                app_state.queue.records,
                self._navigation.open,
                self.prepare,
                self._presses,
                app_state.store.project,
            )
        with self._folders["Joints"]:
            self.joints = JointsStep(
                tab,
                self.motion,
                self.pointing,
                self._presses,
                app_state.workers.prediction,
                app_state.queue.records,
                app_state.store.project,
            )
        with self._folders["Review"]:
            review = ReviewActions(
                accept=self._accept_seen,
                reject=self._reject_seen,
                go_on=self.commands.go_on,
                name_of=app_state.display_name,
                drawn=lambda: self.drawing.drawn,
                ask_place=self._ask_place,
            )
            self.review = ReviewStep(tab, self.motion, self.commands.rejecting, review)

        self._panels = []
        for step, make in PANELS:
            with self._folders[step]:
                self._panels.append((step, make(tab)))

    def _accept_seen(self) -> None:
        self.guard.decide(self.commands.accept)

    def _ask_place(self) -> None:
        self.motion.reset()  # what is picked is at rest, and so is what is seen then
        self.pointing.arm("comment")

    def _reject_seen(self) -> None:
        self.tab.act(self.commands.reject)

    def _pointer_actions(self) -> PointerActions:
        return PointerActions(
            show_keys=self._sheet.toggle,
            show_messages=self._sheet.toggle_messages,
            name_by_key=self.commands.name_by_key,
            dismiss=self._dismiss,
            withdraw=self.review.withdraw,
            click_scene=self._click_scene,
            places_chosen=self.prepare.places_chosen,
            parent_chosen=self.joints.tree.hang,
            click_comment=self.comments.click,
            comment_placed=self.review.pin,
        )

    def _dismiss(self) -> bool:
        """Close the sheet of keys and the question for a reason; whether one was open."""
        asking = self.commands.rejecting.asking
        self.commands.rejecting.cancel()
        page = self.queue.project.close()
        return self._exporting.close() or self._sheet.close() or page or asking

    def _click_scene(self, origin: Point, direction: Point) -> bool:
        if self.scene is None or not self.scene.in_front:
            return False
        self.scene.choice.click(origin, direction)
        return True

    def _name_of(self, obj: OpenObject) -> str:
        return (None if self.scene is None else self.scene.choice.inside) or obj.record.name

    # --- life

    def _start(self) -> None:
        """Go back to where this browser was, else to the first object that is not done."""
        memory = Memory.load(self.tab)
        self.light.plain = memory.light == PLAIN
        if self.tab.account is None:  # else the browser has no say in who signs
            self.tab.user = memory.user or self.tab.user
        self._tour.over = bool(memory.toured)
        self.queue.user_name.show()
        if self.scene is None:
            self._navigation.start(memory.object)
        elif memory.inside or memory.chosen:
            self.scene.restore(memory.inside, memory.chosen)

    def _remember(self) -> None:
        """Keep the user's name, place and light in the browser."""
        obj, scene = self.tab.selection.object, self.scene
        Memory(
            user=self.tab.user,
            object="" if obj is None else str(obj.record.id),
            inside="" if scene is None else scene.choice.inside or "",
            light=PLAIN if self.light.plain else "",
            chosen="" if scene is None else scene.choice.selected or "",
            toured="yes" if self._tour.over else "",
        ).store(self.tab)

    def _opened(self, obj: OpenObject) -> None:
        self._tour.begin_at_first(obj)
        if obj.hold_reason:
            self.tab.selection.set_step("Review")
            self.review.validation_list.show_soon(obj)

    def close(self) -> None:
        """End what belongs to the tab."""
        if not self.tab.close():
            return
        self.pointing.close()
        self.motion.stop()
        if self.scene is not None:
            self.scene.close()
        self._navigation.close()
        self._unqueue()

    # --- drawing

    def _draw(self) -> None:
        """Send what changed since the last time."""
        with self.tab.selection.lock:
            self.commands.rejecting.end_elsewhere()
            self.drawing.leave()  # before a panel shows the next object
            self._draw_panels()
            self.guard.drawn()

    def _draw_panels(self) -> None:
        selection = self.tab.selection
        if self.scene is not None:
            self.scene.draw()
        self.queue.draw()
        obj = selection.object
        self._tour.draw(obj)
        put(self._object_folder, visible=obj is not None)
        broken = obj is not None and obj.problem is not None
        for step, folder in self._folders.items():
            # An unreadable file has nothing to click on.
            put(folder, visible=step == selection.step and not (broken and step in AT_REST))
        if obj is None:
            self._bar.draw(None)
            self.rail.draw(None)
            self.drawing.clear()
            self.pointing.set_page_state()
            return
        self.prepare.show_if_tilted(obj)
        self._header.draw(obj)
        self._bar.draw(obj, self.prepare.noticed(obj))
        self.rail.draw(obj)
        self._follow_prediction(obj)
        self.drawing.draw(obj, touch=self.rail.touch)
        self.comments.draw(obj)
        self.prepare.draw(obj)
        self.annotate.draw(obj)
        self._navigation.look_ahead()
        self.pointing.set_page_state()
        self.joints.draw(obj)
        if selection.step == "Review":  # it reads the history, which no click should pay for
            self.review.draw(obj)
        for step, panel in self._panels:
            if step == selection.step:
                panel.draw(obj)

    def _follow_prediction(self, obj: OpenObject) -> None:
        """Show the joints of a new prediction."""
        prediction = obj.document.prediction
        before, self._prediction = self._prediction, (obj.record.id, prediction)
        if prediction is None:
            return
        if before is None or before[0] != obj.record.id:
            # A file may have been read, with its joints, since the object was opened.
            known = prediction if prediction.file is None else None
        else:
            known = before[1]
        if prediction is not known and self.tab.selection.step in AT_REST:
            self.tab.selection.set_step("Joints")

    def _asset_shown(self, stays: bool) -> None:
        if self.scene is not None:
            self.scene.choice.look_as_before()
        self.prepare.asset_shown()
        self.pointing.begin(same=stays)

    def _tapped(self, event: Any) -> None:
        self.pointing.clicked(event, True)

    def _subject(self) -> Any:
        """The subject of a decision made now, as far as the user can see it."""
        if self.scene is not None and self.scene.in_front:
            return self.scene.subject
        obj = self.tab.selection.object
        if obj is None:
            return None if self._app_state.queue.records() else "an empty queue"
        looked_at = self.review.validation_list.looked_at(obj) is not None
        there = self.drawing.drawn or bool(obj.problem)
        return obj.record.id, there, obj.document.review, looked_at
