"""The screen at the right of a scene's picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import viser

from app.server.names import display_text
from app.server.scene_accepting import Refusal
from app.server.scene_state import Row, Work
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.joint_tree import JointRows
from app.viewer.panels.reviewing import RejectButtons, Rejecting
from app.viewer.panels.widgets import Presses, push_button, push_buttons, put
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.steps.scene_selection import SceneChoice, SceneHost, SceneReview, remarks_text
from app.viewer.tab import Tab, plain
from app.viewer.words import common
from app.viewer.words import scene as words
from app.viewer.words.review import about, saved_in

PROBLEMS = 6
"""Problems of the file that are listed; the others are counted."""


class SceneCard:
    """Widgets for a scene; they are hidden while one of its objects is worked on.

    Args:
        play: moves all joints, or the one of a name of the selected object.
    """

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        rejecting: Rejecting,
        choice: SceneChoice,
        review: SceneReview,
        host: SceneHost,
        picture: ScenePicture,
        presses: Presses,
        play: Callable[[str | None], None],
    ) -> None:
        self._tab, self._workspace, self._picture = tab, workspace, picture
        gui = tab.client.gui

        def button(label: str, action: Callable[[], None], icon: Any, **look: Any) -> Any:
            return push_button(tab, label, action, icon=icon, **look)

        self._original = gui.add_checkbox(
            words.ORIGINAL_COLORS, False, hint=words.ORIGINAL_COLORS_HINT
        )
        tab.on_update(self._original, self._recolor)
        self._status = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._pause = button(
            words.PAUSE, self._pause_clicked, viser.Icon.PLAYER_PAUSE, color="gray", visible=False
        )
        self._cancel = gui.add_button(
            common.CANCEL, icon=viser.Icon.PLAYER_STOP, color="gray", visible=False
        )
        self._cancel.on_click(lambda _: workspace.cancel())  # whatever the tab waits for
        self._again = button(
            common.RETRY, workspace.try_again, viser.Icon.REFRESH, color="gray", visible=False
        )
        self._save = button(words.SAVE, self._save_clicked, viser.Icon.DEVICE_FLOPPY)
        self._loose = gui.add_checkbox(words.INCLUDE, False, hint=words.INCLUDE_HINT)
        push_buttons(
            tab,
            common.EDIT,
            common.HISTORY_ACTIONS,
            lambda name: review.undo() if name == common.HISTORY_ACTIONS[0] else review.redo(),
        )
        self._play = button(words.PLAY, lambda: play(None), viser.Icon.PLAYER_PLAY, color="gray")
        with gui.add_folder(words.SELECTED):
            self._about = gui.add_markdown("")
            kinds = (words.ARTICULABLE, words.STATIC)
            self._kind = push_buttons(tab, words.KIND, kinds, review.classify, visible=False)
            self._work = button(words.EDIT, choice.enter, viser.Icon.PENCIL, visible=False)
            self._pick = button(
                words.PICK, choice.pick, viser.Icon.SCISSORS, color="gray", visible=False
            )
            self._accept = gui.add_button(
                words.ACCEPT, icon=viser.Icon.CHECK, color="green", visible=False
            )
            self._accept.on_click(lambda _: host.accept())
            self._reject = RejectButtons(tab, rejecting, host.reject)
            self._joints = JointRows(tab, presses, play)
        self._report = button(
            words.REPORT, self._report_clicked, viser.Icon.FILE_REPORT, color="gray"
        )

    def _save_clicked(self) -> None:
        self._workspace.saving.save(self._loose.value, self._tab.user)

    def _report_clicked(self) -> None:
        send = self._tab.client.send_file_download
        self._workspace.saving.report(
            lambda path: send(path.name, path.read_bytes(), save_immediately=True)
        )

    def _pause_clicked(self) -> None:
        self._workspace.pause(not self._workspace.paused)

    def _recolor(self) -> None:
        self._picture.original_colors = self._original.value

    def draw(self, rows: Sequence[Row], selected: str | None, moving: bool) -> None:
        """Bring the widgets up to date; ``moving`` while joints play."""
        workspace = self._workspace
        self._draw_status(remarks_text(workspace, rows))
        put(self._play, label=words.STOP if moving else words.PLAY)
        put(self._play, icon=viser.Icon.PLAYER_STOP if moving else viser.Icon.PLAYER_PLAY)
        saving, unread = "save" in workspace.busy, workspace.scene is None
        put(self._save, disabled=saving or unread, label=words.SAVING if saving else words.SAVE)
        put(self._report, disabled="report" in workspace.busy or unread)
        self._draw_chosen(selected)

    def _draw_status(self, remarks: str) -> None:
        workspace = self._workspace
        scene = workspace.scene
        more = f" · {remarks}" if remarks else ""
        lines = [] if scene is None else [f"**{plain(scene.name, 60)}**{more}"]
        if workspace.problem:
            lines.append(common.warning(plain(workspace.problem, 400)))
        busy = dict(workspace.busy)  # jobs end while this is drawn
        shown = [w for w in words.JOBS if w in busy]
        fraction = 0.0
        if shown:
            fraction, message = busy[shown[0]]
            lines.append(f"*{words.job(shown[0], plain(message))}*")
        problems = () if scene is None else scene.problems
        if problems:
            lines_of = [about(plain(p.object, 40), plain(p.text, 200)) for p in problems[:PROBLEMS]]
            lines.append(words.file_problems(lines_of, max(len(problems) - PROBLEMS, 0)))
        if workspace.document.saved is not None:
            lines.append(saved_in(plain(workspace.document.saved.folder, 300)))
        put(self._status, content="\n\n".join(lines))
        put(self._progress, visible=bool(shown), value=round(100 * fraction, 1))
        reading = {"read", "shapes", "copy"} & set(busy)
        put(self._cancel, visible=bool(reading))
        put(self._cancel, label=words.SKIP if "shapes" in reading else common.CANCEL)
        put(self._again, visible=workspace.can_try_again and not reading)
        put(self._pause, visible=workspace.paused or "prepare" in workspace.busy)
        put(self._pause, label=words.RESUME if workspace.paused else words.PAUSE)

    def _draw_chosen(self, id: str | None) -> None:
        workspace = self._workspace
        item = None if id is None else workspace.items.get(id)
        work = None if id is None else workspace.work(id)
        row = None if item is None else workspace.row(item)
        put(self._about, content=self._text(id))
        self._joints.draw(work)
        can_work = item is not None and item.path is not None and row is not None
        can_work = can_work and row is not None and row.status not in ("failed", "missing")
        put(self._kind, visible=can_work)
        if item is not None:
            labels = (words.ARTICULABLE, words.STATIC)
            chosen = labels[not workspace.articulable(item)]
            put(self._kind, options=tuple(common.CHOSEN * (k == chosen) + k for k in labels))
        put(self._work, visible=can_work and work is not None)
        has_tree = work is not None and work.document.tree is not None
        decided = row is not None and row.status in ("accepted", "rejected")
        waiting = row is not None and row.mark == "validating"
        put(self._pick, visible=can_work and not has_tree)
        put(self._pick, color="blue" if work is None and len(workspace.items) == 1 else "gray")
        put(self._accept, visible=has_tree and row is not None and row.status != "accepted")
        put(self._accept, disabled=waiting)
        refusal = None if work is None else workspace.accepting.refusal(work)
        look = refusal is not None and refusal.only_warnings
        label = words.ACCEPT_ANYWAY if look else words.ACCEPT
        put(self._accept, label=words.CHECKING if waiting else label)
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
        lines.append(f"{why[:1].upper()}{why[1:]}")
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
