"""Tools number new parts, the lowest number that nothing was ever said of; they can be stopped."""

from __future__ import annotations

from threading import Thread
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from app.server.job import Job
from app.server.observable import RunningJobs
from app.server.segmenting import Segmenting
from app.server.tool_tasks import FaceCutOffer, MaskOffer, RegionOffer, ToolRequest
from model.core.errors import CommandError
from model.core.progress import Cancelled
from model.segmentation.prompts import Click
from sessions.commands import AddClick, AddPart, NamePart, SetFrame
from sessions.document import FaceCut
from sessions.state import Context, SessionState, apply
from tests.builders import wait_until

REF = "a" * 64
HERE = Context("tester", "2026-01-01T00:00:00+00:00")


def open_with_tool(offers: Any, *commands: Any) -> tuple[Segmenting, Any]:
    """An open object after ``commands``, whose tools find ``offers``."""
    job = SimpleNamespace(before=lambda: None, result=lambda seconds: (job.before(), offers)[1])
    obj: Any = SimpleNamespace(
        need_asset=lambda: SimpleNamespace(folder=None),
        lane=SimpleNamespace(segmentation=SimpleNamespace(submit=lambda *a, **k: job)),
        services=SimpleNamespace(
            workspace=None,
            config=SimpleNamespace(segmenter="default"),
        ),
        jobs=Mock(),
        changed=lambda: None,
    )
    state = SessionState()

    def do(command: Any, who: str = "") -> None:
        nonlocal state
        state = apply(state, command, HERE)
        obj.document = state.present

    for command in commands:
        do(command)
    obj.do = do
    return Segmenting(obj), obj


def test_new_parts_take_the_numbers_of_empty_ones() -> None:
    said = (AddPart(1), AddPart(2), AddPart(3, "door"), AddClick(Click((0, 0, 0), 4)), AddPart(5))
    segmenting, obj = open_with_tool([RegionOffer(-1, REF, 9)] * 3, *said)
    assert segmenting.use_tool(ToolRequest("propose", 2), "tester") == 3
    regions = [(p.part, p.tool) for p in obj.document.prompts[1:]]
    assert regions == [(1, "propose"), (2, "propose"), (5, "propose")]
    assert [p.id for p in obj.document.parts] == [0, 1, 2, 3, 4, 5]


def test_what_takes_an_empty_number_has_its_name() -> None:
    said = (AddPart(1), AddClick(Click((0, 0, 0), 2)), NamePart(2, "knob"))
    segmenting, obj = open_with_tool([RegionOffer(-1, REF, 9)], *said)
    segmenting.use_tool(ToolRequest("same shape", 2), "tester")
    assert obj.document.part_names == {1: "knob", 2: "knob"} and obj.document.part(1).like == 2


@pytest.mark.parametrize(
    "meanwhile", [AddClick(Click((1, 0, 0), 3)), AddPart(1), SetFrame("x", 1.0)]
)
def test_what_a_tool_found_is_not_mixed_with_what_others_did_meanwhile(meanwhile: Any) -> None:
    for tool, offers in (
        ("propose", [RegionOffer(-1, REF, 9)] * 2),
        ("next mask", MaskOffer([RegionOffer(2, REF, 9)], 1, 2)),
        ("cut", FaceCutOffer(FaceCut(REF, ((0, 0, 1, 0),)), (), REF, {0: 1})),
    ):
        segmenting, obj = open_with_tool(offers, AddClick(Click((0, 0, 0), 2)))
        obj.lane.segmentation.submit().before = lambda obj=obj: obj.do(meanwhile)
        with pytest.raises(CommandError, match="meanwhile"):
            segmenting.use_tool(ToolRequest(tool, 2), "tester")
        assert obj.document.label == meanwhile.describe()


def test_a_tool_at_work_is_seen_and_can_be_stopped_while_its_tab_waits() -> None:
    segmenting, obj = open_with_tool([], AddPart(1))
    jobs = obj.jobs = RunningJobs("the chest", lambda: None)
    job: Job[Any] = Job(lambda job: job.end("cancelled"), 1, "tool", (int, (), {}), None, None)
    obj.lane.segmentation.submit = lambda *a, **k: job
    ended: list[Exception] = []

    def use() -> None:
        try:
            segmenting.use_tool(ToolRequest("propose", 2), "tester")
        except Cancelled as error:
            ended.append(error)

    tab = Thread(target=use)
    tab.start()
    wait_until(lambda: "tool" in jobs)
    jobs.progress("tool")(0.4, "looking for parts")
    assert jobs.busy == {"tool": (0.4, "looking for parts")}
    jobs.cancel("tool")
    tab.join(10)
    wait_until(lambda: not jobs.busy)
    assert len(ended) == 1 and obj.document.prompts == ()


def test_a_tool_that_finds_no_time_is_given_up_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    segmenting, obj = open_with_tool([], AddPart(1))
    stopped: list[Any] = []
    job: Job[Any] = Job(stopped.append, 1, "tool", (int, (), {}), None, None)
    obj.lane.segmentation.submit = lambda *a, **k: job
    monkeypatch.setattr("app.server.segmenting.TOOL_SECONDS", 0.01)
    with pytest.raises(CommandError, match="too busy"):
        segmenting.use_tool(ToolRequest("grow", 1), "tester")
    assert stopped == [job]
