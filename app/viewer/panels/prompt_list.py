"""The prompts as a list for people: a click and the other masks that it was given are one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.server.tool_tasks import NEXT_MASK
from model.segmentation.prompts import Click
from sessions.document import RegionRef

Prompt = Click | RegionRef
_LABELS = {"propose": "All parts", "cut": "Line", "source": "From the file"}
"""Tools that are recorded under another word than their button's."""


@dataclass(frozen=True)
class PromptEntry:
    """One line of the list.

    Attributes:
        part: whose it is.
        index: of its first prompt among all.
        count: prompts that it stands for.
        label: what it says.
    """

    part: int
    index: int
    count: int
    label: str


def prompt_entries(prompts: Sequence[Prompt], elements: str = "face") -> list[PromptEntry]:
    """The lines of the list, in order.

    Args:
        elements: what one element of the object is, "face" or "point".
    """
    out: list[PromptEntry] = []
    for index, prompt in enumerate(prompts):
        before = prompts[index - 1] if index else None
        if _is_mask(prompt) and before is not None and before.part == prompt.part:
            if isinstance(before, Click):
                clicked = out.pop()
                label = f"{clicked.label}, other mask"
                out.append(PromptEntry(clicked.part, clicked.index, 2, label))
                continue
            if _is_mask(before):
                one = out.pop()
                out.append(PromptEntry(one.part, one.index, one.count + 1, one.label))
                continue
        out.append(PromptEntry(prompt.part, index, 1, _label(prompt, elements)))
    return out


def tool_label(tool: str) -> str:
    """What people call a tool that did something: as on its button."""
    return _LABELS.get(tool, tool[:1].upper() + tool[1:])


def _is_mask(prompt: Prompt) -> bool:
    return isinstance(prompt, RegionRef) and prompt.tool == NEXT_MASK


def _label(prompt: Prompt, elements: str) -> str:
    sign = "+" if prompt.positive else "−"
    if isinstance(prompt, Click):
        x, y, z = prompt.position
        return f"{sign}  {x:.3f}, {y:.3f}, {z:.3f} m"
    if prompt.tool == NEXT_MASK:
        return "other mask"
    return (
        f"{sign}  {tool_label(prompt.tool)} · {prompt.count:,} {elements}{'s'[: prompt.count != 1]}"
    )
