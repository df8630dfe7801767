"""The right side of a scene: the selected object, decisions for many, and what is saved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import viser

from app.server.names import display_text
from app.server.scene_accepting import Refusal
from app.server.scene_state import Row, Work, decided_text
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.joint_tree import JointRows
from app.viewer.panels.reviewing import RejectButtons, Rejecting
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab, plain
from app.viewer.words import common
from app.viewer.words import scene as words
from app.viewer.words.review import about, saved_in

PROBLEMS = 6
"""Problems of the file that are listed; the others are counted."""
Action = Callable[[], None]


@dataclass(frozen=True)
class SceneActions:
    """Callbacks of the widgets of a scene.

    Attributes:
        classify: gets "Articulable" or "Static" for the selected object.
        step: goes to the next object to decide (1) or to the one before (-1).
        accept_above: accepts all predicted objects of at least that confidence, 0..1.
        above: their sessions.
        save: writes the scene; True also with what is only predicted.
        play_joint: moves one joint of the selected object.
    """

    undo: Action
    redo: Action
    accept: Action
    reject: Action
    enter: Action
    pick: Action
    play_all: Action
    report: Action
    classify: Callable[[str], None]
    step: Callable[[int], None]
    accept_above: Callable[[float], None]
    above: Callable[[float], list[int]]
    save: Callable[[bool], None]
    play_joint: Callable[[str], None]


class SceneCard:
    """Widgets for a scene; they are hidden while one of its objects is worked on."""

    def __init__(
        self, tab: Tab, workspace: SceneWorkspace, rejecting: Rejecting, actions: SceneActions
    ) -> None:
        self._tab, self._workspace, self._actions = tab, workspace, actions
        gui = tab.client.gui
        self._status = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._pause = gui.add_button(
            words.PAUSE, icon=viser.Icon.PLAYER_PAUSE, color="gray", visible=False
        )
        self._cancel = gui.add_button(
            common.CANCEL, icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        self._again = gui.add_button(
            common.RETRY, icon=viser.Icon.REFRESH, color="gray", visible=False
        )
        self._history = gui.add_button_group(common.EDIT, common.HISTORY_ACTIONS)
        self._play = gui.add_button(words.PLAY, icon=viser.Icon.PLAYER_PLAY)
        with gui.add_folder(words.SELECTED):
            self._about = gui.add_markdown("")
            self._kind = gui.add_button_group(
                words.KIND, (words.ARTICULABLE, words.STATIC), visible=False
            )
            self._work = gui.add_button(words.EDIT, icon=viser.Icon.PENCIL, visible=False)
            self._pick = gui.add_button(
                words.PICK, icon=viser.Icon.SCISSORS, color="gray", visible=False
            )
            self._accept = gui.add_button(
                words.ACCEPT, icon=viser.Icon.CHECK, color="green", visible=False
            )
            self._reject = RejectButtons(tab, rejecting, actions.reject)
            self._step = gui.add_button_group(common.NAVIGATE, common.PREVIOUS_NEXT)
            self._joints = JointRows(tab, actions.play_joint)
        with gui.add_folder(words.BY_CONFIDENCE):
            self._above = gui.add_slider(words.MINIMUM, 0, 100, 1, 80)
            self._count = gui.add_markdown("")
            self._accept_all = gui.add_button(
                words.accept_count(0), icon=viser.Icon.CHECKS, color="green", disabled=True
            )
        with gui.add_folder(words.SAVE_FOLDER):
            self._loose = gui.add_checkbox(words.INCLUDE, False, hint=words.INCLUDE_HINT)
            self._save = gui.add_button(words.SAVE, icon=viser.Icon.DEVICE_FLOPPY)
            self._report = gui.add_button(words.REPORT, icon=viser.Icon.FILE_REPORT, color="gray")
            self._saved = gui.add_markdown("", visible=False)
        self._listen()

    def _listen(self) -> None:
        act, do = self._tab.act, self._actions
        self._pause.on_click(
            lambda _: act(lambda: self._workspace.pause(not self._workspace.paused))
        )
        self._cancel.on_click(lambda _: self._workspace.cancel())  # whatever the tab waits for
        self._again.on_click(lambda _: act(self._workspace.try_again))
        self._history.on_click(
            lambda e: act(do.undo if e.target.value == common.HISTORY_ACTIONS[0] else do.redo)
        )
        self._play.on_click(lambda _: act(do.play_all))
        self._kind.on_click(lambda e: act(lambda: do.classify(e.target.value)))
        self._work.on_click(lambda _: act(do.enter))
        self._pick.on_click(lambda _: act(do.pick))
        self._accept.on_click(lambda _: do.accept())
        self._step.on_click(
            lambda e: act(lambda: do.step(1 if e.target.value == common.PREVIOUS_NEXT[1] else -1))
        )
        self._above.on_update(lambda _: self._tab.invalidate())
        self._accept_all.on_click(lambda _: act(lambda: do.accept_above(self.above)))
        self._save.on_click(lambda _: act(lambda: do.save(self._loose.value)))
        self._report.on_click(lambda _: act(do.report))

    @property
    def above(self) -> float:
        """The confidence above which all are accepted, 0..1."""
        return self._above.value / 100

    def draw(self, rows: Sequence[Row], selected: str | None, moving: bool) -> None:
        """Bring the widgets up to date; ``moving`` while joints play."""
        workspace = self._workspace
        self._draw_status()
        put(self._play, "label", words.STOP if moving else words.PLAY)
        joints = any(w.document.tree is not None for w in workspace.wanted())
        put(self._play, "color", "blue" if joints else "gray")
        put(self._play, "icon", viser.Icon.PLAYER_STOP if moving else viser.Icon.PLAYER_PLAY)
        self._draw_chosen(selected)
        ready = self._actions.above(self.above)
        count = sum(r.work in ready for r in rows)
        coming = sum(workspace.awaits_prediction(r) for r in rows)
        put(self._count, "content", count_text(rows, count, self.above, coming))
        put(self._accept_all, "label", words.accept_count(count))
        put(self._accept_all, "disabled", not ready)
        saved = workspace.document.saved
        put(self._saved, "visible", saved is not None)
        if saved is not None:
            put(self._saved, "content", saved_in(plain(saved.folder, 300)))
        saving = "save" in workspace.busy
        put(self._save, "disabled", saving or workspace.scene is None)
        put(self._save, "label", words.SAVING if saving else words.SAVE)
        put(self._report, "disabled", "report" in workspace.busy or workspace.scene is None)

    def _draw_status(self) -> None:
        workspace = self._workspace
        lines = []
        if workspace.problem:
            lines.append(common.warning(plain(workspace.problem, 400)))
        # What was taken back may need a moment to stop; nobody waits for it any more.
        idle = () if workspace.accepting.waiting else ("accept",)
        busy = dict(workspace.busy)  # jobs end while this is drawn
        shown = [w for w in words.JOBS if w in busy and w not in idle]
        fraction = 0.0
        if shown:
            fraction, message = busy[shown[0]]
            lines.append(f"*{words.job(shown[0], plain(message))}*")
        problems = () if workspace.scene is None else workspace.scene.problems
        if problems:
            lines_of = [about(plain(p.object, 40), plain(p.text, 200)) for p in problems[:PROBLEMS]]
            lines.append(words.file_problems(lines_of, max(len(problems) - PROBLEMS, 0)))
        put(self._status, "content", "\n\n".join(lines))
        put(self._progress, "visible", bool(shown))
        put(self._progress, "value", round(100 * fraction, 1))
        reading = {"read", "shapes", "copy"} & set(busy)
        put(self._cancel, "visible", bool(reading))
        put(self._cancel, "label", words.SKIP if "shapes" in reading else common.CANCEL)
        put(self._again, "visible", workspace.can_try_again and not reading)
        put(self._pause, "visible", workspace.paused or "prepare" in workspace.busy)
        put(self._pause, "label", words.RESUME if workspace.paused else words.PAUSE)

    def _draw_chosen(self, id: str | None) -> None:
        workspace = self._workspace
        item = None if id is None else workspace.items.get(id)
        work = None if id is None else workspace.work(id)
        row = None if item is None else workspace.row(item)
        put(self._about, "content", self._text(id))
        self._joints.draw(work)
        can_work = item is not None and item.path is not None and row is not None
        can_work = can_work and row is not None and row.status not in ("failed", "missing")
        put(self._kind, "visible", can_work)
        if item is not None:
            labels = (words.ARTICULABLE, words.STATIC)
            chosen = labels[not workspace.articulable(item)]
            put(self._kind, "options", tuple(common.CHOSEN * (k == chosen) + k for k in labels))
        put(self._work, "visible", can_work and work is not None)
        has_tree = work is not None and work.document.tree is not None
        decided = row is not None and row.status in ("accepted", "rejected")
        waiting = row is not None and row.mark == "validating"
        put(self._pick, "visible", can_work and not has_tree)
        put(self._pick, "color", "blue" if work is None and len(workspace.items) == 1 else "gray")
        put(self._accept, "visible", has_tree and row is not None and row.status != "accepted")
        put(self._accept, "disabled", waiting)
        refusal = None if work is None else workspace.accepting.refusal(work)
        look = refusal is not None and refusal.only_warnings
        label = words.ACCEPT_ANYWAY if look else words.ACCEPT
        put(self._accept, "label", words.CHECKING if waiting else label)
        can_reject = work is not None and not (decided and row and row.status == "rejected")
        self._reject.draw(can_reject)

    def _text(self, id: str | None) -> str:
        workspace = self._workspace
        if id is None or id not in workspace.items:
            return words.NOTHING_SELECTED
        item, work = workspace.items[id], workspace.work(id)
        lines = [f"**{plain(id, 80)}** · {common.SCENE_STATES[workspace.row(item).shown]}"]
        if item.obj.description and item.obj.description != id:
            lines.append(plain(item.obj.description, 200))
        why = plain(item.decision.reason, 300)
        said = workspace.document.articulable.get(id)
        if said is not None:
            lines.append(words.kind_set(said))
        lines.append(words.why(why))
        if work is None:
            missing = workspace.missing_reason(item)
            lines += [common.warning(plain(missing, 300))] if missing else []
            return "\n\n".join(lines)
        twins = len(workspace.twins(id))
        if twins > 1:
            lines.append(words.instances(twins))
        lines += _about_work(work, workspace.accepting.refusal(work), item.decision.parts)
        return "\n\n".join(lines)


def _about_work(work: Work, refusal: Refusal | None, expected: tuple[str, ...]) -> list[str]:
    doc, out = work.document, []
    if refusal is not None:
        findings = refusal.report is not None
        out.append(words.refused(plain(refusal.why, 300), refusal.only_warnings, findings))
    if doc.tree is None:
        if expected:
            out.append(words.expected(plain(", ".join(expected))))
        if work.reason:
            out.append(words.left(plain(display_text(doc, work.reason), 300)))
        elif not work.prepared:
            out.append(words.NOT_PREDICTED)
        return out
    review = doc.review
    if review.state in ("accepted", "rejected") and review.by:
        reason = plain((review.reason or "").replace("_", " "))
        out.append(words.decided(common.STATES[review.state], plain(review.by), reason))
    return out


def count_text(rows: Sequence[Row], count: int, above: float, coming: int = 0) -> str:
    """Number of open decisions, as text.

    Args:
        count: objects with a confidence of at least ``above``, 0..1.
        coming: objects to be predicted."""
    shown = Counter(r.shown for r in rows)
    known, going, held, clicks = (shown[s] for s in ("predicted", "validating", "on_hold", "todo"))
    clicks -= coming
    text = words.to_decide(known, count, above, going, held, coming, clicks)
    if not text and any(r.work is not None for r in rows):
        text = words.sentence(decided_text(rows))
    if len(rows) == 1 and rows[0].status == "static":
        return text or words.EXTRACT_FIRST
    return text or words.NOTHING_ARTICULABLE
