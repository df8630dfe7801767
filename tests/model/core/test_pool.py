"""What a pool leaves behind when it is ended in the middle of its work."""

from __future__ import annotations

import threading
import time
from multiprocessing.connection import Connection

import pytest

from model.core.pool import in_processes


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_an_ended_pool_leaves_no_thread_that_python_would_have_to_wake(method, monkeypatch):
    """Waking one that closes its pipes in that moment wrote a traceback at exit."""
    close = Connection.close

    def slowly(pipe):
        if threading.current_thread() is not threading.main_thread():
            time.sleep(0.3)  # a busy machine
        close(pipe)

    monkeypatch.setattr(Connection, "close", slowly)
    before = set(threading.enumerate())
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), in_processes(time.sleep, [60.0, 60.0], 2, method):
        raise KeyboardInterrupt
    assert set(threading.enumerate()) <= before
    assert time.monotonic() - began < 20
