"""A whole scene in one tab: its list, its picture, and the card of the selected object."""

from __future__ import annotations

from typing import Any

import viser

from app.server.scene_state import Work
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.extracting import PickPanel
from app.viewer.panels.reviewing import Rejecting
from app.viewer.panels.scene_panels import SceneCard
from app.viewer.panels.widgets import Presses, push_button, put
from app.viewer.picture.motion import SceneMotion
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.steps.scene_selection import SceneChoice, SceneHost, SceneReview
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from app.viewer.words.common import NO_JOINTS


class SceneStep:
    """The screens of a scene.

    Attributes:
        choice: the selected object, and the one that is open in place.
        review: decides about them.
        picture: what is drawn.
        motion: joints that play.
        card: the right side.
    """

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        rejecting: Rejecting,
        host: SceneHost,
        presses: Presses,
    ) -> None:
        self._tab, self._workspace = tab, workspace
        self._wanted: tuple[str, str] | None = None
        self._was_read = False
        self._moment: Any = None
        self.picture = ScenePicture(tab.client, workspace)
        self.motion = SceneMotion(self.picture.pose)
        self.choice = SceneChoice(tab, workspace, self.picture, host, self.motion.stop)
        self.review = SceneReview(tab, workspace, self.choice)
        self._folder = tab.client.gui.add_folder(None)
        with self._folder:
            self.card = SceneCard(
                tab,
                workspace,
                rejecting,
                self.choice,
                self.review,
                host,
                self.picture,
                presses,
                self._play_from_card,
            )
        self._pick_panel: PickPanel | None = None
        self._unwatch = workspace.watch(tab.invalidate, tab.notify)
        presses.on("frame", lambda _: self.frame())

    def build_object_widgets(self) -> None:
        """Make the widgets above everything else about one object."""
        icon = viser.Icon.ARROW_LEFT
        push_button(self._tab, words.BACK, self.choice.leave, icon=icon, color="dark")
        self._pick_panel = PickPanel(self._tab, self.choice.take_out)

    @property
    def in_front(self) -> bool:
        """True if the scene is shown, and none of its objects is edited."""
        return self._tab.selection.object is None

    @property
    def subject(self) -> Any:
        """The subject of a decision made now, as far as the user can see it."""
        selected, workspace = self.choice.selected, self._workspace
        work = None if selected is None else workspace.work(selected)
        if work is None:
            return None if workspace.scene is None else (selected,)
        return selected, work.document.review, workspace.accepting.why_refused(work)

    def draw(self) -> None:
        """Bring picture and panels up to date."""
        workspace, choice = self._workspace, self.choice
        choice.refresh()
        if workspace.scene is not None and not self._was_read:
            self._was_read = True
            if len(workspace.items) == 1:  # a room: there is nothing else to choose
                choice.selected = next(iter(workspace.items))
        if self._wanted is not None and workspace.scene is not None:
            (inside, chosen), self._wanted = self._wanted, None
            if inside in workspace.items and workspace.work(inside) is not None:
                choice.selected = inside
                self._tab.act(self.choice.enter)
            elif chosen in workspace.items:
                self._tab.act(lambda: choice.choose(chosen))
        self.picture.draw(choice.rows, choice.selected)
        self._show_moment()
        if self._pick_panel is not None:
            self._pick_panel.draw()
        put(self._folder, visible=self.in_front)
        if self.choice.inside is None:
            self.card.draw(choice.rows, choice.selected, self.motion.playing)

    def _show_moment(self) -> None:
        """Show the worst finding of the selected object; everything else rests."""
        workspace, selected = self._workspace, self.choice.selected
        work = None if selected is None or self.choice.inside else workspace.work(selected)
        refusal = None if work is None else workspace.accepting.refusal(work)
        if self.motion.playing:
            self._moment = None
            return
        report = None if refusal is None else refusal.report
        if report is self._moment:
            return
        self._moment = report
        worst = None if report is None else report.joints[0].worst
        tree = None if work is None else work.document.tree
        if work is None or worst is None or tree is None:
            self.picture.pose({})
        else:
            self.picture.pose({work.id: tree.pose(worst.q)})

    def restore(self, inside: str, chosen: str) -> None:
        """Work on an object again, or choose one, once the scene is read: the page was loaded
        again."""
        self._wanted = inside, chosen

    def close(self) -> None:
        """End what belongs to the tab."""
        self._unwatch()
        self.motion.stop()
        self.picture.close()

    # --- view and motion

    def frame(self) -> None:
        """Aim at the selected object, or at all of the scene."""
        selected = self.choice.selected
        self.picture.frame(None if selected is None else [selected])

    def play(self) -> None:
        """Start or stop moving the joints of the selected object; of all where none is chosen."""
        selected = self.choice.selected
        work = None if selected is None else self._workspace.work(selected)
        self._play(None if work is None or work.document.tree is None else work)

    def play_all(self) -> None:
        """Start or stop moving all joints of the scene."""
        self._play(None)

    def _play_from_card(self, joint: str | None) -> None:
        """Move all joints, or only one of the selected object, whatever moved before."""
        if joint is not None:
            self.motion.stop()
        self._play(None if joint is None else self.choice.need_work(), joint)

    def _play(self, work: Work | None, joint: str | None = None) -> None:
        works = [w for w in self._workspace.wanted() if w.drawn is not None and work in (None, w)]
        if self.motion.playing:
            self.motion.stop()
        elif not self.motion.play(works, joint):
            self._tab.notify(NO_JOINTS, words.PLAY_LATER, "gray")
        self._tab.invalidate()
