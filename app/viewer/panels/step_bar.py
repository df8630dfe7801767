"""The bar of the four steps above the picture, and the progress of long work below it."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from app.server.bulk import BulkWork
from app.server.display_names import display_text
from app.server.open_object import OpenObject
from app.viewer.panels.markup import Place, Presses, button
from app.viewer.tab import STEPS, Step, Tab
from app.viewer.words import common as words

_SIGNS = {"": "", words.DONE: "✓", words.ATTENTION: "●", words.REFUSED: "✕"}


class StepBar:
    """Steps of the open object and progress of its jobs, each in a place of its own."""

    def __init__(
        self, tab: Tab, presses: Presses, bulk: BulkWork, cancel: Callable[[], None]
    ) -> None:
        """Make both; ``cancel`` stops the jobs of the open object."""
        self._tab, self._bulk = tab, bulk
        self._steps, self._progress = Place(tab, "steps"), Place(tab, "progress")
        presses.on("step", tab.selection.set_step)  # type: ignore[arg-type]
        # At once: the tab's actions may be waiting for what is to be stopped.
        presses.on("cancel", lambda _: cancel(), at_once=True)
        presses.on("cancel bulk", lambda _: bulk.cancel(), at_once=True)

    def draw(self, obj: OpenObject | None, noticed: bool = False) -> None:
        """Bring both up to date; ``noticed`` where the object needs preparing."""
        selection = self._tab.selection
        broken = obj is not None and obj.problem is not None and obj.document.tree is None
        if obj is None or broken or selection.picking:
            self._steps.show("")
        else:
            steps = STEPS[1:] if self._tab.in_scene else STEPS
            self._steps.show("".join(self._button(s, _state(s, obj, noticed)) for s in steps))
        many = self._bulk.progress
        if many is not None:
            share, text = many
            self._progress.show(_progress(text, share, ("cancel bulk", words.CANCEL)))
        else:
            self._progress.show("" if obj is None else self._running(obj))

    def _button(self, step: Step, state: str) -> str:
        sign = f'<i class="aw-sign" title="{state}">{_SIGNS[state]}</i>' if state else ""
        return button(
            "step", step, step, content=f"{step}{sign}", tip=words.STEP_TIPS[step],
            style=state.replace(" ", "-"), pressed=step == self._tab.selection.step,
        )  # fmt: skip

    def _running(self, obj: OpenObject) -> str:
        """Running job, its progress, and the button that stops it."""
        jobs = dict(obj.busy)  # they end while this is drawn
        stoppable = {"open", "predict", "save", "room"} & set(jobs)
        if self._tab.selection.step == "Prepare":
            stoppable |= {"prepare"} & set(jobs)
        if jobs.get("tool", (0.0, ""))[0]:  # only long tools report progress
            stoppable.add("tool")
        shown = next((w for w in words.JOBS if w in stoppable), None)
        shown = shown or next((w for w in words.JOBS if w in jobs), None)
        waiting = obj.validation.acceptance_waits and not stoppable
        if shown is None and not waiting:
            return ""
        text, done = "", 0.0
        if shown is not None:
            done, message = jobs[shown]
            detail = "" if shown == "encode" else display_text(obj.document, message)
            text = words.job(shown, f"{100 * done:.0f} % " if done else "", detail)
        label = words.CANCEL_ACCEPTANCE if waiting else words.CANCEL
        stop = ("cancel", label) if stoppable or waiting else None
        return _progress(text, done if shown else None, stop)


def _progress(text: str, done: float | None, stop: tuple[str, str] | None) -> str:
    """A text, a bar where it is known how much is ``done`` (0..1), and the button that stops."""
    cancel = "" if stop is None else button(stop[0], "", stop[1], style="aw-small")
    bar = "" if done is None else f'<div style="width:{100 * done:.0f}%"></div>'
    return f'<span>{escape(text[:90])}</span>{cancel}<div class="aw-bar">{bar}</div>'


def _state(step: Step, obj: OpenObject, noticed: bool) -> str:
    """Displayed state of a step; "" for none."""
    doc = obj.document
    if step == "Prepare":
        return words.ATTENTION if noticed else ""
    if step == "Annotate":
        return words.DONE if doc.segmentation is not None and len(doc.parts) > 1 else ""
    if step == "Joints":
        if doc.tree is None:
            return ""
        return words.ATTENTION if doc.prediction_stale else words.DONE
    return {"accepted": words.DONE, "rejected": words.REFUSED}.get(doc.review.state, "")
