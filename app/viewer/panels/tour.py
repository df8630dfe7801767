"""A tour of a minute, at the first visit on the bundled cabinet, and whenever it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from app.server.open_object import OpenObject
from app.viewer.panels.widgets import Place, Presses, button
from app.viewer.picture.motion import Motion
from app.viewer.tab import Tab
from app.viewer.words import common as words
from model.core.files import static_assets

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
