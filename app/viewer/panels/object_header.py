"""What stands above every step: state of the object, running jobs, undo, steps, playback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser

from app.server.display_names import in_words
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import STEPS, Step, Tab
from app.viewer.text import plain

_BUSY = {
    "open": "Opening",
    "save": "Saving",
    "predict": "Predicting",
    "room": "Working on the scan",
    "segment": "Segmenting",
    "encode": "Preparing for clicks",
    "tool": "Working",
}
_CHOSEN = "● "


@dataclass(frozen=True)
class HeaderActions:
    """What the header's buttons ask for.

    Attributes:
        cancel: stops the running jobs; called at once, on viser's thread.
        remove: removes an object that can't be read from the queue.
    """

    undo: Callable[[], None]
    redo: Callable[[], None]
    cancel: Callable[[], None]
    remove: Callable[[], None]
    play: Callable[[], None]
    reset_pose: Callable[[], None]


class ObjectHeader:
    """The first widgets of an object; ``name`` gives what it is called."""

    def __init__(self, tab: Tab, actions: HeaderActions, name: Callable[[OpenObject], str]) -> None:
        self._tab, self._name = tab, name
        gui, selection = tab.client.gui, tab.selection
        self._status = gui.add_markdown("")
        self._again = gui.add_button(
            "Try again", icon=viser.Icon.REFRESH, color="gray", visible=False
        )
        self._remove = gui.add_button(
            "Take it off the list", icon=viser.Icon.X, color="gray", visible=False,
            hint="The file stays, and so does what was decided about it",
        )  # fmt: skip
        self._progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._cancel = gui.add_button(
            "Cancel", icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        history = gui.add_button_group("History", ("Undo", "Redo"))
        self._steps = gui.add_button_group("Step", STEPS)
        self._play = gui.add_button_group(
            "Motion", ("Play / stop (Space)", "Reset pose (R)"), visible=False
        )
        self._again.on_click(lambda _: tab.act(lambda: selection.need_object().try_again()))
        self._remove.on_click(lambda _: tab.act(actions.remove))
        # At once: the tab's actions may be waiting for what is to be stopped.
        self._cancel.on_click(lambda _: actions.cancel())
        history.on_click(
            lambda e: tab.act(actions.undo if e.target.value == "Undo" else actions.redo)
        )
        self._steps.on_click(lambda e: self._step_clicked(e.target.value))
        self._play.on_click(
            lambda e: tab.act(
                actions.play if e.target.value.startswith("Play") else actions.reset_pose
            )
        )

    def _step_clicked(self, label: str) -> None:
        step: Step = label.removeprefix(_CHOSEN)  # type: ignore[assignment]
        self._tab.act(lambda: self._tab.selection.set_step(step))

    def draw(self, obj: OpenObject) -> None:
        """Bring the header up to date."""
        selection, doc = self._tab.selection, obj.document
        broken = obj.problem is not None
        put(self._steps, "visible", not (broken and doc.tree is None) and not selection.picking)
        labels = tuple(_CHOSEN * (s == selection.step) + s for s in STEPS)
        put(self._steps, "options", labels)
        put(self._play, "visible", doc.tree is not None and selection.step != "Annotate")
        jobs = dict(obj.busy)  # they end while this is drawn
        stoppable = {"predict", "save", "room"} & set(jobs)
        if jobs.get("tool", (0.0, ""))[0]:  # only what takes seconds says how far it is
            stoppable.add("tool")
        done = max((jobs[w][0] for w in stoppable), default=0.0)
        put(self._status, "content", "\n\n".join(self._lines(obj, jobs, bool(stoppable))))
        put(self._again, "visible", broken)
        put(self._remove, "visible", broken and not self._tab.in_scene)
        put(self._progress, "visible", bool(stoppable))
        put(self._progress, "value", round(100 * done, 1))
        waiting = obj.judging.waiting and not stoppable
        put(self._cancel, "visible", bool(stoppable) or waiting)
        put(self._cancel, "label", "Don't accept yet (Esc)" if waiting else "Cancel")

    def _lines(
        self, obj: OpenObject, jobs: dict[str, tuple[float, str]], has_bar: bool
    ) -> list[str]:
        doc, asset, review = obj.document, obj.asset, obj.document.review
        state = "can't be read" if obj.problem else palette.STATE_WORDS[review.state]
        lines = [f"**{plain(self._name(obj))}** · {state}"]
        shown = [w for w in _BUSY if w in jobs]
        if shown:  # in the place of the size: each click would move the whole panel otherwise
            fraction, message = jobs[shown[0]]
            percent = "" if has_bar or not fraction else f"{100 * fraction:.0f} % "
            message = plain(in_words(doc, message))
            lines.append(f"*{_BUSY[shown[0]]}… {percent}{message}".rstrip() + "*")
        elif asset is not None:
            kind = {"face": "faces", "point": "points"}[asset.element_kind]
            size = (asset.bounds[1] - asset.bounds[0]) * 1000
            lines.append(
                f"{asset.element_count:,} {kind} · {size[0]:.0f} × {size[1]:.0f} × {size[2]:.0f} mm"
            )
        if review.state == "rejected" and self._tab.selection.step != "Review":
            # Whoever mends it wants to know what to mend.
            said = plain((review.reason or "").replace("_", " "))
            said += f": “{plain(review.comment, 300)}”" if review.comment else ""
            lines.append(f"⚠ Rejected by {plain(review.by)}: {said}".rstrip(": "))
        if obj.problem:
            lines.append(f"⚠ {plain(obj.problem, 400)}")
        if doc.prediction_stale:
            lines.append("⚠ The parts changed since the prediction: predict again (P)")
        return lines
