"""Around the picture in every step: the bar of the four steps and the progress of long work, the
object's name, state and problems, the rail of tools, and a tour of a minute.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any, Final

import viser

from app.server.bulk import BulkWork
from app.server.names import display_text, joint_title
from app.server.open_object import OpenObject
from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.input.pointing import Pointing
from app.viewer.panels.widgets import Place, Presses, button, icon, push_button, put
from app.viewer.picture.motion import Motion
from app.viewer.tab import AT_REST, STEPS, Step, Tab, plain
from app.viewer.words import annotate as tool_words
from app.viewer.words import common as words
from app.viewer.words import keys
from app.viewer.words import queue as queue_words
from app.viewer.words.common import TOUR, TOUR_TIP
from model.core.files import static_assets


class ObjectHeader:
    """The first widgets of an object.

    Args:
        name: gives its name.
        remove: removes an object that can't be read from the queue.
        reopen: allows changes of an accepted object again.
        export: asks how to export it.
    """

    def __init__(
        self,
        tab: Tab,
        name: Callable[[OpenObject], str],
        remove: Callable[[], None],
        reopen: Callable[[], None],
        export: Callable[[], None],
    ) -> None:
        self._tab, self._name = tab, name
        gui, selection = tab.client.gui, tab.selection
        self._status = gui.add_markdown("")

        def hidden(label: str, act: Callable[[], None], icon: Any, **look: Any) -> Any:
            return push_button(tab, label, act, icon=icon, visible=False, color="gray", **look)

        self._again = hidden(
            words.RETRY, lambda: selection.need_object().try_again(), viser.Icon.REFRESH
        )
        self._remove = hidden(words.REMOVE, remove, viser.Icon.X, hint=words.REMOVE_HINT)
        self._export = hidden(
            queue_words.EXPORT, export, viser.Icon.PACKAGE_EXPORT, hint=queue_words.EXPORT_HINT
        )
        self._reopen = hidden(words.REOPEN, reopen, viser.Icon.LOCK_OPEN, hint=words.REOPEN_HINT)

    def draw(self, obj: OpenObject) -> None:
        """Bring the header up to date."""
        broken = obj.problem is not None
        put(self._status, content="\n\n".join(self._lines(obj)))
        put(self._again, visible=broken)
        put(self._remove, visible=broken and not self._tab.in_scene)
        accepted = obj.document.review.state == "accepted"
        put(self._export, visible=accepted and obj.document.saved is not None)
        put(self._reopen, visible=accepted)

    def _lines(self, obj: OpenObject) -> list[str]:
        doc, asset, review = obj.document, obj.asset, obj.document.review
        shown = obj.shown_state
        state = words.UNREADABLE if obj.problem else queue_words.SHOWN[shown]
        if shown == "predicted" and doc.joints_file is not None:
            state = words.FROM_FILE
        lines = [f"**{plain(self._name(obj))}** · {state}"]
        if asset is not None:
            size = tuple((asset.bounds[1] - asset.bounds[0]) * 1000)
            lines.append(words.size(asset.element_count, asset.element_kind, size))
        if review.state == "rejected" and self._tab.selection.step != "Review":
            reason = plain((review.reason or "").replace("_", " "))
            comment = plain(review.comment, 300)
            lines.append(words.rejected_by(plain(review.by), reason, comment))
        others = [p for p in obj.present if p.name != self._tab.user]
        if others:
            names = [
                words.works_on_it(plain(p.name)) if p.leased else plain(p.name) for p in others
            ]
            lines.append(words.also_here(", ".join(names)))
        if obj.problem:
            lines.append(words.warning(plain(obj.problem, 400)))
        if doc.prediction_stale:
            new = [joint_title(doc, joint.child) for joint in doc.new_joints]
            lines += [words.warning(f"{plain(t)} {words.NEW_FIXED}") for t in new] or [words.STALE]
        return lines


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
            "step",
            step,
            step,
            content=f"{step}{sign}",
            tip=words.STEP_TIPS[step],
            style=state.replace(" ", "-"),
            pressed=step == self._tab.selection.step,
        )

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
        text, done = words.CHECKING, 0.0
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


_TOOLS = {label: tool for row in tool_words.TOOL_ROWS for tool, label in row.items()}
_ICONS: Final[dict[str, Any]] = {
    "lasso": viser.Icon.LASSO,
    "brush": viser.Icon.BRUSH,
    "cut": viser.Icon.SLICE,
    "rectangle": viser.Icon.MARQUEE_2,
    NEXT_MASK: viser.Icon.LAYERS_DIFFERENCE,
    "connected": viser.Icon.AFFILIATE,
    "grow": viser.Icon.CIRCLE_PLUS,
    "shrink": viser.Icon.CIRCLE_MINUS,
    "same shape": viser.Icon.COPY,
    "mirror": viser.Icon.FLIP_VERTICAL,
    "propose": viser.Icon.SPARKLES,
    "merge": viser.Icon.ARROWS_JOIN,
    "split": viser.Icon.ARROWS_SPLIT,
    "leftovers": viser.Icon.PUZZLE,
}


_VIEWS: Final[dict[str, tuple[Any, str]]] = {
    words.HISTORY_ACTIONS[0]: (viser.Icon.ARROW_BACK_UP, words.UNDO_TIP),
    words.HISTORY_ACTIONS[1]: (viser.Icon.ARROW_FORWARD_UP, words.REDO_TIP),
    words.PLAY: (viser.Icon.PLAYER_PLAY, ""),
    words.RESET_POSE: (viser.Icon.REFRESH, ""),
    tool_words.PREVIEW: (viser.Icon.EYE, tool_words.PREVIEW_HINT),
    tool_words.TOUCH: (viser.Icon.HAND_FINGER, tool_words.TOUCH_HINT),
    keys.MEASURE: (viser.Icon.RULER_2, keys.MEASURE_TIP),
    keys.ISOLATE: (viser.Icon.FOCUS_2, keys.ISOLATE_TIP),
    words.KEYS_BUTTON: (viser.Icon.KEYBOARD, ""),
    TOUR: (viser.Icon.SCHOOL, TOUR_TIP),
}
"""Icon and tip of those that every step has; "" for the label."""


@dataclass(frozen=True)
class RailActions:
    """Callbacks of the icons that every step has, and the object's likeliest category."""

    undo: Callable[[], None]
    redo: Callable[[], None]
    play: Callable[[], None]
    reset_pose: Callable[[], None]
    show_keys: Callable[[], None]
    tour: Callable[[], None]
    isolate: Callable[[], None]
    category: Callable[[], str | None]


class ToolRail:
    """Icons that name themselves and their key under the pointer.

    Attributes:
        touch: whether taps add clicks.
    """

    def __init__(
        self, tab: Tab, presses: Presses, pointing: Pointing, actions: RailActions
    ) -> None:
        self._tab, self._pointing, self._category = tab, pointing, actions.category
        self._place = Place(tab, "tools")
        self.touch = False
        self._view: dict[str, Callable[[], None]] = {
            words.HISTORY_ACTIONS[0]: actions.undo,
            words.HISTORY_ACTIONS[1]: actions.redo,
            words.PLAY: actions.play,
            words.RESET_POSE: actions.reset_pose,
            words.KEYS_BUTTON: actions.show_keys,
            TOUR: actions.tour,
            keys.MEASURE: lambda: pointing.arm("measure"),
            keys.ISOLATE: actions.isolate,
            tool_words.PREVIEW: self.toggle_preview,
            tool_words.TOUCH: self._toggle_touch,
        }
        presses.on("tool", self.use)
        presses.on("mask", lambda step: self._turn(int(step)))
        presses.on("view", lambda label: self._view[label]())

    def use(self, label: str) -> None:
        """Start the tool of an icon on the selected part."""
        selection, pointing = self._tab.selection, self._pointing
        if selection.step != "Annotate":
            selection.set_step("Annotate")
        tool = _TOOLS[label]
        if tool in ("lasso", "brush"):
            pointing.set_tool(tool)  # type: ignore[arg-type]
        elif tool in ("merge", "rectangle", "cut"):
            pointing.arm(tool)  # type: ignore[arg-type]
        elif tool == NEXT_MASK:
            pointing.tools.next_mask(1)
        else:
            request = ToolRequest(tool, selection.part, category=self._category())
            pointing.tools.use(request, label)

    def _turn(self, step: int) -> None:
        """Take a larger mask (1) or a smaller one (-1): Alt and the wheel."""
        if self._tab.selection.object is not None and self._tab.selection.step == "Annotate":
            self._pointing.tools.next_mask(step)

    def toggle_preview(self) -> None:
        """Switch the preview under the pointer on or off."""
        hover = self._pointing.hover
        hover.on = not hover.on
        hover.forget()
        self._tab.invalidate()

    def _toggle_touch(self) -> None:
        self.touch = not self.touch

    def draw(self, obj: OpenObject | None) -> None:
        """Bring the icons up to date; there are none where nothing is open."""
        if obj is None or obj.problem is not None:
            self._place.show("")
            return
        step, pointing = self._tab.selection.step, self._pointing
        groups = [[_view(label) for label in words.HISTORY_ACTIONS]]
        if obj.document.tree is not None and step not in AT_REST:
            groups.append([_view(words.PLAY), _view(words.RESET_POSE)])
        if step == "Annotate":
            groups += [
                [self._tool(label, tool) for tool, label in row.items()]
                for row in tool_words.TOOL_ROWS
            ]
            preview = _view(tool_words.PREVIEW, pointing.hover.on)
            groups.append([preview, _view(tool_words.TOUCH, self.touch)])
        if step != "Prepare":
            measure = _view(keys.MEASURE, pointing.armed == "measure")
            groups.append([measure, _view(keys.ISOLATE, bool(self._tab.selection.hidden))])
        groups.append([_view(words.KEYS_BUTTON), _view(TOUR)])
        self._place.show("".join(f'<div class="aw-group">{"".join(g)}</div>' for g in groups))

    def _tool(self, label: str, tool: str) -> str:
        now = tool in (self._pointing.tool, self._pointing.armed)
        return button(
            "tool",
            label,
            label,
            content=icon(_ICONS[tool]),
            tip=tool_words.TOOL_TIPS[tool],
            pressed=now if tool in ("lasso", "brush", "cut", "rectangle", "merge") else None,
        )


def _view(label: str, pressed: bool | None = None) -> str:
    picture, tip = _VIEWS[label]
    return button("view", label, label, content=icon(picture), tip=tip or label, pressed=pressed)


_LAST = len(words.STEPS) - 1


class Tour:
    """Says what to do next until that is done.

    Args:
        remember: is called once it ended.

    Attributes:
        over: whether this browser has had it.
    """

    def __init__(
        self, tab: Tab, presses: Presses, motion: Motion, remember: Callable[[], None]
    ) -> None:
        self._tab, self._motion, self._remember = tab, motion, remember
        self._place = Place(tab, "tour")
        self._at: int | None = None
        self.over = False
        presses.on("tour next", lambda _: self._go(_LAST if self._at is None else self._at + 1))
        presses.on("tour end", lambda _: self._go(_LAST + 1))

    def begin(self) -> None:
        """Begin, or begin anew."""
        self._at = 0
        self._tab.invalidate()

    def begin_at_first(self, obj: OpenObject) -> None:
        """Begin where the bundled cabinet is open in a browser that hasn't had it."""
        cabinet = static_assets() / "examples" / "cabinet.glb"
        if not self.over and obj.record.path == cabinet and not obj.state.seq:
            self.begin()

    def _go(self, at: int) -> None:
        self._at = at if at <= _LAST else None
        if self._at is None:
            self.over = True
            self._remember()
        self._tab.invalidate()

    def draw(self, obj: OpenObject | None) -> None:
        """Bring it up to date; a step that is done gives way to the next one."""
        while obj is not None and self._at is not None and self._done(self._at, obj):
            self._at += 1
        self._place.show("" if self._at is None else self._text(self._at))

    def _done(self, at: int, obj: OpenObject) -> bool:
        doc, step = obj.document, self._tab.selection.step
        clicked = {p.part for p in doc.prompts if p.part}
        steps = (
            bool(clicked) or doc.tree is not None,
            len(clicked) > 1 or doc.tree is not None,
            doc.tree is not None,
            any(self._motion.q.values()) or step == "Review",
            doc.review.state in ("accepted", "rejected"),
        )
        return at < len(steps) and steps[at]

    def _text(self, at: int) -> str:
        last = at == _LAST
        more = "" if last else button("tour next", "", words.NEXT, style="aw-small")
        end = button("tour end", "", words.END if last else words.SKIP, style="aw-small")
        place = words.place(at + 1, len(words.STEPS))
        return f"<p>{escape(words.STEPS[at])}</p><div><small>{place}</small>{more}{end}</div>"
