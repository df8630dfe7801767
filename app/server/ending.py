"""The end of a process: soon after SIGINT, SIGTERM or a closed terminal, at any moment; log files
of crashes; and what killed processes leave half-written in a workspace.

Each server holds a shared lock on the workspace as long as it runs. One that gets it alone, because
no other server runs, removes the unfinished files first.
"""

from __future__ import annotations

import faulthandler
import fcntl
import logging
import os
import platform
import re
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from model.core.files import OLD

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

    def __exit__(self, kind: object, *_: object) -> None:
        if not self._came.is_set():
            self._give_back()
        elif kind is None:  # all is closed; taking native libraries apart may last seconds
            logging.shutdown()
            sys.stdout.flush()
            os._exit(0)

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


_SECRET = ("token", "database", "password", "secret", "api-key")
"""Endings of the options whose values are secret."""
_LOGIN = re.compile(r"://[^/\s?#]*@")


def crash_folder() -> Path:
    """Return ``$XDG_STATE_HOME/artiworld``, by default ``~/.local/state/artiworld``."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "artiworld"


def write_crash(error: BaseException) -> Path:
    """Write the traceback of ``error`` into a file of its own and return the file.

    Tokens and passwords given on the command line are left out.
    """
    now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    lines = [
        f"{now} UTC, Python {platform.python_version()}, {platform.platform()}",
        "arguments: " + " ".join(_without_secrets(sys.argv[1:])),
        _without_login("".join(traceback.format_exception(error))),
        _without_login(getattr(error, "details", "")),
    ]
    for folder in (crash_folder(), Path(tempfile.gettempdir())):
        path = folder / f"artiworld-{now}-{os.getpid()}.log"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(lines))
        except OSError:
            continue
        return path
    return Path(os.devnull)


def _without_secrets(words: list[str]) -> list[str]:
    out: list[str] = []
    for i, word in enumerate(words):
        name, separator, _ = word.partition("=")
        if i and _is_secret(words[i - 1]):
            out.append("…")
        elif separator and _is_secret(name):
            out.append(f"{name}=…")
        else:
            out.append(_without_login(word))
    return out


def _is_secret(option: str) -> bool:
    return option.startswith("--") and option.endswith(_SECRET)


def _without_login(text: str) -> str:
    """Return the text with its URLs stripped of names and passwords."""
    return _LOGIN.sub("://…@", text)


log = logging.getLogger(__name__)
LOCK = ".lock"
_UNFINISHED = (
    *"arrays/*/.* drafts/.* uploads/.* uploads/*/.* cache/.* cache/*/.* collision/.*".split(),
    *"scenes/.* scenes/report-*/.* scenes/saved-*/.* crops/*/.* assets/.* thumbnails/.*".split(),
    *"thumbnails/*.part exports/.* learned/.* releases/.* storage/.*".split(),
)
"""Names of unfinished drafts of :func:`~model.core.files.draft_of`, a dot before the name, and of
the thumbnails of former versions."""


class WorkspaceLease:
    """A server's share of a workspace, until it is closed or its process ends.

    Args:
        workspace: the folder, which is there.
    """

    def __init__(self, workspace: Path) -> None:
        self._file: BinaryIO | None = None
        try:
            self._file = (workspace / LOCK).open("ab")
            with suppress(BlockingIOError):
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remove_leftovers(workspace)
            fcntl.flock(self._file, fcntl.LOCK_SH)
        except OSError as error:  # read-only, or a file system without locks: nothing is removed
            log.info("%s can't be locked (%s)", workspace, error.strerror)

    def close(self) -> None:
        """Give it back."""
        if self._file is not None:
            self._file.close()


def unfinished(workspace: Path) -> list[Path]:
    """Files and folders that aren't whole: being written, or left by a process that was killed."""
    found = (path for pattern in _UNFINISHED for path in workspace.glob(pattern))
    return [p for p in found if not p.is_symlink()]  # but second annotations' sources


def remove_leftovers(workspace: Path) -> list[Path]:
    """Remove what is unfinished, and put back assets whose replacement was cut off.

    Only for a workspace in which nobody writes. Returns the removed paths.
    """
    from model.io.assets.reader import recover  # heavy, and --help comes by here

    found = unfinished(workspace)
    for path in found:
        if path.name.endswith(OLD) and path.parent.name == "assets":
            recover(path.with_name(path.name[1:].removesuffix(OLD).rpartition(".")[0]))
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)
    removed = [path for path in found if not path.exists()]
    if removed:
        log.info("removed %d unfinished files of processes that were killed", len(removed))
    return removed
