"""The widgets above every step: name, state and size of the object, and its problems."""

from __future__ import annotations

from collections.abc import Callable

import viser

from app.server.display_names import joint_title
from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.text import plain
from app.viewer.words import common as words


class ObjectHeader:
    """The first widgets of an object.

    Args:
        name: gives its name.
        remove: removes an object that can't be read from the queue.
        reopen: allows changes of an accepted object again.
    """

    def __init__(
        self,
        tab: Tab,
        name: Callable[[OpenObject], str],
        remove: Callable[[], None],
        reopen: Callable[[], None],
    ) -> None:
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
        self._reopen = gui.add_button(
            words.REOPEN, icon=viser.Icon.LOCK_OPEN, visible=False, hint=words.REOPEN_HINT
        )
        self._again.on_click(lambda _: tab.act(lambda: selection.need_object().try_again()))
        self._remove.on_click(lambda _: tab.act(remove))
        self._reopen.on_click(lambda _: tab.act(reopen))

    def draw(self, obj: OpenObject) -> None:
        """Bring the header up to date."""
        broken = obj.problem is not None
        put(self._status, "content", "\n\n".join(self._lines(obj)))
        put(self._again, "visible", broken)
        put(self._remove, "visible", broken and not self._tab.in_scene)
        put(self._reopen, "visible", obj.document.review.state == "accepted")

    def _lines(self, obj: OpenObject) -> list[str]:
        doc, asset, review = obj.document, obj.asset, obj.document.review
        state = words.UNREADABLE if obj.problem else words.STATES[review.state]
        if review.state == "predicted" and doc.joints_file is not None:
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
