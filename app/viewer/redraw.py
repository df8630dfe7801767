"""Bringing one tab's screen up to date with the state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from app.server.display_names import in_words, moved_part
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.picture.joint_marks import AxisMark, axis_length
from app.viewer.text import plain
from model.core.joint import Joint
from model.segmentation.prompts import Click
from sessions.document import Document

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

STAGES = ("Annotate", "Joints", "Review")
_BUSY = {
    "open": "Opening",
    "save": "Saving",
    "predict": "Predicting",
    "room": "Working on the scan",
    "segment": "Segmenting",
    "encode": "Preparing for clicks",
    "tool": "Working",
}


class Redraw:
    """Draws what changed, on the tab's draw thread.

    Attributes:
        asset: the picture that was sent last, or None.
    """

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self.asset: Any = None
        self._shown: int | None = None
        self._seen: tuple[int, Any] | None = None

    def draw(self) -> None:
        """Send what changed since the last time."""
        self._draw()
        self._app.seen.drawn()

    def _draw(self) -> None:
        app = self._app
        if app.app_state.scene is None:
            app.queue_panel.draw()
        else:
            app.in_scene.draw()
            put(app.in_scene.folder, "visible", app.object is None)
        put(app.object_folder, "visible", app.object is not None)
        broken = app.object is not None and app.object.problem is not None
        for stage, folder in app.folders.items():
            # There is nothing to click on where the file can't be opened.
            put(folder, "visible", stage == app.stage and not (broken and stage == "Annotate"))
        empty = broken and app.object is not None and app.object.document.tree is None
        put(app.stage_buttons, "visible", not empty and not app.picking_out)
        labels = tuple(("● " if s == app.stage else "") + s for s in STAGES)
        if app.stage_buttons.options != labels:
            app.stage_buttons.options = labels
        obj = app.object
        if obj is None:
            if self.asset is not None:
                self._clear()
                app.pointing.tell_page()
            return
        has_joints = obj.document.tree is not None and app.stage != "Annotate"
        put(app.play_buttons, "visible", has_joints)
        self._draw_status(obj)
        self._follow_prediction(obj)
        if obj.asset is not None and obj.asset is not self.asset:
            before = self.asset if self._shown == obj.record.id else None
            stays = before is not None and np.array_equal(before.bounds, obj.asset.bounds)
            app.scene.show_asset(obj.asset, keep_view=stays)
            self._shown = obj.record.id
            if app.app_state.scene is not None:
                app.in_scene.look_as_before()
            self.asset = obj.asset
            app.motion.forget_scene()
            app.pointing.begin(same=stays)
        elif obj.asset is None and self._shown is not None and not self._read_again(obj):
            self._clear()
        self._draw_scene(obj)
        app.annotate_panel.draw(obj)
        app.source_panel.draw(obj)
        app.pointing.tell_page()
        app.joints_panel.draw(obj)
        if app.stage == "Review":  # it reads the history, which no click should pay for
            app.review_panel.draw(obj)

    def _clear(self) -> None:
        """Take the picture away: it is of another object, or of a file that can't be read now."""
        self._app.scene.clear()
        self.asset = self._shown = None
        self._app.motion.forget_scene()

    def _read_again(self, obj: OpenObject) -> bool:
        """Whether what is shown is the same object, whose faces are numbered anew just now."""
        return self._shown == obj.record.id and not obj.problem

    def _follow_prediction(self, obj: OpenObject) -> None:
        """A new prediction is what the person waited for: show its joints."""
        prediction = obj.document.prediction
        before, self._seen = self._seen, (obj.record.id, prediction)
        if prediction is None or before is None or before[0] != obj.record.id:
            return
        if prediction is not before[1] and self._app.stage == "Annotate":
            self._app.set_stage("Joints")

    def _draw_status(self, obj: OpenObject) -> None:
        doc, asset = obj.document, obj.asset
        desk = self._app.app_state.scene
        name = (None if desk is None else self._app.in_scene.inside) or obj.record.name
        stands = "can't be read" if obj.problem else palette.STATE_WORDS[doc.review.state]
        lines = [f"**{plain(name)}** · {stands}"]
        jobs = dict(obj.busy)  # they end while this is drawn
        shown = [w for w in _BUSY if w in jobs]
        stoppable = {"predict", "save", "room"} & set(jobs)
        if jobs.get("tool", (0.0, ""))[0]:  # only what takes seconds says how far it is
            stoppable.add("tool")
        done, busy = max((jobs[w][0] for w in stoppable), default=0.0), ""
        if shown:
            fraction, message = jobs[shown[0]]
            percent = "" if stoppable or not fraction else f"{100 * fraction:.0f} % "
            message = plain(in_words(doc, message))
            busy = f"*{_BUSY[shown[0]]}… {percent}{message}".rstrip() + "*"
        if busy:  # in the place of the size: each click would move the whole panel otherwise
            lines.append(busy)
        elif asset is not None:
            kind = {"face": "faces", "point": "points"}[asset.element_kind]
            size = (asset.bounds[1] - asset.bounds[0]) * 1000
            lines.append(
                f"{asset.element_count:,} {kind} · {size[0]:.0f} × {size[1]:.0f} × {size[2]:.0f} mm"
            )
        review = doc.review
        if review.state == "rejected" and self._app.stage != "Review":
            # Whoever mends it wants to know what to mend.
            said = plain((review.reason or "").replace("_", " "))
            said += f": “{plain(review.comment, 300)}”" if review.comment else ""
            lines.append(f"⚠ Rejected by {plain(review.by)}: {said}".rstrip(": "))
        if obj.problem:
            lines.append(f"⚠ {plain(obj.problem, 400)}")
        if doc.prediction_stale:
            lines.append("⚠ The parts changed since the prediction: predict again (P)")
        put(self._app.status, "content", "\n\n".join(lines))
        put(self._app.again_button, "visible", obj.problem is not None)
        put(self._app.off_button, "visible", obj.problem is not None and desk is None)
        put(self._app.progress, "visible", bool(stoppable))
        put(self._app.progress, "value", round(100 * done, 1))
        waiting = obj.judging.waiting and not stoppable
        put(self._app.cancel_button, "visible", bool(stoppable) or waiting)
        put(self._app.cancel_button, "label", "Don't accept yet (Esc)" if waiting else "Cancel")

    def _draw_scene(self, obj: OpenObject) -> None:
        app, doc = self._app, obj.document
        if obj.asset is None:
            return
        moving = app.stage != "Annotate" and doc.tree is not None
        payloads = obj.part_payloads() if moving else None
        app.hidden &= {p.id for p in doc.parts}  # a part that takes the number of one is seen
        app.scene.show_labels(obj.labels, app.hidden)
        clicks = [
            (i, p)
            for i, p in enumerate(doc.prompts)
            if isinstance(p, Click) and p.part not in app.hidden
        ]
        app.scene.show_prompts(clicks, visible=app.stage == "Annotate")
        app.scene.show_parts(payloads, moving, app.hidden)
        app.scene.marks.show_axes(self._axis_marks(obj, doc) if moving else ())
        choosing = moving and app.stage == "Joints"
        app.scene.marks.show_directions(obj.asset.bounds[0] if choosing else None)
        app.scene.marks.show_contacts(obj.checks, doc.tree if moving else None)
        app.motion.pose()
        app.motion.draw_gizmo()
        pad = app.scene.touch
        new = app.scene.show_touch_pad(app.touch_wanted)
        if new is not None and new is not pad:
            new.on_click(lambda event: app.pointing.clicked(event, True))

    def _axis_marks(self, obj: OpenObject, doc: Document) -> list[AxisMark]:
        assert doc.tree is not None and obj.asset is not None
        payloads = obj.part_payloads()
        marks = []
        for joint in doc.tree.joints:
            if not joint.moves:
                continue
            chosen = joint.child == self._app.child
            moved = moved_part(doc.tree, joint.child)
            length = axis_length(payloads, moved, joint.axis, obj.asset.diagonal)
            part = moved.removeprefix("link_")
            color = palette.part_color(int(part)) if part.isdigit() else palette.GHOST
            marks.append(
                AxisMark(
                    joint.name,
                    joint.parent,
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
                        predicted.parent,
                        predicted.origin,
                        predicted.axis,
                        length,
                        palette.GHOST,
                        False,
                    )
                )
        return marks


def _moved(a: Joint, b: Joint) -> bool:
    off = np.abs(np.subtract(a.origin, b.origin)).max() > 1e-9
    return bool(off or np.abs(np.subtract(a.axis, b.axis)).max() > 1e-9)
