"""The screens beside a scene's picture. At the left what the colors mean, and its objects, lowest
confidence first, a page of buttons at a time; at the right the selected object, decisions for many,
and what is saved.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import viser

from app.server.names import clipped, display_text
from app.server.scene_accepting import Refusal
from app.server.scene_state import SHOWN, Row, Shown, Work, decided_text
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.joint_tree import JointRows
from app.viewer.panels.reviewing import RejectButtons, Rejecting
from app.viewer.panels.widgets import UserName, push_button, push_buttons, put
from app.viewer.picture import palette
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.steps.scene_selection import SceneEdit, SceneHost, SceneReview
from app.viewer.tab import Tab, plain
from app.viewer.words import common
from app.viewer.words import scene as words
from app.viewer.words.joints import confidence
from app.viewer.words.review import about, saved_in

PAGE = 13
"""Objects on a page of the list."""
_ICONS = {
    "predicted": viser.Icon.SPARKLES,
    "on_hold": viser.Icon.ALERT_TRIANGLE,
    "validating": viser.Icon.HOURGLASS,
    "todo": viser.Icon.PENCIL,
    "rejected": viser.Icon.CIRCLE_X,
    "accepted": viser.Icon.CIRCLE_CHECK,
    "static": viser.Icon.LOCK,
    "failed": viser.Icon.ALERT_TRIANGLE,
    "missing": viser.Icon.QUESTION_MARK,
}


class SceneList:
    """Legend with counts, filter, search, and a page of objects as buttons."""

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        picture: ScenePicture,
        choose: Callable[[str], None],
        remember: Callable[[], None],
    ) -> None:
        """Make the panel.

        Args:
            choose: gets the id of the object that was clicked.
            remember: is called once the user's name changed.
        """
        self._tab, self._workspace, self._picture = tab, workspace, picture
        self._choose = choose
        self._shown: Any = None
        self._first, self._page, self._followed = 0, list[Row](), ""
        gui = tab.client.gui
        panel = gui.add_panel()
        with panel.add_tab(words.TITLE, viser.Icon.HOME):
            self._title = gui.add_markdown("")
            self._legend = gui.add_html("")
            self._original = gui.add_checkbox(
                words.ORIGINAL_COLORS, False, hint=words.ORIGINAL_COLORS_HINT
            )
            options = (common.ALL, *common.SCENE_STATES.values())
            self._filter = gui.add_dropdown(common.FILTER, options, initial_value=common.ALL)
            self._search = gui.add_text(common.SEARCH, "", hint=words.SEARCH_HINT)
            self._buttons = [
                push_button(tab, "", lambda k=k: self._clicked(k), visible=False)
                for k in range(PAGE)
            ]
            self._pages = gui.add_button_group(common.PAGE, ("◀", "1", "▶"))
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(250)
        self._original.on_update(lambda _: tab.act(self._recolor))
        self._filter.on_update(lambda _: self._turn(None))
        self._search.on_update(lambda _: self._turn(None))
        self._pages.on_click(lambda e: self._turn({"◀": -1, "▶": 1}.get(e.target.value, 0)))

    def _clicked(self, k: int) -> None:
        if k < len(self._page):
            self._choose(self._page[k].id)

    def _recolor(self) -> None:
        self._picture.original_colors = self._original.value

    def _turn(self, by: int | None) -> None:
        self._first = 0 if by is None else self._first + by * PAGE
        self._tab.invalidate()

    def draw(self, rows: Sequence[Row], current: str | None) -> None:
        """Bring the list up to date; nothing is sent where nothing changed, and a new ``current``
        object turns to its page."""
        found = [row for row in rows if self._finds(row)]
        if current is not None and current != self._followed:
            at = next((k for k, row in enumerate(found) if row.id == current), self._first)
            self._first = at // PAGE * PAGE
        self._followed = current or ""
        pages = -(-len(found) // PAGE)
        self._first = min(max(self._first, 0), max(0, (pages - 1) * PAGE))
        page = self._page = found[self._first : self._first + PAGE]
        counts, original_colors = Counter(r.shown for r in rows), self._picture.original_colors
        now = tuple(page), current, self._first, pages, tuple(counts.items()), original_colors
        if now == self._shown:
            return
        self._shown = now
        scene = self._workspace.scene
        name = self._workspace.record.name if scene is None else scene.name
        put(self._title, content=words.about(plain(name, 60), len(rows)))
        put(self._legend, content=legend(counts, original_colors))
        put(self._pages, visible=pages > 1, options=page_buttons(self._first // PAGE, pages))
        for k, button in enumerate(self._buttons):
            put(button, visible=k < len(page))
            if k < len(page):
                put(button, **_look(page[k], page[k].id == current))

    def _finds(self, row: Row) -> bool:
        """True if filter and search leave the object."""
        item, state = self._workspace.items[row.id], common.SCENE_STATES[row.shown]
        text = f"{row.id} {item.obj.description} {item.category or ''}".lower()
        return self._filter.value in (common.ALL, state) and self._search.value.lower() in text


def page_buttons(page: int, count: int) -> tuple[str, str, str]:
    """The page's number between arrows to its neighbors; ``page`` counts from 0."""
    return ("◀" if page > 0 else "·", f"{page + 1}/{count}", "▶" if page + 1 < count else "· ")


def _look(row: Row, here: bool) -> dict[str, Any]:
    """Appearance of an object's button; those that aren't selected are grayer."""
    share = confidence(row.confidence) if row.status == "predicted" else ""
    color = palette.SCENE_COLORS[row.shown]
    return {
        "label": words.row(clipped(row.id, 16 if share else 22), here, share),
        "icon": _ICONS[row.shown],
        "color": color if here else tuple(int(c * 0.55 + 120 * 0.45) for c in color),
        "hint": words.state(plain(row.id), row.shown),
    }


def legend(counts: Counter[Any], original_colors: bool) -> str:
    """Squares in the colors of the states, hollow where objects keep their own, with counts."""

    def square(state: Shown) -> str:
        if original_colors or state in ("static", "failed", "missing"):
            return "border:1.5px dashed #98a0a8"
        return f"background:rgb{palette.SCENE_COLORS[state]}"

    cells = "".join(
        f'<div style="display:flex;align-items:center;gap:6px">'
        f'<span style="width:12px;height:12px;border-radius:3px;flex:none;box-sizing:border-box;'
        f'{square(s)}"></span>'
        f"<span>{common.SCENE_STATES[s]}</span>"
        f'<b style="margin-left:auto;padding-right:10px">{counts[s]}</b></div>'
        for s in SHOWN
        if s not in ("failed", "missing", "on_hold", "validating") or counts[s]
    )
    return (
        '<div style="display:grid;grid-template-columns:1fr 1fr;gap:3px 4px;font-size:13px;'
        f'margin:2px 12px 6px">{cells}</div>'
    )


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
        edit: SceneEdit,
        review: SceneReview,
        host: SceneHost,
        play: Callable[[str | None], None],
    ) -> None:
        self._tab, self._workspace, self._review = tab, workspace, review
        gui = tab.client.gui

        def button(label: str, action: Callable[[], None], icon: Any, **look: Any) -> Any:
            return push_button(tab, label, action, icon=icon, **look)

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
        push_buttons(
            tab,
            common.EDIT,
            common.HISTORY_ACTIONS,
            lambda name: review.undo() if name == common.HISTORY_ACTIONS[0] else review.redo(),
        )
        self._play = button(words.PLAY, lambda: play(None), viser.Icon.PLAYER_PLAY)
        with gui.add_folder(words.SELECTED):
            self._about = gui.add_markdown("")
            kinds = (words.ARTICULABLE, words.STATIC)
            self._kind = push_buttons(tab, words.KIND, kinds, review.classify, visible=False)
            self._work = button(words.EDIT, edit.enter, viser.Icon.PENCIL, visible=False)
            self._pick = button(
                words.PICK, edit.pick, viser.Icon.SCISSORS, color="gray", visible=False
            )
            self._accept = gui.add_button(
                words.ACCEPT, icon=viser.Icon.CHECK, color="green", visible=False
            )
            self._accept.on_click(lambda _: host.accept())
            self._reject = RejectButtons(tab, rejecting, host.reject)
            push_buttons(
                tab,
                common.NAVIGATE,
                common.PREVIOUS_NEXT,
                lambda name: edit.choice.step(1 if name == common.PREVIOUS_NEXT[1] else -1),
            )
            self._joints = JointRows(tab, play)
        with gui.add_folder(words.BY_CONFIDENCE):
            self._above = gui.add_slider(words.MINIMUM, 0, 100, 1, 80)
            self._above.on_update(lambda _: tab.invalidate())
            self._count = gui.add_markdown("")
            self._accept_all = button(
                words.accept_count(0),
                lambda: review.accept_above(self.above),
                viser.Icon.CHECKS,
                color="green",
                disabled=True,
            )
        with gui.add_folder(words.SAVE_FOLDER):
            self._loose = gui.add_checkbox(words.INCLUDE, False, hint=words.INCLUDE_HINT)
            self._save = button(words.SAVE, self._save_clicked, viser.Icon.DEVICE_FLOPPY)
            self._report = button(
                words.REPORT, self._report_clicked, viser.Icon.FILE_REPORT, color="gray"
            )
            self._saved = gui.add_markdown("", visible=False)

    def _pause_clicked(self) -> None:
        self._workspace.pause(not self._workspace.paused)

    def _save_clicked(self) -> None:
        self._workspace.saving.save(self._loose.value, self._tab.user)

    def _report_clicked(self) -> None:
        send = self._tab.client.send_file_download
        self._workspace.saving.report(lambda path: send(path.name, path.read_bytes()))

    @property
    def above(self) -> float:
        """The confidence above which all are accepted, 0..1."""
        return self._above.value / 100

    def draw(self, rows: Sequence[Row], selected: str | None, moving: bool) -> None:
        """Bring the widgets up to date; ``moving`` while joints play."""
        workspace = self._workspace
        self._draw_status()
        put(self._play, label=words.STOP if moving else words.PLAY)
        joints = any(w.document.tree is not None for w in workspace.wanted())
        put(self._play, color="blue" if joints else "gray")
        put(self._play, icon=viser.Icon.PLAYER_STOP if moving else viser.Icon.PLAYER_PLAY)
        self._draw_chosen(selected)
        ready = self._review.above(self.above)
        count = sum(r.work in ready for r in rows)
        coming = sum(workspace.awaits_prediction(r) for r in rows)
        put(self._count, content=count_text(rows, count, self.above, coming))
        put(self._accept_all, label=words.accept_count(count), disabled=not ready)
        saved = workspace.document.saved
        put(self._saved, visible=saved is not None)
        if saved is not None:
            put(self._saved, content=saved_in(plain(saved.folder, 300)))
        saving = "save" in workspace.busy
        put(self._save, disabled=saving or workspace.scene is None)
        put(self._save, label=words.SAVING if saving else words.SAVE)
        put(self._report, disabled="report" in workspace.busy or workspace.scene is None)

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
