"""What a person does in a scene: choose, decide, work on one object in place, play, save."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from app.server.scene_rows import Row, Work, decided_text
from app.server.scene_workspace import SceneDesk
from app.viewer.panels.pick_panel import PickPanel
from app.viewer.panels.scene_card import SceneCard
from app.viewer.panels.scene_list import SceneList, order
from app.viewer.picture.scene_motion import SceneMotion
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import fitting_distance
from model.core.errors import CommandError
from sessions import commands as cmd
from sessions.review import RejectReason
from sessions.scene_commands import DecideObjects
from sessions.state import review_problems

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

LABEL = "● "


def _at_the_end(desk: SceneDesk) -> tuple[str, str, str]:
    """What is told where nothing waits for a decision: title, words, colour."""
    if desk.scene is None:
        if desk.problem:
            return "Nothing could be read", desk.problem, "red"
        return "Not yet", "The scene is still being read", "gray"
    rows = [r for r in desk.rows() if r.work is not None]
    if not desk.items:
        return "Nothing could be read", "The scene holds no object", "yellow"
    if not rows:
        return "Nothing to decide", "No object of the scene counts as articulable", "gray"
    going = sum(r.mark == "judging" for r in rows)
    if going:
        return "Nothing else to decide", f"{going} being judged", "gray"
    return "Everything is decided", f"{decided_text(rows)}. Save the scene", "green"


class InScene:
    """One tab's way through the scene.

    Attributes:
        selected: the chosen object, or None.
        inside: the object that is worked on in place, or None.
        picking: whether that is to have an object picked out of it.
        rows: all objects as they were drawn last.
    """

    def __init__(self, app: ClientApp, desk: SceneDesk) -> None:
        self._app, self.desk = app, desk
        self.selected: str | None = None
        self.inside: str | None = None
        self.picking = False
        self.rows: list[Row] = []
        self._wanted: tuple[str, str] | None = None
        self._eye: Any = None
        self._seen = False
        self._moment: Any = None
        self.picture = ScenePicture(app.client, desk)
        self.motion = SceneMotion(self.picture.pose)
        self.list = SceneList(app, desk)
        self.unwatch = desk.watch(app.invalidate, app.notify)

    def build_pick_panel(self) -> None:
        """Make the widgets above the tools for one object."""
        self.pick_panel = PickPanel(self._app)

    def build_card(self) -> None:
        """Make the widgets of the right side."""
        self.folder = self._app.client.gui.add_folder(None)
        with self.folder:
            self.card = SceneCard(self._app, self.desk)

    def draw(self) -> None:
        """Bring picture and panels up to date."""
        desk = self.desk
        self.rows = desk.rows()
        if self.selected not in desk.items:
            self.selected = None
        if desk.scene is not None and not self._seen:
            self._seen = True
            if len(desk.items) == 1:  # a room: there is nothing else to choose
                self.selected = next(iter(desk.items))
        if self._wanted is not None and desk.scene is not None:
            (inside, chosen), self._wanted = self._wanted, None
            if inside in desk.items and desk.work(inside) is not None:
                self.selected = inside
                self._app.act(self.enter)
            elif chosen in desk.items:
                self._app.act(lambda: self.choose(chosen))
        self.picture.draw(self.rows, self.selected)
        self._show_moment()
        self.list.draw()
        self.pick_panel.draw()
        if self.inside is None:
            self.card.draw()

    def _show_moment(self) -> None:
        """Pose the chosen object as the gate objects to it; everything else rests."""
        work = None if self.selected is None or self.inside else self.desk.work(self.selected)
        refusal = None if work is None else self.desk.accepting.refusal(work)
        if self.motion.playing:
            self._moment = None
            return
        if refusal is self._moment:
            return
        self._moment = refusal
        report, tree = None, None
        if refusal is not None:
            report, tree = refusal.report, refusal.document.tree
        worst = None if report is None else report.joints[0].worst
        if work is None or worst is None or tree is None:
            self.picture.pose({})
        else:
            self.picture.pose({work.id: tree.pose(worst.q)})

    def close(self) -> None:
        """The tab is gone."""
        self.unwatch()
        self.motion.stop()
        self.picture.close()

    def come_back(self, inside: str, chosen: str) -> None:
        """As soon as the scene is read, work on an object again, or choose one: the page was
        loaded again."""
        self._wanted = inside, chosen

    # --- choosing

    def click(self, origin: Any, direction: Any) -> None:
        """A click in the picture chooses an object, or none."""
        hit = self.picture.pick(np.asarray(origin, float), np.asarray(direction, float))
        self.choose(hit)

    def choose(self, id: str | None, *, look: bool = False) -> None:
        """Show why an object is as it is; ``look`` turns the camera to it."""
        if self.inside is not None and id is not None and id != self.inside:
            self.leave()
        self.selected = id
        self._app.remember()
        self.desk.prefer(id)
        if look and id is not None and self.inside is None:
            self.picture.frame([id], front=True)
        self._app.invalidate()

    def step(self, by: int) -> None:
        """To the next or previous object that wants a decision."""
        ids = order(self.desk.rows())
        if not ids:
            self._app.notify(*_at_the_end(self.desk))
            return
        if self.selected in ids:
            self.choose(ids[(ids.index(self.selected) + by) % len(ids)], look=True)
        else:
            self.choose(ids[0 if by > 0 else -1], look=True)

    def need(self) -> str:
        """The chosen object.

        Raises:
            CommandError: where none is chosen.
        """
        if self.selected is None:
            raise CommandError("choose an object first: click it, or press N")
        return self.selected

    def need_work(self) -> Work:
        """The chosen object's working copy.

        Raises:
            CommandError: where there is none.
        """
        work = self.desk.work(self.need())
        if work is None:
            raise CommandError(f"{self.selected} counts as static: there is nothing to decide")
        return work

    # --- deciding

    def say(self, label: str) -> None:
        """Whether the chosen object is articulable."""
        articulable = label.removeprefix(LABEL) == "Articulable"
        self.desk.set_articulable(self.need(), articulable, self._app.who)

    def accept(self) -> None:
        """Accept the chosen object, and go to the next one."""
        work, id = self.need_work(), self.need()
        if work.document.tree is None:
            raise CommandError(f"{id} has no joints yet: press Enter to work on it")
        if work.document.review.state == "accepted":
            raise CommandError(f"{id} is accepted already")
        if self.desk.accepting.mark(work) == "judging":
            raise CommandError(f"{id} is being judged already")
        problems = review_problems(work.document)
        if problems:
            raise CommandError(f"{id}: {'; '.join(problems)}. Enter opens it")
        refusal = self.desk.accepting.refusal(work)
        if refusal is not None and refusal.report is not None and not refusal.wants_a_look:
            raise CommandError(
                f"{id}, {refusal.why} Enter shows where: mend it, or say why it is right"
            )
        looked = refusal is not None and refusal.wants_a_look
        self._decide(DecideObjects("accept", (work.id,), looked=looked))

    def reject(self, reason: RejectReason) -> None:
        """Reject the chosen object, and go to the next one."""
        work = self.need_work()
        self._decide(DecideObjects("reject", (work.id,), reason=reason))

    def _decide(self, command: DecideObjects) -> None:
        ids = order(self.desk.rows())
        at = ids.index(self.selected) if self.selected in ids else -1
        mine = set(self.desk.twins(self.need()))
        self.desk.do(command, self._app.who, self._app.notify)
        ahead = [i for i in [*ids[at + 1 :], *ids[: max(at, 0)]] if i not in mine]
        following = next((i for i in ahead if self._waits(i)), None)
        if following is not None:
            self.choose(following, look=True)
        elif ahead:
            coming = sum(self.desk.to_come(r) for r in self.desk.rows() if r.id in ahead)
            left = len(ahead) - coming
            said = [f"{coming} still to be predicted"] if coming else []
            if left:
                said.append(f"{left} {'wants' if left == 1 else 'want'} you: N, then Enter")
            self._app.notify("Nothing else is predicted", "; ".join(said), "gray")
        else:
            self._app.notify(*_at_the_end(self.desk))

    def _waits(self, id: str) -> bool:
        work = self.desk.work(id)
        return work is not None and work.document.review.state == "predicted" and (
            self.desk.accepting.mark(work) != "judging")  # fmt: skip

    def sure(self, above: float) -> list[int]:
        """Sessions of predicted objects that are at least so sure, each once."""
        found = [
            r.work for r in self.rows
            if r.shown == "predicted" and r.work is not None and r.confidence >= above
        ]  # fmt: skip
        return list(dict.fromkeys(found))

    def accept_above(self, above: float) -> None:
        """Accept all that are at least so sure; the gate still has its say."""
        ids = self.sure(above)
        if not ids:
            raise CommandError("no predicted object is so sure")
        command = DecideObjects("accept", tuple(ids), above=above)
        self.desk.do(command, self._app.who, self._app.notify)

    def undo(self) -> None:
        """Take back the last decision about the scene."""
        undone = self.desk.undo(self._app.who)
        self._app.notify(f"Undone: {undone}" if undone else "Nothing to undo", "", "gray")

    def redo(self) -> None:
        """Do again what was taken back."""
        if self.desk.live.state.can_redo:
            self.desk.do(cmd.Redo(), self._app.who)
        else:
            self._app.notify("Nothing to redo", "", "gray")

    # --- working on one object in place

    def enter(self) -> None:
        """Work on the chosen object; its surroundings become ghosts."""
        app, id = self._app, self.need()
        self.motion.stop()

        def opened(work: Work) -> None:
            app.act(lambda: self._show(id, work.id))

        self.desk.open_work(id, opened)

    def _show(self, id: str, session: int, *, picking: bool = False) -> None:
        self.inside = self.selected = id
        self.picking = picking
        self.picture.ghost(id)
        self._app.open(session)
        work = self.desk.work(id)
        refusal = None if work is None or picking else self.desk.accepting.refusal(work)
        if refusal is not None and refusal.report is not None:
            self._app.set_stage("Review")
            self._app.review_panel.gate.show_worst()

    def pick(self) -> None:
        """Open the chosen object as a whole, to pick another one out of it."""
        app, id = self._app, self.need()
        self.motion.stop()
        self.desk.picking.open(
            id, lambda session: app.act(lambda: self._show(id, session, picking=True))
        )

    def take_out(self, name: str) -> None:
        """The chosen part becomes an object of the scene, and is worked on next.

        Raises:
            CommandError: where nothing is picked from, or nothing was clicked yet.
        """
        app = self._app
        if self.inside is None or not self.picking:
            raise CommandError("choose an object of the scene and press “Pick an object out of it”")

        def taken(id: str) -> None:
            app.act(lambda: self._taken(id))

        self.desk.picking.take_out(app.need_object(), self.inside, app.part, name, app.who, taken)

    def _taken(self, id: str) -> None:
        self.pick_panel.clear()
        eye = self.picture.in_scene(np.array(self._app.client.camera.position))
        self.leave()
        self.choose(id)
        self._eye = eye
        self.enter()

    def look_as_before(self) -> None:
        """The object was just drawn: look at it from where the person looked at it last, who
        picks from it; from the same side, but near, who picked it out. What is opened otherwise
        is seen from its front."""
        eye, self._eye = self._eye, None
        if self.picking and self.picture.camera is not None:
            self.picture.look_from(*self.picture.camera)
        elif eye is not None:
            asset = self._app.need_object().asset
            assert asset is not None
            at = self.picture.in_scene(asset.bounds.mean(0))
            away = eye - at
            far = float(np.linalg.norm(away))
            near = 1.3 * fitting_distance(self._app.client.camera, asset.diagonal)
            self.picture.look_from(at + away * (min(near, far) / max(far, 1e-9)), at)

    def leave(self) -> None:
        """Back to the scene."""
        if self.inside is None:
            return
        self.inside, self.picking = None, False
        self._app.close_object()
        self.picture.unghost()
        self._app.remember()

    # --- motion and files

    def play(self) -> None:
        """Start or stop moving the joints of the chosen object; of all where none is chosen."""
        work = None if self.selected is None else self.desk.work(self.selected)
        self._play(None if work is None or work.document.tree is None else work)

    def play_all(self) -> None:
        """Start or stop moving all joints of the scene."""
        self._play(None)

    def play_joint(self, name: str) -> None:
        """Move one joint of the chosen object, whatever moved before."""
        self.motion.stop()
        self._play(self.need_work(), name)

    def _play(self, work: Work | None, joint: str | None = None) -> None:
        works = [w for w in self.desk.wanted() if w.drawn is not None and work in (None, w)]
        if self.motion.playing:
            self.motion.stop()
        elif not self.motion.play(works, joint):
            self._app.notify("No joints yet", "They move once objects are predicted", "gray")
        self._app.invalidate()

    def save(self, loose: bool) -> None:
        """Write the scene with what is accepted, or also what is only predicted."""
        self.desk.saving.save(loose, self._app.who)

    def report(self) -> None:
        """Write the report and send it to the browser."""
        client = self._app.client
        self.desk.saving.report(
            lambda path: client.send_file_download(path.name, path.read_bytes())
        )
