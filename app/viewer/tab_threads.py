"""The two threads that serve one browser tab.

What the user does is put into a queue and carried out in order by the *action* thread; the *draw*
thread brings the screen up to date with the state, however many changes came meanwhile.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable

from app.server.job import WorkerDied
from app.viewer.words import common as words
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled

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
