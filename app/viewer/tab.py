"""State that the screens of one browser tab share: browser, user, selection.

This is the lowest layer of the viewer; it knows no panel. viser's callbacks only queue actions
here, so its event loop never waits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol

import viser

from app.server.display_names import display_text, moved_part
from app.server.open_object import OpenObject
from app.server.pointer_messages import set_page_state
from app.viewer.notes import Notes
from app.viewer.tab_threads import TabThreads
from app.viewer.words import common as words
from model.core.errors import ArtiworldError
from model.core.joint import Joint
from model.segmentation.prompts import MAX_PARTS
from sessions import commands as cmd
from sessions.accounts import Account

Step = Literal["Prepare", "Annotate", "Joints", "Review"]
STEPS: tuple[Step, ...] = ("Prepare", "Annotate", "Joints", "Review")
AT_REST: tuple[Step, ...] = ("Prepare", "Annotate")
"""Steps in which no joint moves."""


class Panel(Protocol):
    """Widgets that show something of the open object."""

    def draw(self, obj: OpenObject) -> None:
        """Bring the widgets up to date; send nothing where nothing changed."""
        ...


class Selection:
    """Open object and selection of one tab.

    Args:
        changed: called after each change; draws.
        nothing_open: says that no object is open, for errors.

    Attributes:
        object: the open object, or None.
        part: the part that the next clicks belong to.
        child: child link of the joint that the editor shows, or None.
        step: the current step.
        hidden: parts that aren't drawn.
        picking: whether the object is open to have another one picked out of it.
    """

    def __init__(self, changed: Callable[[], None], nothing_open: str) -> None:
        self.object: OpenObject | None = None
        self.part = 1
        self.child: str | None = None
        self.step: Step = "Annotate"
        self.hidden: frozenset[int] = frozenset()
        self.picking = False
        self._changed = changed
        self._nothing_open = nothing_open
        self._open_listeners: list[Callable[[], None]] = []
        self._step_listeners: list[Callable[[Step], None]] = []

    def on_open(self, listener: Callable[[], None]) -> None:
        """Call ``listener`` before another object, or none, is shown."""
        self._open_listeners.append(listener)

    def on_step(self, listener: Callable[[Step], None]) -> None:
        """Call ``listener`` with the step before it begins."""
        self._step_listeners.append(listener)

    def open(self, obj: OpenObject | None) -> None:
        """Select another object, or none."""
        for listener in self._open_listeners:
            listener()
        self.object, self.child = obj, None
        if obj is not None:
            self.part, self.hidden = 1, frozenset()
        self._changed()

    def need_object(self) -> OpenObject:
        """The open object.

        Raises:
            ArtiworldError: where none is open.
        """
        if self.object is None:
            raise ArtiworldError(self._nothing_open)
        return self.object

    def set_step(self, step: Step) -> None:
        """Begin a step."""
        for listener in self._step_listeners:
            listener(step)
        self.step = step
        self._changed()

    def choose_part(self, part: int) -> None:
        """Choose the part that the next clicks belong to; a click makes a new one."""
        if not 0 <= part < MAX_PARTS:
            return
        self.need_object()
        if self.step != "Annotate":
            self.set_step("Annotate")
        self.part = part
        self._changed()

    def choose_joint(self, child: str) -> None:
        """Choose the joint that the editor shows."""
        self.child = child
        self._changed()

    @property
    def worked_on(self) -> int:
        """The selected part; in the steps after annotating that of the selected joint."""
        joint = None if self.step == "Annotate" else self.joint
        if joint is not None:
            tree = self.need_object().document.tree
            assert tree is not None
            digits = moved_part(tree, joint.child).removeprefix("link_")
            return int(digits) if digits.isdigit() else self.part
        return self.part

    @property
    def joint(self) -> Joint | None:
        """The selected joint."""
        tree = None if self.object is None else self.object.document.tree
        return None if tree is None or self.child is None else tree.joint_of.get(self.child)


class Tab:
    """The browser, the user and the selection of one tab.

    Args:
        user: the name that signs decisions; without an account the browser may give another one.
        account: who is logged in; None where nobody has to log in.
        in_scene: whether the objects belong to a scene, else to the queue.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        user: str,
        *,
        in_scene: bool = False,
        account: Account | None = None,
    ) -> None:
        self.client = client
        self.user = user
        self.account = account
        self.in_scene = in_scene
        self.selection = Selection(self.invalidate, words.need_object(in_scene))
        self._threads = TabThreads(f"tab-{client.client_id}", self.notify)
        self._notes = Notes(client)

    @property
    def submits(self) -> bool:
        """True if the user submits objects, and others decide about them."""
        return self.account is not None and self.account.role == "annotator"

    def start(self, draw: Callable[[], None]) -> None:
        """Begin to carry out actions and to draw."""
        self._threads.start(draw)

    def close(self) -> bool:
        """End both; False where the tab is closed already."""
        if self._threads.closed:
            return False
        self._threads.close()
        return True

    @property
    def drawings(self) -> int:
        """Number of updates of the screen."""
        return self._threads.drawings

    def act(self, action: Callable[[], None]) -> None:
        """Carry out ``action`` after those before it, off viser's threads."""
        self._threads.act(action)

    def on_update(self, handle: Any, action: Callable[[], None]) -> None:
        """Carry out ``action`` when the user changes a widget, not when we do."""
        handle.on_update(lambda event: self.act(action) if event.client is not None else None)

    def invalidate(self) -> None:
        """Draw again soon."""
        self._threads.invalidate()

    def notify(
        self, title: str, body: str, color: Any = "blue", *, elsewhere: bool = False
    ) -> None:
        """Show a note for some seconds. Hints and refusals (gray, yellow) end with the state of
        the open object, unless they are about something ``elsewhere``."""
        if self._threads.closed:
            return
        if not body:
            self.say(title)
            return
        obj = self.selection.object  # another thread may close it
        body = body if obj is None else display_text(obj.document, body)
        about_state = color in ("gray", "yellow") and not elsewhere
        seconds = 10.0 if color in ("red", "yellow") else 5.0
        if about_state and color == "yellow":
            seconds = 60.0  # to be answered; it ends with the state
        reason = self._reason if about_state else None
        self._notes.show(title, body[:400], color, seconds, reason)

    @property
    def _reason(self) -> Any:
        """Subject of hints and refusals: the open object and its review state. A click or an answer
        doesn't end a hint: people click on before they have read it."""
        obj = self.selection.object
        return obj and (obj.record.id, obj.document.review.state)

    def end_notes(self) -> None:
        """End the hints and refusals that are about another object, or an earlier review."""
        self._notes.end_others(self._reason)

    def say(self, text: str) -> None:
        """Show a line below the picture for a moment."""
        set_page_state(self.client, said=text)

    def do(self, command: cmd.Command) -> None:
        """Carry out one decision about the open object."""
        self.selection.need_object().do(command, self.user)
