"""The time of people as the log tells it, against what a script measured for its own acts."""

import itertools
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sessions.command_log import read_work
from sessions.statistics import PAUSE, acts_of, figures_of
from tests.browser.browsing import Tab, wait_until

THINKING = 2.0
"""Seconds before each act."""


def counted(gaps: Iterable[float]) -> float:
    """Seconds without pauses, which a slow machine makes."""
    return sum(gap for gap in gaps if gap <= PAUSE)


def test_the_log_agrees_with_the_scripts_own_clock(
    start: Any, open_tab: Any, cabinet: Any, tmp_path: Path
) -> None:
    path, points = cabinet
    server = start(path, workspace=tmp_path / "workspace")
    tab: Tab = open_tab(server)
    moments: list[float] = []

    def act(what: Any) -> None:
        time.sleep(THINKING)
        moments.append(time.time())
        what()

    act(lambda: tab.prompt(points["door"]))
    first_was_slow = time.time() - moments[0]
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "key 2 chooses part 2")
    act(lambda: tab.prompt(points["drawer"]))
    act(lambda: tab.prompt(points["base"], ("Shift",)))
    act(lambda: tab.key("Control+z"))
    tab.settled()
    tab.drawn()
    asked = time.time() + THINKING
    act(lambda: tab.key("p"))
    pressing = time.time() - asked
    wait_until(lambda: tab.document.tree is not None, "a kinematic tree")
    waited = time.time() - asked
    answered = time.time()
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    tab.drawn()
    tab.app.motion.stop()
    act(lambda: tab.key("f"))
    wait_until(lambda: tab.document.edited_joints, "a joint is flipped")
    last_was_slow = time.time() - moments[-1]

    log = read_work(Path(server.config.workspace), server.config.database)
    acts = acts_of(log)
    first = next(i for i, a in enumerate(acts) if a.kind == "add_click")
    found = figures_of(a for a in acts[first + 1 :])
    own = counted(b - a for a, b in itertools.pairwise(sorted([*moments, answered])))
    # An act is logged between the press of the key and what the screen then shows.
    assert own - first_was_slow < found.active < own + last_was_slow
    everything = figures_of(acts)
    assert (everything.clicks, everything.corrections) == (3, 2), "the undo and the flipped joint"
    opened = max(j.at for j in log.jobs if j.kind == "open")
    until_pressed = counted([moments[0] - opened])
    assert until_pressed - 0.5 < acts[first].active < until_pressed + first_was_slow + 0.5
    prediction = next(a for a in acts if a.kind == "record_prediction")
    joints = next(a for a in acts if a.step == "Joints" and a.at > prediction.at)
    assert waited - pressing - 0.5 < joints.waiting < waited + 0.5
