"""Work on one object of a scene in place, with its surroundings as ghosts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from app.server.scene_rows import Work
from app.server.scene_workspace import SceneWorkspace
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import fitting_distance
from app.viewer.steps.scene_choice import SceneChoice
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from model.core.errors import CommandError


class SceneEdit:
    """Opens objects of a scene, and goes back to it.

    Args:
        show: gets the session of an object to open, or None to close it, and whether its worst
            finding is shown.
        remember: keeps in the browser what is worked on.
        stop: ends what moves in the scene.

    Attributes:
        choice: the selected object.
        inside: the object that is worked on, or None.
    """

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        picture: ScenePicture,
        show: Callable[[int | None, bool], None],
        remember: Callable[[], None],
        stop: Callable[[], None],
    ) -> None:
        self._tab, self._workspace, self._picture = tab, workspace, picture
        self._show, self._remember, self._stop = show, remember, stop
        self.inside: str | None = None
        self.choice = SceneChoice(tab, workspace, picture, self._leave_other, remember)
        self._eye: Any = None

    def _leave_other(self, id: str | None) -> None:
        if self.inside is not None and id is not None and id != self.inside:
            self.leave()

    def enter(self) -> None:
        """Work on the selected object."""
        id = self.choice.need()
        self._stop()

        def opened(work: Work) -> None:
            self._tab.act(lambda: self._open(id, work.id))

        self._workspace.open_work(id, opened)

    def _open(self, id: str, session: int, *, picking: bool = False) -> None:
        self.inside = self.choice.selected = id
        self._tab.selection.picking = picking
        self._picture.ghost(id)
        work = self._workspace.work(id)
        refusal = None if work is None or picking else self._workspace.accepting.refusal(work)
        self._show(session, refusal is not None and refusal.report is not None)

    def leave(self) -> None:
        """Go back to the scene."""
        if self.inside is None:
            return
        self.inside, self._tab.selection.picking = None, False
        self._show(None, False)
        self._picture.unghost()
        self._remember()

    def pick(self) -> None:
        """Open the selected object as a whole, to pick another one out of it."""
        id = self.choice.need()
        self._stop()
        self._workspace.picking.open(
            id, lambda session: self._tab.act(lambda: self._open(id, session, picking=True))
        )

    def take_out(self, name: str) -> None:
        """Make the selected part an object of the scene, and work on that next.

        Raises:
            CommandError: where nothing is picked from, or nothing was clicked yet.
        """
        tab, selection = self._tab, self._tab.selection
        if self.inside is None or not selection.picking:
            raise CommandError(words.EXTRACT_NOTHING)

        def taken(id: str) -> None:
            tab.act(lambda: self._taken(id))

        obj = selection.need_object()
        self._workspace.picking.take_out(obj, self.inside, selection.part, name, tab.user, taken)

    def _taken(self, id: str) -> None:
        eye = self._picture.in_scene(np.array(self._tab.client.camera.position))
        self.leave()
        self.choice.choose(id)
        self._eye = eye
        self.enter()

    def look_as_before(self) -> None:
        """Aim at the object that was just drawn.

        Where another one is picked out of it, from where the camera was; where it was picked out,
        from the same side, but near; else it is seen from its front.
        """
        eye, self._eye = self._eye, None
        picture = self._picture
        if self._tab.selection.picking and picture.camera is not None:
            picture.look_from(*picture.camera)
        elif eye is not None:
            asset = self._tab.selection.need_object().asset
            assert asset is not None
            at = picture.in_scene(asset.bounds.mean(0))
            away = eye - at
            far = float(np.linalg.norm(away))
            near = 1.3 * fitting_distance(self._tab.client.camera, asset.diagonal)
            picture.look_from(at + away * (min(near, far) / max(far, 1e-9)), at)
