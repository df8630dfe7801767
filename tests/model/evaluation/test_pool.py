"""What a pool leaves behind when it is ended in the middle of its work."""

from __future__ import annotations

import threading
import time
from concurrent.futures import process

import pytest

from model.evaluation.pool import in_processes


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_an_ended_pool_leaves_no_thread_that_python_would_have_to_wake(method, monkeypatch):
    """Waking one that closes its pipes in that moment wrote a traceback at exit."""
    close = process._ThreadWakeup.close

    def slowly(pipes):
        time.sleep(0.3)  # a busy machine
        close(pipes)

    monkeypatch.setattr(process._ThreadWakeup, "close", slowly)
    before = set(threading.enumerate())
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), in_processes(time.sleep, [60.0, 60.0], 2, method):
        raise KeyboardInterrupt
    assert set(threading.enumerate()) <= before
    assert time.monotonic() - began < 20
