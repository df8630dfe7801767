"""Processes that die, and processes that write at the same time."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sessions.live import LiveSession
from sessions.store import Store

ROOT = Path(__file__).resolve().parents[2]

WRITER = """
import sys
from pathlib import Path
import numpy as np
from model.segmentation.prompts import Click
from sessions.commands import AddClick, AddRegion
from sessions.live import LiveSession
from sessions.store import Store

workspace, who, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
store = Store(workspace)
live = LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)
for i in range(count):
    if i % 10 == 9:
        ref = store.put_array(np.arange(i, i + 500))
        command = AddRegion(1, ref, count=500)
    else:
        command = AddClick(Click((float(i), 0.0, 0.0), 1))
    live.do(command, who)
    print(i, flush=True)
"""


def start(workspace: Path, who: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(workspace), who, str(count)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )


def only_object(store: Store) -> int:
    (record,) = store.objects()
    return record.id


@pytest.mark.parametrize("wait_for", [3, 70])
def test_a_kill_loses_no_acknowledged_command(tmp_path, wait_for):
    process = start(tmp_path, "ann", 100_000)
    assert process.stdout is not None
    acknowledged = []
    for line in process.stdout:
        acknowledged.append(int(line))
        if len(acknowledged) == wait_for:
            process.send_signal(signal.SIGKILL)
            break
    # What it still managed to say before it died counts as well.
    acknowledged += [int(line) for line in process.stdout if line.endswith("\n")]
    assert process.wait(timeout=30) == -signal.SIGKILL

    store = Store(tmp_path)
    object_id = only_object(store)
    prompts = store.load(object_id).present.prompts
    assert len(acknowledged) <= len(prompts) <= len(acknowledged) + 1
    for i, prompt in enumerate(prompts):
        if i % 10 == 9:
            elements = store.get_array(prompt.elements)
            np.testing.assert_array_equal(elements, np.arange(i, i + 500))
        else:
            assert prompt.position == (float(i), 0.0, 0.0)
    assert store.object(object_id).prompts == len(prompts)
    # And work goes on.
    live = LiveSession(store, object_id)
    assert live.state.seq == len(prompts)
    store.close()


def test_processes_that_write_at_the_same_time_lose_nothing(tmp_path):
    # Nobody made the workspace before: they race for that, too.
    writers = [start(tmp_path, who, 40) for who in ("ann", "rob", "eve")]
    for writer in writers:
        writer.communicate(timeout=120)
        assert writer.returncode == 0
    store = Store(tmp_path)
    object_id = only_object(store)
    history = store.history(object_id)
    assert [e.seq for e in history] == list(range(1, 121))
    for who in ("ann", "rob", "eve"):
        mine = [e for e in history if e.who == who]
        positions = [e.command.click.position[0] for e in mine if e.kind == "add_click"]
        assert len(mine) == 40
        assert positions == sorted(positions), "each process's own order is kept"
    assert len(store.load(object_id).present.prompts) == 120
    store.close()
