"""What keys and buttons ask for, in an object as in the scene around it."""

from __future__ import annotations

import datetime
from html import escape
from typing import TYPE_CHECKING, Any

from app.server.accepting import accept, take_back
from app.server.pointer_messages import tell_page
from app.server.validating import LookFirstError
from app.viewer.input.keys import KEYS
from model.core.errors import CommandError
from sessions import commands as cmd
from sessions.review import RejectReason

if TYPE_CHECKING:
    from app.server.open_object import OpenObject
    from app.viewer.client_app import ClientApp

_SHEET = (
    "display:grid;grid-template-columns:max-content 1fr;gap:0.05em 1.2em;"
    "font-size:0.82em;line-height:1.32"
)


class Commands:
    """One tab's commands. Where no object is open they are for the chosen ones of the scene."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._sheet: Any = None

    # --- decisions

    def undo(self) -> None:
        """Take back the last decision."""
        app = self._app
        if app.overview is not None:
            app.overview.undo()
        elif app.need_object().state.can_undo:
            app.do(cmd.Undo())
        else:
            app.notify("Nothing to undo", "", "gray")

    def redo(self) -> None:
        """Do again what was taken back."""
        app = self._app
        if app.overview is not None:
            app.overview.redo()
        elif app.need_object().state.can_redo:
            app.do(cmd.Redo())
        else:
            app.notify("Nothing to redo", "", "gray")

    def predict(self) -> None:
        """Ask for joints."""
        self._app.need_object().predict(self._app.who)

    def predict_here(self) -> None:
        """Ask this machine for joints where the backend is away."""
        self._app.need_object().predict(self._app.who, here=True)

    def cancel(self) -> None:
        """Stop what runs, and don't accept what waits for it. May be called on any thread."""
        obj = self._app.object
        if obj is not None:
            self.take_back()
            for what in ("predict", "save", "segment", "room", "tool"):
                obj.jobs.cancel(what)

    def take_back(self) -> None:
        """Don't accept the object once its joints are judged. May be called on any thread."""
        obj = self._app.object
        if obj is not None and take_back(obj):
            self._app.review_panel.refused(obj)

    def accept(self) -> None:
        """Accept the object; its asset is written first."""
        app = self._app
        app.rejecting.cancel()
        if app.overview is not None:
            app.overview.accept()
            return
        app.set_stage("Review")  # where a reason is asked for, and the next object follows
        panel = app.review_panel
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        obj = app.need_object()
        if obj.document.review.state == "accepted":
            app.notify("Accepted", "It is already; Reopen lets it be changed", "gray")
            return

        def refused(error: CommandError) -> None:
            app.act(lambda: self._refused(obj, error))

        try:
            with panel.deciding():
                accept(
                    obj, panel.comment_text, app.who, now, panel.override_text,
                    looked_at=panel.gate.looked_at(obj), refused=refused,
                )  # fmt: skip
        except LookFirstError as error:
            self._refused(obj, error)

    def _refused(self, obj: OpenObject, error: CommandError) -> None:
        """Say why, and show what the gate wants to be looked at."""
        app, name = self._app, self._app.app_state.display_name(obj.record)
        app.review_panel.refused(obj)
        if isinstance(error, LookFirstError) and app.object is obj:
            app.set_stage("Review")
            app.review_panel.gate.show_worst()
            app.notify("Look at it first", str(error), "yellow")
        elif app.object is not obj and obj.held:
            app.notify("Look again", f"{name}: {obj.held}", "yellow", seconds=None)
        else:
            app.notify("Not accepted", f"{name}: {error}", "yellow")

    def about(self) -> tuple[Any, ...]:
        """What a decision made now would be about."""
        scene, obj = self._app.overview, self._app.object
        if scene is not None:
            return "scene", scene.selected
        return "object", None if obj is None else obj.record.id

    def reject(self) -> None:
        """Ask why the object goes back to its annotator."""
        app = self._app
        if app.overview is not None:
            app.overview.need_work()
        else:
            app.need_object()
            app.set_stage("Review")
        app.rejecting.ask()

    def number(self, number: int) -> None:
        """A number key: the reason that is asked for, else the part for the next clicks."""
        if self._app.rejecting.asking:
            self._app.rejecting.answer(number)
        else:
            self._app.choose_part(number)

    def answer(self, number: int) -> None:
        """Shift and a number: what a part, or with 0 the object, is. What came of it is told."""
        app = self._app
        if app.object is None or app.picking_out:
            return
        panel = {"Annotate": app.annotate_panel, "Joints": app.joints_panel}.get(app.stage)
        said = "Names are given in the steps before" if panel is None else panel.answer(number)
        if said:
            tell_page(app.client, said=said)

    def reject_because(self, reason: RejectReason) -> None:
        """Send the object back to its annotator."""
        app = self._app
        if app.overview is not None:
            app.overview.reject(reason)
            return
        panel, name = app.review_panel, app.app_state.display_name(app.need_object().record)
        with panel.deciding():
            app.do(cmd.Reject(reason, panel.comment_text))
        panel.clear()
        # The next object is shown by now.
        app.notify("Rejected", f"{name}: it is back with its annotator", "orange")

    # --- what is looked at

    def go_on(self) -> None:
        """To the object that wants a decision most, after one was made."""
        app = self._app
        if app.app_state.scene is not None:
            app.in_scene.leave()
            app.in_scene.step(1)
            return
        app_state, current = app.app_state, app.need_object().record
        waiting = [
            r
            for r in app_state.queue.records()
            if r.id == current.id or not app_state.is_accepting(r.id)
        ]
        again = {r.id for r in waiting if app_state.on_hold(r) or app_state.was_interrupted(r)}
        following = app_state.review_order.next(waiting, current.id, app.skipped, again)
        if following is None:
            return
        app.open(following)
        if app.need_object().document.tree is not None:
            app.set_stage("Review")

    def next_choice(self) -> None:
        """The next mask for the part, the next joint, or the next one to look at (Tab)."""
        app = self._app
        if app.stage == "Annotate":
            app.annotate_panel.next_mask(1)
        elif app.stage == "Review":
            app.review_panel.gate.show_next()
        else:
            self.next_joint()

    def choice_before(self) -> None:
        """The mask before this one (Shift+Tab)."""
        if self._app.stage == "Annotate":
            self._app.annotate_panel.next_mask(-1)

    def next_joint(self) -> None:
        """The next moving joint of the tree."""
        app = self._app
        tree = app.need_object().document.tree
        if tree is None or not tree.joints:
            return
        children = [j.child for j in tree.joints]
        at = children.index(app.child) if app.child in children else -1
        app.choose_joint(children[(at + 1) % len(children)])
        if app.stage == "Annotate":
            app.set_stage("Joints")

    def choose_joint_at(self, element: int) -> None:
        """The joint whose part holds an element of the source."""
        part = self._app.need_object().part_of(element)
        if part is not None:
            self.choose_joint_of(part)

    def choose_joint_of(self, part: int | None) -> None:
        """The joint that moves a part, where there is one."""
        tree = self._app.need_object().document.tree
        link = f"link_{part}"
        if tree is None or part is None:
            said = "Nothing there" if part is None else "No joints yet"
        elif link not in tree.joint_of:
            said = "The base doesn't move"
        else:
            self._app.choose_joint(link)
            return
        tell_page(self._app.client, said=said)

    def play_all(self) -> None:
        """Start or stop moving all the joints, of a scene those of all its objects."""
        if self._app.overview is not None:
            self._app.overview.play_all()
        else:
            self._app.motion.play()

    def play(self) -> None:
        """Start or stop moving all the joints of the object."""
        if self._app.overview is not None:
            self._app.overview.play()
        else:
            self._app.motion.play()

    def frame(self) -> None:
        """Aim at the open object, at the chosen one of the scene, or at all of it."""
        overview = self._app.overview
        if overview is None:
            self._app.scene.frame_camera()
        else:
            chosen = overview.selected
            overview.picture.frame(None if chosen is None else [chosen])

    def show_keys(self) -> None:
        """The sheet of keys, over the picture."""
        if self.close_keys():
            return
        gui = self._app.client.gui
        self._sheet = gui.add_modal("Keys and mouse")
        with self._sheet:
            close = gui.add_button("Close (Esc)", color="gray")
            rows = "".join(f"<b>{escape(k)}</b><span>{escape(v)}</span>" for k, v in KEYS)
            gui.add_html(f'<div style="{_SHEET}">{rows}</div>')

        @close.on_click
        def _(_: Any) -> None:
            self.close_keys()

    def close_keys(self) -> bool:
        """Take the sheet away; whether it was there."""
        sheet, self._sheet = self._sheet, None
        if sheet is not None:
            sheet.close()
        return sheet is not None
