"""The widgets above every step: state of the object, running jobs, undo, steps, playback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser

from app.server.display_names import display_text, joint_title
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.tab import AT_REST, STEPS, Step, Tab
from app.viewer.text import plain
from app.viewer.words import common as words
from app.viewer.words.prepare import NOTICED


@dataclass(frozen=True)
class HeaderActions:
    """Callbacks of the header's buttons.

    Attributes:
        reopen: allows changes of an accepted object again.
        cancel: stops the running jobs; called at once, on viser's thread.
        remove: removes an object that can't be read from the queue.
    """

    undo: Callable[[], None]
    redo: Callable[[], None]
    cancel: Callable[[], None]
    remove: Callable[[], None]
    play: Callable[[], None]
    reset_pose: Callable[[], None]
    reopen: Callable[[], None]


class ObjectHeader:
    """The first widgets of an object; ``name`` gives its name."""

    def __init__(self, tab: Tab, actions: HeaderActions, name: Callable[[OpenObject], str]) -> None:
        self._tab, self._name = tab, name
        gui, selection = tab.client.gui, tab.selection
        self._status = gui.add_markdown("")
        self._again = gui.add_button(
            words.RETRY, icon=viser.Icon.REFRESH, color="gray", visible=False
        )
        self._remove = gui.add_button(
            words.REMOVE, icon=viser.Icon.X, color="gray", visible=False,
            hint=words.REMOVE_HINT,
        )  # fmt: skip
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._cancel = gui.add_button(
            words.CANCEL, icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        self._reopen = gui.add_button(
            words.REOPEN, icon=viser.Icon.LOCK_OPEN, visible=False, hint=words.REOPEN_HINT
        )
        history = gui.add_button_group(words.EDIT, words.HISTORY_ACTIONS)
        self._steps = gui.add_button_group(words.STEP, STEPS)
        self._play = gui.add_button_group(words.PLAYBACK, words.PLAYBACK_ACTIONS, visible=False)
        self._again.on_click(lambda _: tab.act(lambda: selection.need_object().try_again()))
        self._remove.on_click(lambda _: tab.act(actions.remove))
        self._reopen.on_click(lambda _: tab.act(actions.reopen))
        # At once: the tab's actions may be waiting for what is to be stopped.
        self._cancel.on_click(lambda _: actions.cancel())
        history.on_click(
            lambda e: tab.act(
                actions.undo if e.target.value == words.HISTORY_ACTIONS[0] else actions.redo
            )
        )
        self._steps.on_click(lambda e: self._step_clicked(e.target.value))
        self._play.on_click(
            lambda e: tab.act(
                actions.play if e.target.value == words.PLAYBACK_ACTIONS[0] else actions.reset_pose
            )
        )

    def _step_clicked(self, label: str) -> None:
        step: Step = label.removeprefix(words.CHOSEN).removesuffix(NOTICED)  # type: ignore[assignment]
        self._tab.act(lambda: self._tab.selection.set_step(step))

    def draw(self, obj: OpenObject, noticed: bool) -> None:
        """Bring the header up to date; ``noticed`` where the object needs preparing."""
        selection, doc = self._tab.selection, obj.document
        broken = obj.problem is not None
        put(self._steps, "visible", not (broken and doc.tree is None) and not selection.picking)
        steps = STEPS[1:] if self._tab.in_scene else STEPS
        dots = {"Prepare": NOTICED * noticed}
        labels = tuple(words.CHOSEN * (s == selection.step) + s + dots.get(s, "") for s in steps)
        put(self._steps, "options", labels)
        put(self._play, "visible", doc.tree is not None and selection.step not in AT_REST)
        jobs = dict(obj.busy)  # they end while this is drawn
        stoppable = {"open", "predict", "save", "room"} & set(jobs)
        if selection.step == "Prepare":
            stoppable |= {"prepare"} & set(jobs)
        if jobs.get("tool", (0.0, ""))[0]:  # only long tools report progress
            stoppable.add("tool")
        done = max((jobs[w][0] for w in stoppable), default=0.0)
        put(self._status, "content", "\n\n".join(self._lines(obj, jobs, bool(stoppable))))
        put(self._again, "visible", broken)
        put(self._remove, "visible", broken and not self._tab.in_scene)
        put(self._reopen, "visible", doc.review.state == "accepted")
        put(self._progress, "visible", bool(stoppable))
        put(self._progress, "value", round(100 * done, 1))
        waiting = obj.validation.acceptance_waits and not stoppable
        put(self._cancel, "visible", bool(stoppable) or waiting)
        put(self._cancel, "label", words.CANCEL_ACCEPTANCE if waiting else words.CANCEL)

    def _lines(
        self, obj: OpenObject, jobs: dict[str, tuple[float, str]], has_bar: bool
    ) -> list[str]:
        doc, asset, review = obj.document, obj.asset, obj.document.review
        state = words.UNREADABLE if obj.problem else words.STATES[review.state]
        if review.state == "predicted" and doc.joints_file is not None:
            state = words.FROM_FILE
        lines = [f"**{plain(self._name(obj))}** · {state}"]
        shown = [w for w in words.JOBS if w in jobs]
        if shown:  # in the place of the size: each click would move the whole panel otherwise
            fraction, message = jobs[shown[0]]
            percent = "" if has_bar or not fraction else f"{100 * fraction:.0f} % "
            detail = "" if shown[0] == "encode" else plain(display_text(doc, message))
            lines.append(f"*{words.job(shown[0], percent, detail)}*")
        elif asset is not None:
            size = tuple((asset.bounds[1] - asset.bounds[0]) * 1000)
            lines.append(words.size(asset.element_count, asset.element_kind, size))
        if review.state == "rejected" and self._tab.selection.step != "Review":
            reason = plain((review.reason or "").replace("_", " "))
            comment = plain(review.comment, 300)
            lines.append(words.rejected_by(plain(review.by), reason, comment))
        if obj.problem:
            lines.append(words.warning(plain(obj.problem, 400)))
        if doc.prediction_stale:
            new = [joint_title(doc, joint.child) for joint in doc.new_joints]
            lines += [words.warning(f"{plain(t)} {words.NEW_FIXED}") for t in new] or [words.STALE]
        return lines
