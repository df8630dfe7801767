"""Users of each open object, in this server's tabs and in those of others."""

from __future__ import annotations

import threading
import time
from collections.abc import Hashable, Iterable

from app.server.open_object import OpenObject
from sessions.accounts import Account
from sessions.people import HEARTBEAT_SECONDS, Work


class PresenceBoard:
    """Keeps presence alive for the tabs of this server, and tells objects who else is there.

    Args:
        work: of the workspace.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._lock = threading.Lock()
        self._here: dict[Hashable, tuple[int, Account]] = {}
        self._said = -HEARTBEAT_SECONDS

    def enter(self, tab: Hashable, object_id: int, account: Account | None) -> None:
        """Note that a tab shows an object, and no longer the one before."""
        self.leave(tab)
        if account is None:
            return
        with self._lock:
            self._here[tab] = object_id, account
        self._work.enter(object_id, account)

    def leave(self, tab: Hashable) -> None:
        """Note that a tab shows no object; a lease ends with the person's last tab."""
        with self._lock:
            left = self._here.pop(tab, None)
            gone = left is not None and left not in self._here.values()
        if left is not None and gone:
            self._work.leave(*left)

    def sync(self, shown: Iterable[OpenObject]) -> None:
        """Say again who is here, and bring ``present`` of the objects up to date."""
        with self._lock:
            here = set(self._here.values())
        if not here:
            return
        now = time.monotonic()
        if now - self._said >= HEARTBEAT_SECONDS:
            self._said = now
            for object_id, account in here:
                self._work.enter(object_id, account)
        for obj in shown:
            present = tuple(self._work.present(obj.record.id))
            if present != obj.present:
                obj.present = present
                obj.changed()
