from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from app.server.tool_tasks import NEXT_MASK, TOOLS
from app.viewer.panels.comments import what_happened
from app.viewer.panels.part_list import PromptList, parts_listed, prompt_entries
from app.viewer.words.annotate import TOOL_ROWS
from model.core.joint import Joint
from model.segmentation.prompts import Click
from sessions.commands import ClearPrompts, RemovePrompt, ResetJoint, SetJoint
from sessions.document import Document, PartInfo, RegionRef
from sessions.tool_commands import ApplyTool, ToolRegion

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
    assert prompt_entries(prompts)[3].label == "+  Box · 1,234 faces"
    assert prompt_entries((mask(1, False), mask(1, True)))[0].count == 2


def test_what_tools_did_is_called_as_on_their_buttons():
    buttons = {button for row in TOOL_ROWS for button in row.values()} | {"Box"}
    for tool in {*TOOLS, "lasso", "brush"} - {NEXT_MASK}:
        (entry,) = prompt_entries((RegionRef(1, REF, False, 1, tool),), "point")
        sign, label = entry.label.split("  ")
        word, count = label.split(" · ")
        assert word in buttons and (sign, count) == ("−", "1 point")


def test_the_history_speaks_as_the_screens_do():
    doc = Document(parts=(PartInfo(0), PartInfo(1, "door"), PartInfo(2)))
    joint = Joint("joint_link_2", "continuous", "link_0", "link_2", (0, 0, 1))
    proposed = ApplyTool("propose", tuple(ToolRegion(p, REF) for p in (1, 2)))
    assert what_happened(doc, proposed) == "all parts, 2 parts"
    assert what_happened(doc, SetJoint(joint)) == "change the joint of part 2"
    assert what_happened(doc, ResetJoint("link_1")) == "reset the joint of door 1"


def test_what_is_removed_is_of_the_part_whose_prompts_are_listed():
    prompts = tuple(Click((0.0, 0.0, 0.0), part) for part in (1, 1, 2))
    done: list[object] = []
    obj = SimpleNamespace(document=SimpleNamespace(prompts=prompts))
    selection = SimpleNamespace(part=1, need_object=lambda: obj)
    tab = SimpleNamespace(selection=selection, do=done.append)
    tab.notify = lambda *said: done.append(said[1])
    panel: Any = SimpleNamespace(_tab=tab)

    def press(part: int, action: str) -> object:
        selection.part = part
        PromptList.remove(panel, action)
        return done[-1]

    assert press(1, "Last") == RemovePrompt(1, 1)
    assert press(2, "Last") == RemovePrompt(2, 1)
    assert press(3, "Last") == press(3, "Of this part") == "This part has no prompts"
    assert press(1, "Of this part") == ClearPrompts(1)
    assert press(3, "All") == ClearPrompts()
    assert len(done) == 6


def test_the_chosen_part_has_a_button_however_many_there_are():
    remote = range(58)  # the keys of a remote control
    assert parts_listed(remote, 57) == list(remote)
    assert parts_listed((), 3) == [0, 3]
    many = parts_listed(range(1, 900), 850)
    assert len(many) == 200 and many[:3] == [0, 1, 2] and many[-1] == 850
