"""Readable list of the prompts: a click and the other masks that it was given are one entry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import viser

from app.server.tool_tasks import NEXT_MASK
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import annotate as words
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Document, RegionRef

PROMPTS_SHOWN = 12
Prompt = Click | RegionRef


@dataclass(frozen=True)
class PromptEntry:
    """One line of the list.

    Attributes:
        part: its part.
        index: of its first prompt among all.
        count: prompts that it stands for.
        label: its text.
    """

    part: int
    index: int
    count: int
    label: str


class PromptList:
    """The newest prompts of the selected part; a click removes one."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        gui = tab.client.gui
        with gui.add_folder(words.PROMPTS):
            self._note = gui.add_markdown("")
            actions = gui.add_button_group(words.PROMPTS_REMOVE, words.PROMPT_ACTIONS)
            self._box = gui.add_folder(words.PROMPT_LIST, expand_by_default=False)
            self._buttons: list[tuple[Any, PromptEntry]] = []
        actions.on_click(lambda e: tab.act(lambda: self.remove(e.target.value)))

    def remove(self, which: str) -> None:
        """Remove prompts of the selected part, or all; ``which`` is a button."""
        last, _, every = words.PROMPT_ACTIONS
        tab, part = self._tab, self._tab.selection.part
        prompts = tab.selection.need_object().document.prompts
        mine = [entry for entry in prompt_entries(prompts) if entry.part == part]
        if which == every and prompts:
            tab.do(cmd.ClearPrompts())
        elif not mine:
            text = words.NONE_ON_PART if prompts else words.NO_PROMPTS
            tab.notify(words.PROMPTS_REMOVE, text, "gray")
        elif which == last:  # of those that are listed
            tab.do(cmd.RemovePrompt(mine[-1].index, mine[-1].count))
        else:
            tab.do(cmd.ClearPrompts(part))

    def draw(self, doc: Document, elements: str) -> None:
        """Bring the list up to date.

        Args:
            elements: what one element of the object is, "face" or "point".
        """
        tab = self._tab
        entries = prompt_entries(doc.prompts, elements)
        mine = [entry for entry in entries if entry.part == tab.selection.part]
        note = words.prompt_count(len(mine), len(entries))
        put(self._note, "content", note if doc.prompts else words.NO_PROMPTS)
        wanted = mine[-PROMPTS_SHOWN:]
        if [entry for _, entry in self._buttons] == wanted:
            return
        for button, _ in self._buttons:
            button.remove()
        self._buttons = []
        for entry in wanted:
            with self._box:
                button = tab.client.gui.add_button(entry.label, icon=viser.Icon.X, color="gray")
            remove = cmd.RemovePrompt(entry.index, entry.count)
            button.on_click(lambda _, remove=remove: tab.act(lambda: tab.do(remove)))
            self._buttons.append((button, entry))


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
                label = f"{clicked.label}, {words.OTHER_MASK}"
                out.append(PromptEntry(clicked.part, clicked.index, 2, label))
                continue
            if _is_mask(before):
                one = out.pop()
                out.append(PromptEntry(one.part, one.index, one.count + 1, one.label))
                continue
        out.append(PromptEntry(prompt.part, index, 1, _label(prompt, elements)))
    return out


def _is_mask(prompt: Prompt) -> bool:
    return isinstance(prompt, RegionRef) and prompt.tool == NEXT_MASK


def _label(prompt: Prompt, elements: str) -> str:
    sign = "+" if prompt.positive else "−"
    if isinstance(prompt, Click):
        return words.prompt_click(sign, prompt.position)
    if prompt.tool == NEXT_MASK:
        return words.OTHER_MASK
    return words.prompt_region(sign, prompt.tool, prompt.count, elements)
