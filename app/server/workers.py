"""The worker processes of a server, and the lanes of those that answer clicks: nobody's clicks
share a process with another person's object.
"""

from __future__ import annotations

import math
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar
from weakref import WeakKeyDictionary

from app.server.jobs import Job, WorkerProcess
from app.server.worker import WorkerTemplate
from model.core.memory import limit_memory, machine_memory
from model.core.progress import own_threads

T = TypeVar("T")
MEMORY = 0.75
"""Share of the machine's memory for one job that may take much, and for the lanes together."""
LANE_BYTES = 2 << 30
"""Memory of a lane with full caches: encodings of 400,000 elements, 3 kB each, and libraries. A
process with more, of gaps between them, begins anew, unless one heavy object may fill it."""
KEPT_BYTES = 1 << 30
"""Memory with which a process that reads or writes files goes on; with more it begins anew."""
HEAVY_LANES = 2
"""Two people with a heavy object each; more of them share these lanes."""
SPARE_LANES = 2
"""The one just taken, and the one before; other unused lanes keep no processes."""

READING, HEAVY = 5, 10
"""Niceness of reading, a third of the processor beside a click, and a tenth: of heavy objects and
of what follows an acceptance, which nobody waits for."""


def in_background(niceness: int) -> None:
    """Begin a process for what may take long: others go first, and its memory is bounded."""
    os.nice(niceness)
    limit_memory(MEMORY)


class LaneUser(Protocol):
    """Open object that a lane works on."""

    @property
    def clicked(self) -> bool:
        """True while a tab shows it, or a script works on it."""
        ...


@dataclass(frozen=True, eq=False)
class Lane:
    """Two processes for one object at a time.

    Attributes:
        geometry: cuts parts, picks points.
        segmentation: encodes the object and answers clicks.
    """

    geometry: WorkerProcess
    segmentation: WorkerProcess

    @property
    def busy(self) -> bool:
        """True while one of its processes is busy."""
        return self.geometry.busy or self.segmentation.busy


class Lanes:
    """The lanes of a server.

    An object gets a lane that nobody else uses; a new one begins where all are in use, as far as
    the machine's memory goes. So one annotator has one lane, with what it remembers of the objects
    before. Heavy objects have lanes of their own, to which the system prefers all others.

    Args:
        template: what the processes are forked from; None starts interpreters.

    Attributes:
        first: the lane that is always there.
    """

    def __init__(self, template: WorkerTemplate | None = None) -> None:
        self._template = template
        self._lock = threading.Lock()
        self._most = {False: max(1, int(MEMORY * machine_memory() / LANE_BYTES)), True: HEAVY_LANES}
        self._lanes: dict[bool, list[Lane]] = {False: [], True: []}  # used last is last
        self._of: WeakKeyDictionary[LaneUser, Lane] = WeakKeyDictionary()
        self._next: WeakKeyDictionary[LaneUser, Lane] = WeakKeyDictionary()
        self._closing = False
        self.first = self._begin(heavy=False)

    def __iter__(self) -> Iterator[Lane]:
        with self._lock:
            return iter([*self._lanes[False], *self._lanes[True]])

    def _begin(self, *, heavy: bool) -> Lane:
        lanes = self._lanes[heavy]
        numbers = ("", *(f" {n}" for n in range(2, len(lanes) + 2)))
        names = [f"{'heavy ' * heavy}%s{number}" for number in numbers]
        taken = {lane.geometry.name for lane in lanes}
        name = next(name for name in names if name % "geometry" not in taken)
        lane = Lane(
            *(
                WorkerProcess(
                    name % work,
                    initializer=in_background if heavy else None,
                    arguments=(HEAVY,) if heavy else (),
                    lazy=heavy or bool(lanes),
                    template=self._template,
                    most_kept=math.inf if heavy else LANE_BYTES,
                )
                for work in ("geometry", "segmentation")
            )
        )
        lanes.append(lane)
        return lane

    def take(self, user: LaneUser, *, heavy: bool) -> Lane:
        """Return the lane of an object that is opened or shown: its former one if nobody else uses
        that. Where all are in use, the one with the fewest objects.
        """
        with self._lock:
            mine = self._of[user] = self._chosen(user, heavy)
            self._lanes[heavy].remove(mine)
            self._lanes[heavy].append(mine)
            users = self._users(user)
            unused = [lane for lane in self._lanes[heavy] if not users[lane]]
            for lane in self._lanes[heavy]:
                for worker in (lane.geometry, lane.segmentation):
                    worker.rest(lane in unused[:-SPARE_LANES])
            return mine

    def _users(self, user: LaneUser) -> Counter[Lane]:
        """The numbers of objects besides one that people work on in each lane."""
        return Counter(
            lane for other, lane in self._of.items() if other is not user and other.clicked
        )

    def reserve(self, user: LaneUser, *, heavy: bool) -> Lane:
        """Return the lane that an object gets when it is read again and is heavy, or not, then."""
        with self._lock:
            lane = self._next[user] = self._chosen(user, heavy)
            return lane

    def _chosen(self, user: LaneUser, heavy: bool) -> Lane:
        lanes = self._lanes[heavy]
        former = [self._next.get(user), self._of.get(user)]
        known = next((lane for lane in former if lane in lanes), None)
        users = self._users(user)
        if known is not None and not (users[known] and user.clicked):
            return known
        free = [lane for lane in lanes if not users[lane] and not lane.busy]
        if not free and len(lanes) < self._most[heavy] and not self._closing:
            free = [self._begin(heavy=heavy)]
        if not free and known is not None:
            return known
        return min(free or lanes, key=lambda lane: users[lane])

    def share(self, user: LaneUser, lane: Lane) -> None:
        """Give an object that is opened ahead the lane of the one that a person works on."""
        with self._lock:
            self._of.setdefault(user, lane)
            self._next.setdefault(user, lane)

    def leave(self, user: LaneUser) -> None:
        """Take a lane from an object that is closed, and end it where it has no other one."""
        with self._lock:
            lane, _ = self._of.pop(user, None), self._next.pop(user, None)
            if lane in (None, self.first, *self._of.values(), *self._next.values()):
                return
            for lanes in self._lanes.values():
                if lane in lanes:
                    lanes.remove(lane)
        lane.geometry.begin_to_close()
        lane.segmentation.begin_to_close()

    def close(self) -> list[WorkerProcess]:
        """Begin no more lanes; returns the processes to end."""
        self._closing = True
        return [worker for lane in self for worker in (lane.geometry, lane.segmentation)]


READ_SECONDS = 600.0
"""Longest reading of a file by the clock; scans of 50 million points take one minute."""
QUICK_SECONDS, SMALL_BYTES = 2.0, 20_000_000
"""Time and size of a file that is read beside those that take long; most take below a second."""
FIRST_WORK, MOST_WORK = (10.0, 0.2), (300.0, 2.0)
"""Seconds of a processor for reading a file, and more for each MB: those after which it begins
anew behind others that wait, and those after which it ends. A choice: most files need .1 s a MB."""
MOST_TURNS = 40
READ_CANCELLED = "Reading it was cancelled"


def too_slow(name: str) -> str:
    """Timeout message for reading the file ``name``."""
    base, each = MOST_WORK
    most = f"{base:g} s and {each:g} s a MB of a processor, or {READ_SECONDS / 60:g} minutes"
    return f"Reading {name} took more than {most}: join its meshes, thin it, or cut it into pieces"


class Workers:
    """The worker processes.

    Attributes:
        template: all are forked from it, where the system can; else None.
        readers: read files, scenes and crops, which may take long or end them, so nobody's clicks
            wait for them: the first all, the second small ones, the third what took too long.
        reading: the first reader.
        lanes: answer clicks on open objects.
        geometry: of the first lane; also cuts the parts of a scene.
        segmentation: of the first lane.
        prediction: predicts joints and validates them.
        saving: writes accepted assets.
        closing: whether the server ends and cuts jobs off.
    """

    def __init__(self) -> None:
        self.template = WorkerTemplate(own_threads()) if WorkerTemplate.possible() else None
        kept: dict[str, Any] = {"template": self.template, "most_kept": KEPT_BYTES}
        kept["initializer"] = in_background
        self.saving = WorkerProcess("saving", arguments=(HEAVY,), **kept)
        self.readers = tuple(
            WorkerProcess(name, lazy=name == "reading 3", arguments=(READING,), **kept)
            for name in ("reading", "reading 2", "reading 3")
        )
        self.reading = self.readers[0]
        self.lanes = Lanes(self.template)
        self.geometry, self.segmentation = self.lanes.first.geometry, self.lanes.first.segmentation
        self.prediction = WorkerProcess("prediction", template=self.template)
        self.closing = False
        self._waiting: list[tuple[str, Job[Any]]] = []

    def read(
        self,
        function: Callable[..., T],
        *args: Any,
        who: str = "",
        most_seconds: float = READ_SECONDS,
        **settings: Any,
    ) -> Job[T]:
        """Have ``function(*args)`` read something; people take turns.

        While the first reader is busy, what isn't a large file goes to the second one. Who works
        too long, :data:`QUICK_SECONDS` there and :data:`FIRST_WORK` at the first one, makes room
        for those that wait, and begins again behind: at the first one, or then at the third.

        Args:
            args: a :class:`Path` comes first where it is read.
            who: the person that waits; the first file of each comes before the second of anybody.
        """
        self._waiting = [(name, job) for name, job in self._waiting if not job.done]
        before = sum(name == who for name, _ in self._waiting)
        settings = {"priority": MOST_TURNS - min(before, MOST_TURNS - 1), **settings}
        slow, quick, late = self.readers
        path = args[0] if isinstance(args[0], Path) else ""
        size = os.path.getsize(path) if os.path.isfile(path) else 0
        first, most = (base + each * size / 1e6 for base, each in (FIRST_WORK, MOST_WORK))
        reader = slow if size > SMALL_BYTES or not slow.busy else quick
        job = reader.submit(function, *args, most_seconds=most_seconds, **settings)
        job.most_work, job.moves = most, [(first, late.adopt)]
        if reader is quick:
            job.moves = [(QUICK_SECONDS, slow.adopt), *job.moves]
        self._waiting.append((who, job))
        return job

    def close(self) -> None:
        """End the processes."""
        self.closing = True
        workers = (*self.readers, *self.lanes.close(), self.prediction, self.saving)
        for worker in workers:
            worker.begin_to_close()
        for worker in workers:
            worker.close()
        if self.template is not None:
            self.template.close()
