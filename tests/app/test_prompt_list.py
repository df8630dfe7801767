from __future__ import annotations

from app.viewer.prompt_list import prompt_entries
from model.segmentation.prompts import Click
from sessions.document import RegionRef

REF = "a" * 64


def mask(part: int, positive: bool) -> RegionRef:
    return RegionRef(part, REF, positive, 10, "next mask")


def test_a_click_with_another_mask_is_one_entry():
    click = Click((0.1, 0.2, 0.3), 1)
    prompts = (click, mask(1, False), mask(1, True), Click((0, 0, 0), 1, False))
    first, second = prompt_entries(prompts)
    assert (first.index, first.count) == (0, 3) and (second.index, second.count) == (3, 1)
    assert first.label == "+  0.100, 0.200, 0.300 m, other mask"


def test_masks_of_another_part_or_without_a_click_stand_alone():
    prompts = (mask(2, True), Click((0, 0, 0), 1), mask(2, True), RegionRef(1, REF, True, 1234))
    found = [(e.part, e.index, e.count, e.label) for e in prompt_entries(prompts)[::2]]
    assert found == [(2, 0, 1, "other mask"), (2, 2, 1, "other mask")]
    assert prompt_entries(prompts)[3].label == "+  box: 1,234 elements"
    assert prompt_entries((mask(1, False), mask(1, True)))[0].count == 2
