"""The selected object of a scene: choosing it, work on it in place with its surroundings as ghosts,
and decisions without opening it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.server.scene_state import Row, Work, order
from app.server.scene_workspace import SceneWorkspace
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import fitting_distance
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from app.viewer.words.common import CHOSEN, REDO_EMPTY, UNDO_EMPTY
from model.core.errors import CommandError
from sessions import commands as cmd
from sessions.document import review_problems
from sessions.review import RejectReason
from sessions.scene_commands import DecideObjects


@dataclass(frozen=True)
class SceneHost:
    """Callbacks of a scene.

    Attributes:
        show: gets the session of an object to open, or None to close it.
        remember: keeps in the browser where its user is.
        accept, reject: what the buttons do, once the object has been seen.
    """

    show: Callable[[int | None], None]
    remember: Callable[[], None]
    accept: Callable[[], None]
    reject: Callable[[], None]


def remarks_text(workspace: SceneWorkspace, rows: Sequence[Row]) -> str:
    """Objects that can't be decided, as text; "" for none. The list has the numbers of others."""
    if workspace.scene is None:
        return workspace.problem or words.STILL_READING
    return remarks_of(rows)


def remarks_of(rows: Sequence[Row]) -> str:
    """The same for a scene that was read."""
    if len(rows) == 1 and rows[0].status == "static":
        return words.EXTRACT_FIRST
    lost = sum(r.status in ("missing", "failed") for r in rows)
    if lost:
        return words.lost(lost)
    return "" if any(r.work is not None for r in rows) else words.NOTHING_ARTICULABLE


class SceneChoice:
    """Chooses objects of a scene, by a click, from the list, or one after the other; opens them in
    place, and goes back.

    Args:
        stop: ends what moves in the scene.

    Attributes:
        selected: the selected object, or None.
        inside: the object that is worked on, or None.
        rows: all objects as they were drawn last.
    """

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        picture: ScenePicture,
        host: SceneHost,
        stop: Callable[[], None],
    ) -> None:
        self._tab, self._workspace, self._picture = tab, workspace, picture
        self._host, self._stop = host, stop
        self.selected: str | None = None
        self.inside: str | None = None
        self.rows: list[Row] = []
        self._eye: Any = None

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
        if id not in (None, self.inside):
            self.leave()
        self.selected = id
        self._host.remember()
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
        text = remarks_text(self._workspace, self._workspace.rows())
        self._tab.notify(words.NOTHING_TO_DECIDE, text, "gray")

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

    def enter(self) -> None:
        """Work on the selected object."""
        id = self.need()
        self._stop()

        def opened(work: Work) -> None:
            self._tab.act(lambda: self._open(id, work.id))

        self._workspace.open_work(id, opened)

    def _open(self, id: str, session: int, *, picking: bool = False) -> None:
        self.inside = self.selected = id
        self._tab.selection.picking = picking
        self._picture.ghost(id)
        self._host.show(session)

    def leave(self) -> None:
        """Go back to the scene."""
        if self.inside is None:
            return
        self.inside, self._tab.selection.picking = None, False
        self._host.show(None)
        self._picture.unghost()
        self._host.remember()

    def pick(self) -> None:
        """Open the selected object as a whole, to pick another one out of it."""
        id = self.need()
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
        self.choose(id)
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


class SceneReview:
    """Accepts and rejects the selected object, and undoes decisions about the scene."""

    def __init__(self, tab: Tab, workspace: SceneWorkspace, choice: SceneChoice) -> None:
        self._tab, self._workspace, self._choice = tab, workspace, choice

    def classify(self, label: str) -> None:
        """Say whether the selected object is articulable."""
        articulable = label.removeprefix(CHOSEN) == words.ARTICULABLE
        self._workspace.set_articulable(self._choice.need(), articulable, self._tab.user)

    def accept(self) -> None:
        """Accept the selected object, and go to the next one."""
        work, id, accepting = (
            self._choice.need_work(),
            self._choice.need(),
            self._workspace.accepting,
        )
        if work.document.review.state == "accepted":
            raise CommandError(words.already_accepted(id))
        if accepting.mark(work) == "validating":
            raise CommandError(words.already_checking(id))
        if problems := review_problems(work.document):
            raise CommandError(words.has_problems(id, "; ".join(problems)))
        refusal = accepting.refusal(work)
        looked = refusal is not None and refusal.only_warnings
        if refusal is not None and refusal.report is not None and not looked:
            raise CommandError(words.has_errors(id, refusal.why))
        self._decide(DecideObjects("accept", (work.id,), looked=looked))

    def reject(self, reason: RejectReason) -> None:
        """Reject the selected object, and go to the next one."""
        work = self._choice.need_work()
        self._decide(DecideObjects("reject", (work.id,), reason=reason))

    def _decide(self, command: DecideObjects) -> None:
        tab, workspace, choice = self._tab, self._workspace, self._choice
        ids = order(workspace.rows())
        at = ids.index(choice.selected) if choice.selected in ids else -1
        mine = set(workspace.twins(choice.need()))
        workspace.do(command, tab.user, tab.notify)
        ahead = [i for i in [*ids[at + 1 :], *ids[: max(at, 0)]] if i not in mine]
        if ahead:
            choice.choose(ahead[0], look=True)
        else:
            choice.say_end()

    def undo(self) -> None:
        """Take back the last decision about the scene."""
        undone = self._workspace.undo(self._tab.user)
        self._tab.notify(words.undone(undone) if undone else UNDO_EMPTY, "", "gray")

    def redo(self) -> None:
        """Do again what was taken back."""
        if self._workspace.live.state.can_redo:
            self._workspace.do(cmd.Redo(), self._tab.user)
        else:
            self._tab.notify(REDO_EMPTY, "", "gray")
