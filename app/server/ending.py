"""End of a server's process: soon after SIGINT, SIGTERM or a closed terminal, at any moment."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

END_SECONDS = 4.0
"""Seconds that the server may take to close; supervisors kill after 5 s or more."""
SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class EndSignals:
    """Takes the signals that end the process, from now on.

    The handlers do nothing, as one that takes a lock deadlocks when the next signal interrupts it:
    supervisors send SIGTERM to the process and to its group. A thread reads the signals' numbers
    from a pipe. It ends the process at once while nothing is served yet; later the process closes
    by itself, or is ended after :data:`END_SECONDS`. Every decision is on disk by then.

    Make it in the main thread. As a context manager it gives the signals back if none came.
    """

    def __init__(self) -> None:
        self._serving = False
        self._lock = threading.Lock()
        self._came = threading.Event()
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._fd_before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._before = {number: signal.getsignal(number) for number in SIGNALS}
        for number, handler in self._before.items():
            if handler != signal.SIG_IGN:  # "nohup" has SIGHUP ignored
                signal.signal(number, lambda *_: None)
        masks = threading.local()

        def block() -> None:
            masks.before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)

        def unblock() -> None:
            signal.pthread_sigmask(signal.SIG_SETMASK, masks.before)

        def begin_child() -> None:
            self._give_back()
            unblock()

        # A forked child would write the numbers of its own signals into this pipe.
        os.register_at_fork(before=block, after_in_parent=unblock, after_in_child=begin_child)
        threading.Thread(target=self._read, name="signals", daemon=True).start()

    def __enter__(self) -> EndSignals:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._came.is_set():
            self._give_back()

    def _give_back(self) -> None:
        if self._writer < 0:
            return
        signal.set_wakeup_fd(self._fd_before)
        for number, handler in self._before.items():
            signal.signal(number, handler or signal.SIG_DFL)
        os.close(self._writer)  # ends the thread
        self._writer = -1

    def _read(self) -> None:
        number = 0
        while number not in SIGNALS:
            read = os.read(self._reader, 1)
            if not read:
                os.close(self._reader)
                return
            number = read[0]
        with self._lock:
            if not self._serving:
                os._exit(128 + number)
        # By a thread that needs no interpreter lock; the tracebacks show what didn't end.
        faulthandler.dump_traceback_later(END_SECONDS, exit=True, file=sys.__stderr__ or 2)
        self._came.set()

    def begin_serving(self) -> None:
        """From now on a signal lets the process close; before it ends the process at once."""
        with self._lock:
            self._serving = True

    def wait(self) -> None:
        """Serve until the first signal."""
        self.begin_serving()
        self._came.wait()
        for number in SIGNALS:  # Python gives them back their default while it ends
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Block the signals in this thread, and in a process that it starts until that lets them in."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore_end_signals() -> None:
    """Have the signals do nothing in this process, whose parent ends it."""
    for number in SIGNALS:  # ignored ones would be inherited
        signal.signal(number, lambda *_: None)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
