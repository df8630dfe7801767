"""The core of one browser tab: the browser, its user and the selection, its notes, its two threads,
and text from people, made safe to show.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from datetime import datetime
from typing import Any, Literal, Protocol

import viser
from markdown_it import MarkdownIt

from app.server.job import WorkerDied
from app.server.names import display_text, moved_part
from app.server.open_object import OpenObject
from app.server.page import set_page_state
from app.viewer.words import common as words
from model.core.errors import ArtiworldError
from model.core.joint import Joint
from model.core.progress import Cancelled
from model.segmentation.prompts import MAX_PARTS
from sessions import commands as cmd
from sessions.accounts import Account

_KEEP = set(" -.,:;()/+%°·→×²³µ'")


def plain(text: str, limit: int = 120) -> str:
    """``text`` as literal markdown: no markup, no HTML, no expression survives.

    The browser compiles markdown as MDX, where braces are code; every character that is not a
    letter, a digit or harmless punctuation becomes a numeric entity.
    """
    short = text if len(text) <= limit else text[: limit - 1] + "…"
    return "".join(c if c.isalnum() or c in _KEEP else f"&#{ord(c)};" for c in short)


def markdown_html(text: str) -> str:
    """Markdown from people as HTML: HTML in it is shown as text, and nothing is loaded.

    Links lead to http, https and mailto only, in a tab of their own; images are shown as links.
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(text)
    for token in tokens:
        for child in token.children or ():
            if child.type == "image":
                child.type, child.tag = "text", ""
                child.content = f"[{child.content}] ({child.attrs.get('src', '')})"
                child.children = None
            elif child.type == "link_open":
                link = str(child.attrs.get("href", ""))
                if not link.lower().startswith(("https://", "http://", "mailto:")):
                    child.attrs.pop("href", None)
                child.attrs.update(target="_blank", rel="noopener noreferrer nofollow")
    return reader.renderer.render(tokens, reader.options, {})


def path_with_tooltip(path: str, limit: int = 44) -> str:
    """A path as literal markdown, shortened in the middle to a panel's width; whole on hovering."""
    half = (limit - 1) // 2
    short = path if len(path) <= limit else f"{path[:half]}…{path[-half:]}"
    return f'<span title="{plain(path, 1000)}">{plain(short)}</span>'


def percent(share: float) -> str:
    """A share, 0..1, with one digit; what there is at all is never shown as nothing."""
    return "< 0.1 %" if share < 0.0005 else f"{100 * share:.1f} %"


MOST = 3
"""Notes at a time."""
_KEPT = 30
"""Notes that can be read again."""


class Notes:
    """Shows notes in the picture's lower left corner, over no button.

    Attributes:
        log: time, title and text of the latest.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self.log: deque[tuple[str, str]] = deque(maxlen=_KEPT)
        self._client = client
        self._shown: list[tuple[Any, Any, Any]] = []  # title and colour, reason, handle

    def show(
        self, title: str, body: str, color: Any, seconds: float | None, reason: Any = None
    ) -> None:
        """Show a note in place of an earlier one of the same title and colour: a hint doesn't hide
        the question that it is about.

        Args:
            seconds: how long it stays at most; None until somebody closes it.
            reason: the state that it is about, see :meth:`end_others`; None where it is an event.
        """
        self.log.append((f"{datetime.now():%H:%M:%S}", f"{title}. {body}"))
        same = [n for n in self._shown if n[0] == (title, color)]
        for note in same or self._shown[: max(len(self._shown) - MOST + 1, 0)]:
            self._end(note)
        handle = self._client.add_notification(title, body, auto_close_seconds=seconds, color=color)
        self._shown = [*self._shown, ((title, color), reason, handle)]

    def end_others(self, reason: Any) -> None:
        """End the notes that are about another state than ``reason``."""
        for note in [n for n in self._shown if n[1] not in (None, reason)]:
            self._end(note)

    def _end(self, note: tuple[Any, Any, Any]) -> None:
        self._shown = [n for n in self._shown if n is not note]
        note[2].remove()


log = logging.getLogger(__name__)


class TabThreads:
    """Carries out a tab's actions, and draws.

    Args:
        name: of the tab, for the log.
        notify: shows the user ``(title, body, color)``.

    Attributes:
        drawings: how often the screen was brought up to date.
    """

    def __init__(self, name: str, notify: Callable[[str, str, str], None]) -> None:
        self.closed = False
        self.drawings = 0
        self._name = name
        self._notify = notify
        self._actions: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._dirty = threading.Event()

    def start(self, draw: Callable[[], None]) -> None:
        """Begin, with what was asked for before; ``draw`` sends what changed."""
        for target, args in ((self._act_loop, ()), (self._draw_loop, (draw,))):
            threading.Thread(target=target, args=args, name=self._name, daemon=True).start()

    def close(self) -> None:
        """End both threads: the tab is gone."""
        self.closed = True
        self._actions.put(None)
        self._dirty.set()

    def act(self, action: Callable[[], None]) -> None:
        """Carry out ``action`` after those before it."""
        self._actions.put(action)

    def invalidate(self) -> None:
        """Draw again soon."""
        self._dirty.set()

    def _act_loop(self) -> None:
        while (action := self._actions.get()) is not None:
            try:
                action()
            except Cancelled:
                pass
            except (ArtiworldError, WorkerDied) as error:
                self._notify(words.NOT_POSSIBLE, str(error), "yellow")
            except Exception:  # the boundary of an action: report and continue
                if self.closed:
                    return
                log.exception("an action in %s failed", self._name)
                self._notify(*words.INTERNAL_ERROR, "red")
            self.invalidate()

    def _draw_loop(self, draw: Callable[[], None]) -> None:
        while True:
            self._dirty.wait()
            self._dirty.clear()
            if self.closed:
                return
            try:
                draw()
            except Exception:  # the boundary of drawing: a closing tab must not end the server
                if not self.closed:
                    log.exception("drawing %s failed", self._name)
            self.drawings += 1
            time.sleep(0.01)


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
        lock: held while the screen is drawn, and while another object is selected: no screen shows
            two of them.
    """

    def __init__(self, changed: Callable[[], None], nothing_open: str) -> None:
        self.object: OpenObject | None = None
        self.part = 1
        self.child: str | None = None
        self.step: Step = "Annotate"
        self.hidden: frozenset[int] = frozenset()
        self.picking = False
        self.lock = threading.RLock()
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
        with self.lock:
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

        def drawn() -> None:
            # Hints and refusals end that are about another object, or an earlier review.
            self._notes.end_others(self._reason)
            draw()

        self._threads.start(drawn)

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

    def say(self, text: str) -> None:
        """Show a line below the picture for a moment."""
        set_page_state(self.client, said=text)

    def do(self, command: cmd.Command) -> None:
        """Carry out one decision about the open object."""
        self.selection.need_object().do(command, self.user)


def latest_messages(tab: Tab) -> list[tuple[str, str]]:
    """Time and text of the notes that a tab showed, newest first."""
    return list(reversed(tab._notes.log))


def worked_on(selection: Selection) -> int:
    """The selected part; in the steps after annotating that of the selected joint."""
    joint = None if selection.step == "Annotate" else selection.joint
    if joint is not None:
        tree = selection.need_object().document.tree
        assert tree is not None
        digits = moved_part(tree, joint.child).removeprefix("link_")
        return int(digits) if digits.isdigit() else selection.part
    return selection.part
