"""Decisions about objects of a scene, without opening them."""

from __future__ import annotations

from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.scene_list import order
from app.viewer.steps.scene_choice import SceneChoice
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from app.viewer.words.common import CHOSEN, REDO_EMPTY, UNDO_EMPTY
from model.core.errors import CommandError
from sessions import commands as cmd
from sessions.review import RejectReason
from sessions.scene_commands import DecideObjects
from sessions.state import review_problems


class SceneReview:
    """Accepts and rejects the selected object, or all above a confidence."""

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
        if work.document.tree is None:
            raise CommandError(words.no_joints(id))
        if work.document.review.state == "accepted":
            raise CommandError(words.already_accepted(id))
        if accepting.mark(work) == "validating":
            raise CommandError(words.already_checking(id))
        problems = review_problems(work.document)
        if problems:
            raise CommandError(words.has_problems(id, "; ".join(problems)))
        refusal = accepting.refusal(work)
        if refusal is not None and refusal.report is not None and not refusal.only_warnings:
            raise CommandError(words.has_errors(id, refusal.why))
        confirmed = refusal is not None and refusal.only_warnings
        self._decide(DecideObjects("accept", (work.id,), looked=confirmed))

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
        following = next((i for i in ahead if self._waits(i)), None)
        if following is not None:
            choice.choose(following, look=True)
        elif ahead:
            coming = sum(workspace.awaits_prediction(r) for r in workspace.rows() if r.id in ahead)
            left = words.remaining(coming, len(ahead) - coming)
            tab.notify(words.NO_MORE_PREDICTED, left, "gray")
        else:
            choice.say_end()

    def _waits(self, id: str) -> bool:
        work = self._workspace.work(id)
        return work is not None and work.document.review.state == "predicted" and (
            self._workspace.accepting.mark(work) != "validating")  # fmt: skip

    def above(self, confidence: float) -> list[int]:
        """Sessions of predicted objects of at least that confidence, 0..1, each once."""
        found = [
            r.work for r in self._choice.rows
            if r.shown == "predicted" and r.work is not None and r.confidence >= confidence
        ]  # fmt: skip
        return list(dict.fromkeys(found))

    def accept_above(self, confidence: float) -> None:
        """Accept all of at least that confidence, 0..1, that pass the checks."""
        ids = self.above(confidence)
        if not ids:
            raise CommandError(words.NONE_ABOVE)
        command = DecideObjects("accept", tuple(ids), above=confidence)
        self._workspace.do(command, self._tab.user, self._tab.notify)

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
