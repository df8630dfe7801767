"""How a server's process ends: soon after SIGINT, SIGTERM or a closed terminal, at any moment."""

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

    Make it in the main thread.
    """

    def __init__(self) -> None:
        self._serving = False
        self._lock = threading.Lock()
        self._came = threading.Event()
        self._reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:  # "nohup" has SIGHUP ignored
                signal.signal(number, lambda *_: None)
        threading.Thread(target=self._read, name="signals", daemon=True).start()

    def _read(self) -> None:
        number = 0
        while number not in SIGNALS:
            number = os.read(self._reader, 1)[0]
        with self._lock:
            if not self._serving:
                os._exit(128 + number)
        # By a thread that needs no interpreter lock; the tracebacks show what didn't end.
        faulthandler.dump_traceback_later(END_SECONDS, exit=True, file=sys.__stderr__ or 2)
        self._came.set()

    def wait(self) -> None:
        """Wait for the first signal; until then the process ends at once when one comes."""
        with self._lock:
            self._serving = True
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
