"""The selected object of a scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from app.server.scene_rows import Row, Work, decided_text
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.scene_list import order
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from model.core.errors import CommandError


def _at_the_end(workspace: SceneWorkspace) -> tuple[str, str, str]:
    """Why nothing waits for a decision: title, text, color."""
    if workspace.scene is None:
        if workspace.problem:
            return words.READ_NOTHING, workspace.problem, "red"
        return *words.STILL_READING, "gray"
    rows = [r for r in workspace.rows() if r.work is not None]
    if not workspace.items:
        return words.READ_NOTHING, words.NO_OBJECTS, "yellow"
    if not rows:
        return *words.NOTHING_TO_DECIDE, "gray"
    checking = sum(r.mark == "validating" for r in rows)
    if checking:
        return *words.still_checking(checking), "gray"
    return *words.done(decided_text(rows)), "green"


class SceneChoice:
    """Chooses objects of a scene, by a click, from the list, or one after the other.

    Args:
        leave_other: gets each choice first; leaves what is worked on where that is another object.
        remember: keeps the choice in the browser.

    Attributes:
        selected: the selected object, or None.
        rows: all objects as they were drawn last.
    """

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        picture: ScenePicture,
        leave_other: Callable[[str | None], None],
        remember: Callable[[], None],
    ) -> None:
        self._tab, self._workspace, self._picture = tab, workspace, picture
        self._leave_other, self._remember = leave_other, remember
        self.selected: str | None = None
        self.rows: list[Row] = []

    def refresh(self) -> None:
        """Take in what changed in the scene."""
        self.rows = self._workspace.rows()
        if self.selected not in self._workspace.items:
            self.selected = None

    def click(self, origin: Any, direction: Any) -> None:
        """Choose the object under a ray, or none."""
        self.choose(self._picture.pick(np.asarray(origin, float), np.asarray(direction, float)))

    def choose(self, id: str | None, *, look: bool = False) -> None:
        """Choose an object, or none; ``look`` turns the camera to it."""
        self._leave_other(id)
        self.selected = id
        self._remember()
        self._workspace.prefer(id)
        if look and id is not None and self._tab.selection.object is None:
            self._picture.frame([id], front=True)
        self._tab.invalidate()

    def step(self, by: int) -> None:
        """Choose the next undecided object, or with -1 the one before."""
        ids = order(self._workspace.rows())
        if not ids:
            self.say_end()
        elif self.selected in ids:
            self.choose(ids[(ids.index(self.selected) + by) % len(ids)], look=True)
        else:
            self.choose(ids[0 if by > 0 else -1], look=True)

    def say_end(self) -> None:
        """Say why no object is left to decide."""
        self._tab.notify(*_at_the_end(self._workspace))

    def need(self) -> str:
        """The selected object.

        Raises:
            CommandError: where none is chosen.
        """
        if self.selected is None:
            raise CommandError(words.NEED_SELECTION)
        return self.selected

    def need_work(self) -> Work:
        """The selected object's working copy.

        Raises:
            CommandError: where there is none.
        """
        work = self._workspace.work(self.need())
        if work is None:
            raise CommandError(words.is_static(self.need()))
        return work
