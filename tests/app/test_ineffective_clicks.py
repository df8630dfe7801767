"""The app notices clicks that bring hardly anything, and says which masks there are."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from app.server.segmenting import MaskShown, Segmenting
from app.server.tool_tasks import MaskOffer, RegionOffer, ToolRequest
from model.segmentation.prompts import Click
from sessions.document import Document, RegionRef
from tests.app.segmenter_answers import answer

ELEMENTS = 1000
OTHER = RegionRef(1, "b" * 64, True, 3, "next mask")


@pytest.fixture
def obj() -> Any:
    """An open object as :class:`Segmenting` sees it; every second element is displayed."""
    displayed = np.arange(0, ELEMENTS, 2, dtype=np.int32)
    asset = SimpleNamespace(folder=Path(), element=displayed, area=None)
    done: list[Any] = []
    return SimpleNamespace(
        document=Document(),
        asset=asset,
        need_asset=lambda: asset,
        do=lambda c, who: done.append(c),
        jobs=Mock(),
        changed=lambda: None,
    )


def click(element: int, positive: bool = True) -> Click:
    return Click((0.0, 0.0, 0.0), 1, positive, element)


def kept(obj: Any, held: int) -> None:
    """The answer is on record: the first ``2 * held`` elements are part 1, displayed or not."""
    obj.part_of = lambda element: int(element < 2 * held)


def answered(desk: Segmenting, obj: Any, prompts: tuple[Any, ...], held: int) -> None:
    """The segmenter answers ``prompts``: the first ``held`` displayed elements are part 1."""
    labels = np.zeros(ELEMENTS // 2, np.int16)
    labels[:held] = 1
    answer(desk, obj, Document(prompts=prompts), labels)
    kept(obj, held)


def test_clicks_that_bring_little_are_counted(obj: Any) -> None:
    desk = Segmenting(obj)
    first, second, third, fourth = click(0), click(900), click(910), click(920)
    answered(desk, obj, (first,), 200)
    assert desk.ineffective_clicks == 0
    answered(desk, obj, (first, second), 202)
    answered(desk, obj, (first, second, third), 204)
    assert desk.ineffective_clicks == 2
    answered(desk, obj, (first, second, third, fourth), 300)
    assert desk.ineffective_clicks == 0


def test_a_click_that_confirms_was_not_in_vain(obj: Any) -> None:
    desk = Segmenting(obj)
    answered(desk, obj, (click(0),), 200)
    answered(desk, obj, (click(0), click(20)), 200)
    answered(desk, obj, (click(0), click(20), click(900, positive=False)), 200)
    assert desk.ineffective_clicks == 0
    # Nor are those on points of a large scan that are not displayed.
    answered(desk, obj, (click(0), click(20), click(900, positive=False), click(21)), 200)
    assert desk.ineffective_clicks == 0


def test_undo_and_drawn_regions_are_no_clicks_in_vain(obj: Any) -> None:
    desk = Segmenting(obj)
    answered(desk, obj, (click(0),), 200)
    answered(desk, obj, (click(0), click(900)), 201)
    assert desk.ineffective_clicks == 1
    answered(desk, obj, (click(0),), 200)
    assert desk.ineffective_clicks == 0
    answered(desk, obj, (click(0), RegionRef(1, "b" * 64, True, 3, "lasso")), 201)
    assert desk.ineffective_clicks == 0


@pytest.mark.parametrize(
    ("after", "turn", "wanted"), [((), 1, 1), ((), -1, -1), ((OTHER,), 1, 2), ((OTHER,), -1, 0)]
)
def test_a_new_server_goes_on_from_the_mask_that_is_there(
    obj: Any, after: tuple[RegionRef, ...], turn: int, wanted: int
) -> None:
    obj.document, obj.asset = Document(prompts=(click(0), *after)), SimpleNamespace(folder=Path())
    obj.need_asset = lambda: obj.asset
    asked: list[ToolRequest] = []

    def submit(*args: Any, **_: Any) -> Any:
        asked.append(args[-1])
        return SimpleNamespace(result=lambda seconds: MaskOffer([], 0, 4))

    obj.services = SimpleNamespace(workspace=Path(), config=SimpleNamespace(segmenter="default"))
    obj.lane = SimpleNamespace(segmentation=SimpleNamespace(submit=submit))
    assert Segmenting(obj).use_tool(ToolRequest("next mask", 1, turn), "who") == 3
    assert asked[0].turn == wanted


def test_after_undo_the_next_mask_is_the_one_after_what_is_shown(obj: Any) -> None:
    obj.document, obj.asset = Document(prompts=(click(0),)), SimpleNamespace(folder=Path())
    obj.need_asset = lambda: obj.asset
    asked: list[int] = []

    def submit(*args: Any, **_: Any) -> Any:
        asked.append(args[-1].turn)
        region = RegionOffer(1, f"{asked[-1]:x}" * 64, 3)
        return SimpleNamespace(result=lambda seconds: MaskOffer([region], asked[-1], 6))

    def do(command: Any, who: str) -> None:
        (region,) = command.regions
        mask = RegionRef(1, region.elements, True, 3, "next mask")
        obj.document = Document(prompts=(click(0), mask))

    config = SimpleNamespace(segmenter="default")
    obj.do, obj.services = do, SimpleNamespace(workspace=Path(), config=config)
    obj.lane = SimpleNamespace(segmentation=SimpleNamespace(submit=submit))
    desk, steps = Segmenting(obj), []
    for _ in range(3):
        desk.use_tool(ToolRequest("next mask", 1, 1), "who")
        steps.append(obj.document)
    obj.document = steps[1]  # undo
    shown = desk.mask_shown(obj.document, 1)
    assert shown is not None and shown.number == 2
    desk.use_tool(ToolRequest("next mask", 1, 1), "who")
    assert asked == [1, 2, 3, 3]


def test_the_mask_shown_is_told_until_something_else_is_said() -> None:
    prompts = (click(0), OTHER)
    shown = MaskShown(prompts, 1, 1, 4)
    assert shown.fits(Document(prompts=prompts), 1)
    assert not shown.fits(Document(prompts=prompts), 2)
    assert not shown.fits(Document(prompts=(*prompts, click(3))), 1)
