"""The session loop: one live state of each object, shared by all its users."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakValueDictionary

from model.core.errors import ArtiworldError, CommandError
from sessions import commands as cmd
from sessions.commands import Command, from_json, to_json
from sessions.document import Document
from sessions.review import Role
from sessions.state import Context, SessionState, apply, replay
from sessions.store import ConflictError, Store, clean_who, now, summary

logger = logging.getLogger(__name__)

Subscriber = Callable[[SessionState, Command], None]

MAX_ATTEMPTS = 40
MAX_WAIT = 0.2  # seconds
_BESIDE = cmd.JobResult, cmd.AddComment, cmd.ResolveComment
"""Commands that decide and edit nothing, but for the labels."""


@dataclass(frozen=True, eq=False)
class _Announced:
    """A decision that is shown and not stored yet, and the state after it."""

    command: Command
    context: Context
    after: SessionState


class LiveSession:
    """The state of one object in this process. Every method may be called from any thread.

    Attributes:
        summary: fields of the object's record that commands changed since the session was opened.
    """

    def __init__(self, store: Store, object_id: int) -> None:
        self.store = store
        self.object_id = object_id
        self._lock = threading.RLock()
        self._state = store.load(object_id)
        self._announced: _Announced | None = None
        self.summary: dict[str, Any] = {}
        self._subscribers: dict[int, Subscriber] = {}
        self._next_key = 0
        self._queue: deque[tuple[int, SessionState, Command]] = deque()
        self._delivering = False
        self._issued_here: set[int] = set()
        self._chance = random.Random()

    @property
    def state(self) -> SessionState:
        """The state now, with the announced decision."""
        with self._lock:
            return self._state if self._announced is None else self._announced.after

    @property
    def document(self) -> Document:
        """The present document."""
        return self.state.present

    def issued_here(self, seq: int) -> bool:
        """True if the command with that number was given in this process, since it was opened."""
        with self._lock:
            return seq in self._issued_here

    def do(
        self,
        command: Command,
        who: str,
        *,
        role: Role | None = None,
        since: SessionState | None = None,
        at: str = "",
    ) -> SessionState:
        """Apply ``command``, store it, and notify the subscribers.

        Args:
            role: at most this role is used, as of a token; None: that of the account ``who``.
            since: the state that the decision was made for; None: any.
            at: when it was made, as of :func:`~sessions.database.now`; "" is now.

        The command is applied as read back from its written form, so a replay can't differ. Where
        another process was first, the command is applied after its commands.

        Returns:
            The state after it; the former one where it changes nothing.

        Raises:
            CommandError: where the state or the person's role doesn't allow the command, or the
                object moved on ``since``; nothing was stored.
            StoreError: where it couldn't be stored; the state is as before. Or where it was, and
                the asset of a withdrawn acceptance couldn't be moved.
        """
        who = clean_who(who)
        role = self.store.people.role_for(self.object_id, command, who, role)
        return self._carry_out(command, Context(who, at, role), since)

    def _carry_out(
        self, command: Command, context: Context, since: SessionState | None = None
    ) -> SessionState:
        command = from_json(to_json(command))
        try:
            with self._lock:
                self._store_announced()
                after = self._do(command, context, since)
        finally:
            self._deliver()
        self._settle_beside(after)
        return after

    def _settle_beside(self, after: SessionState) -> None:
        beside = (after.present, *after.past[-1:], *after.future[-1:])
        if any(document.review.state == "accepted" for document in beside):
            self.settle()

    def announce(self, command: Command, who: str) -> SessionState:
        """Show a decision at once that :meth:`complete` stores, or whatever is stored before.

        Returns:
            The state after it; :attr:`state` until then.

        Raises:
            CommandError, StoreError: see :meth:`do`.
        """
        command, who = from_json(to_json(command)), clean_who(who)
        context = Context(who, now(), self.store.people.role_for(self.object_id, command, who))
        with self._lock:
            self._store_announced()
            after = apply(self._state, command, context)
            self._announced = _Announced(command, context, after)
        self._deliver()
        return after

    def complete(self, announced: SessionState, command: Command) -> bool:
        """Store ``command`` in place of the announced one; False where that is stored already.

        Args:
            announced: the state that :meth:`announce` returned.

        Raises:
            CommandError, StoreError: see :meth:`do`; the announced decision is gone.
        """
        command = from_json(to_json(command))
        try:
            with self._lock:  # until it is stored: nobody may see the state without it
                waiting = self._announced
                if waiting is None or waiting.after is not announced:
                    return False
                self._announced = replace(waiting, command=command)
                self._store_announced()
                after = self._state
        finally:
            self._deliver()
        self._settle_beside(after)
        return True

    def store_announced(self) -> None:
        """Store an announced decision now; :meth:`complete` then does nothing.

        Raises:
            CommandError, StoreError: see :meth:`do`; it is gone.
        """
        with self._lock:
            self._store_announced()
        self._deliver()

    def moved_since(self, state: SessionState) -> str:
        """Say how the object was decided or edited since ``state``, or "".

        Comments don't count, nor do results that leave parts and joints as they are.
        """
        self.refresh()
        return self._moved_since(state)

    def settle(self) -> None:
        """Let the object's asset stand if it is accepted, and only then.

        Raises:
            StoreError: where the storage fails, or a folder can't be moved.
        """
        name, settled = self.store.object(self.object_id).asset_name, None
        while (review := self.refresh().present.review) != settled:  # others may decide meanwhile
            self.store.assets.settle(name, review.at if review.state == "accepted" else "")
            settled = review

    def refresh(self) -> SessionState:
        """Apply the commands of other processes."""
        with self._lock:
            self._catch_up()
            state = self._state
        self._deliver()
        return state

    def subscribe(self, callback: Subscriber) -> Callable[[], None]:
        """Call ``callback(state, command)`` after each command, in order, outside of the lock.

        Calls come one at a time, from a thread that issues commands. Exceptions of a callback
        are only logged.

        Returns:
            A function that ends the subscription; it may be called twice.
        """
        with self._lock:
            key, self._next_key = self._next_key, self._next_key + 1
            self._subscribers[key] = callback

        def unsubscribe() -> None:
            with self._lock:
                self._subscribers.pop(key, None)

        return unsubscribe

    def _store_announced(self) -> None:
        waiting, self._announced = self._announced, None
        if waiting is not None:
            self._do(waiting.command, waiting.context, None)

    def _do(self, command: Command, context: Context, since: SessionState | None) -> SessionState:
        who, role = context.who, context.role
        for attempt in range(MAX_ATTEMPTS):
            if since is not None and (moved := self._moved_since(since)):
                raise CommandError(moved)
            at = context.at or now()
            after = apply(self._state, command, replace(context, at=at))
            if after is self._state:
                return after
            try:
                self.store.append(
                    self.object_id, command, who, self._state.seq, at=at, role=role, after=after
                )
            except ConflictError:
                if attempt == MAX_ATTEMPTS - 1:
                    raise
                # A random wait keeps processes from colliding again and again.
                time.sleep(self._chance.uniform(0, MAX_WAIT) * attempt / MAX_ATTEMPTS)
                self._catch_up()
                continue
            self._issued_here.add(after.seq)
            self._advance(after, command, who, at)
            return after
        raise AssertionError("unreachable")

    def _moved_since(self, before: SessionState) -> str:
        now = self._state
        if now.seq == before.seq:
            return ""
        entries = self.store.history(self.object_id, after=before.seq)
        by = [e.who for e in entries if not isinstance(e.command, _BESIDE)]
        docs = before.present, now.present
        one, other = [(d.tree, d.segmentation and d.segmentation.labels) for d in docs]
        if not by and one == other:
            return ""
        review = docs[1].review
        if review != docs[0].review and review.state in ("accepted", "rejected"):
            return f"it was {review.state} meanwhile by {review.by}"
        return f"it was edited meanwhile by {(by or [e.who for e in entries])[-1]}: decide again"

    def _catch_up(self) -> None:
        for entry in self.store.history(self.object_id, after=self._state.seq):
            context = Context(entry.who, entry.at)
            after = replay([(entry.seq, entry.command, context)], self._state)
            self._advance(after, entry.command, entry.who, entry.at)

    def _advance(self, state: SessionState, command: Command, who: str, at: str) -> None:
        self._state, self.summary = state, summary(state, who, at)
        self._queue.extend((key, state, command) for key in self._subscribers)

    def _deliver(self) -> None:
        while True:
            with self._lock:
                if self._delivering or not self._queue:
                    return
                self._delivering = True
                key, state, command = self._queue.popleft()
                subscriber = self._subscribers.get(key)
            try:
                if subscriber is not None:
                    subscriber(state, command)
            except Exception:  # the other subscribers must still be called
                logger.exception("a subscriber of object %d failed", self.object_id)
            finally:
                with self._lock:
                    self._delivering = False


class SessionHub:
    """The :class:`LiveSession` of each object, kept while it is referenced."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._lock = threading.Lock()
        self._sessions: WeakValueDictionary[int, LiveSession] = WeakValueDictionary()

    def session(self, object_id: int) -> LiveSession:
        """Return the live session of an object.

        Raises:
            StoreError: where there is no such object.
        """
        with self._lock:
            session = self._sessions.get(object_id)
            if session is None:
                session = self._sessions[object_id] = LiveSession(self.store, object_id)
            return session

    def store_announced(self) -> None:
        """Store what is announced in any session: the server ends."""
        with self._lock:
            sessions = list(self._sessions.values())
        for session in sessions:
            with suppress(ArtiworldError):  # the objects' own tabs are gone
                session.store_announced()

    def behind(self, last: Mapping[int, int]) -> list[int]:
        """Return the objects whose sessions are to be refreshed, as other processes gave commands.

        Args:
            last: object id → number of its last command; see :meth:`Store.last_commands`.
        """
        with self._lock:
            sessions = list(self._sessions.values())
        return [s.object_id for s in sessions if last.get(s.object_id, 0) > s.state.seq]
