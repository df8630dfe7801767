"""The right side of a scene: the chosen object, decisions for many, and what is saved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import viser

from app.server.display_names import in_words
from app.server.scene_accepting import Refusal
from app.server.scene_rows import Row, Work, decided_text
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.joint_rows import JointRows
from app.viewer.panels.rejecting import RejectButtons, Rejecting
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.text import plain

_BUSY = {
    "read": "Reading the scene",
    "shapes": "Reading the assets",
    "copy": "Making a working copy",
    "accept": "Accepting",
    "save": "Saving the scene",
    "report": "Writing the report",
    "prepare": "Predicting",
    "parts": "Preparing the picture",
}
_KIND = ("● Articulable", "Articulable", "● Static", "Static")


Action = Callable[[], None]


@dataclass(frozen=True)
class SceneActions:
    """What the widgets of a scene ask for.

    Attributes:
        classify: gets "Articulable" or "Static" for the chosen object.
        step: goes to the next object to decide (1) or to the one before (-1).
        accept_above: accepts all predicted objects of at least that confidence, 0..1.
        above: their sessions.
        save: writes the scene; True also with what is only predicted.
        play_joint: moves one joint of the chosen object.
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
        self, tab: Tab, desk: SceneWorkspace, rejecting: Rejecting, actions: SceneActions
    ) -> None:
        self._tab, self._desk, self._actions = tab, desk, actions
        gui = tab.client.gui
        self._status = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._pause = gui.add_button("Stop predicting", icon=viser.Icon.PLAYER_PAUSE,
                                     color="gray", visible=False)  # fmt: skip
        self._history = gui.add_button_group("Scene history", ("Undo", "Redo"))
        self._play = gui.add_button("Play all joints (Shift+Space)", icon=viser.Icon.PLAYER_PLAY)
        with gui.add_folder("Chosen object"):
            self._about = gui.add_markdown("")
            self._kind = gui.add_button_group("It is", ("Articulable", "Static"), visible=False)
            self._work = gui.add_button("Work on it (Enter)", icon=viser.Icon.PENCIL, visible=False)
            self._pick = gui.add_button("Pick an object out of it", icon=viser.Icon.SCISSORS,
                                        color="gray", visible=False)  # fmt: skip
            self._accept = gui.add_button("Accept (Y)", icon=viser.Icon.CHECK, color="green",
                                          visible=False)  # fmt: skip
            self._reject = RejectButtons(tab, rejecting, actions.reject)
            self._step = gui.add_button_group("To decide", ("Previous (B)", "Next (N)"))
            self._joints = JointRows(tab, actions.play_joint)
        with gui.add_folder("Accept the sure ones"):
            self._above = gui.add_slider("Above [%]", 0, 100, 1, 80)
            self._count = gui.add_markdown("")
            self._accept_all = gui.add_button("Accept", icon=viser.Icon.CHECKS, color="green",
                                              disabled=True)  # fmt: skip
        with gui.add_folder("Save"):
            self._loose = gui.add_checkbox(
                "Predicted ones too",
                False,
                hint="Also objects that nobody has accepted yet move; else they stand rigid",
            )
            self._save = gui.add_button("Save the scene", icon=viser.Icon.DEVICE_FLOPPY)
            self._report = gui.add_button("Scene report", icon=viser.Icon.FILE_REPORT, color="gray")
            self._saved = gui.add_markdown("", visible=False)
        self._listen()

    def _listen(self) -> None:
        act, do = self._tab.act, self._actions
        self._pause.on_click(lambda _: act(lambda: self._desk.pause(not self._desk.paused)))
        self._history.on_click(lambda e: act(do.undo if e.target.value == "Undo" else do.redo))
        self._play.on_click(lambda _: act(do.play_all))
        self._kind.on_click(lambda e: act(lambda: do.classify(e.target.value)))
        self._work.on_click(lambda _: act(do.enter))
        self._pick.on_click(lambda _: act(do.pick))
        self._accept.on_click(lambda _: do.accept())
        self._step.on_click(
            lambda e: act(lambda: do.step(1 if e.target.value.startswith("Next") else -1))
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
        desk = self._desk
        self._draw_status()
        put(self._play, "label", "Stop (Space)" if moving else "Play all joints (Shift+Space)")
        joints = any(w.document.tree is not None for w in desk.wanted())
        put(self._play, "color", "blue" if joints else "gray")
        put(self._play, "icon", viser.Icon.PLAYER_STOP if moving else viser.Icon.PLAYER_PLAY)
        self._draw_chosen(selected)
        ready = self._actions.above(self.above)
        count = sum(r.work in ready for r in rows)
        coming = sum(desk.to_come(r) for r in rows)
        put(self._count, "content", count_text(rows, count, self.above, coming))
        put(self._accept_all, "label", f"Accept {_number(count)}".rstrip())
        put(self._accept_all, "disabled", not ready)
        saved = desk.document.saved
        put(self._saved, "visible", saved is not None)
        if saved is not None:
            put(self._saved, "content", f"Saved in {plain(saved.folder, 300)}")
        saving = "save" in desk.busy
        put(self._save, "disabled", saving or desk.scene is None)
        put(self._save, "label", "Saving the scene…" if saving else "Save the scene")
        put(self._report, "disabled", "report" in desk.busy or desk.scene is None)

    def _draw_status(self) -> None:
        desk = self._desk
        lines = []
        if desk.problem:
            lines.append(f"⚠ {plain(desk.problem, 400)}")
        # What was taken back may need a moment to stop; nobody waits for it any more.
        idle = () if desk.accepting.waiting else ("accept",)
        busy = dict(desk.busy)  # jobs end while this is drawn
        shown = [w for w in _BUSY if w in busy and w not in idle]
        fraction = 0.0
        if shown:
            fraction, message = busy[shown[0]]
            lines.append(f"*{_BUSY[shown[0]]}… {plain(message)}".rstrip() + "*")
        problems = () if desk.scene is None else desk.scene.problems
        if problems:
            told = "\n".join(f"- {plain(p.object, 40)}: {plain(p.told, 200)}" for p in problems[:6])
            more = f"\n- and {len(problems) - 6} more" if len(problems) > 6 else ""
            lines.append(f"⚠ About the file:\n{told}{more}")
        put(self._status, "content", "\n\n".join(lines))
        put(self._progress, "visible", bool(shown))
        put(self._progress, "value", round(100 * fraction, 1))
        put(self._pause, "visible", desk.paused or "prepare" in desk.busy)
        put(self._pause, "label", "Go on predicting" if desk.paused else "Stop predicting")

    def _draw_chosen(self, id: str | None) -> None:
        desk = self._desk
        item = None if id is None else desk.items.get(id)
        work = None if id is None else desk.work(id)
        row = None if item is None else desk.row(item)
        put(self._about, "content", self._text(id))
        self._joints.draw(work)
        can_work = item is not None and item.path is not None and row is not None
        can_work = can_work and row is not None and row.status not in ("failed", "missing")
        put(self._kind, "visible", can_work)
        if item is not None:
            yes = desk.articulable(item)
            put(self._kind, "options",
                (_KIND[0] if yes else _KIND[1], _KIND[3] if yes else _KIND[2]))  # fmt: skip
        put(self._work, "visible", can_work and work is not None)
        has_tree = work is not None and work.document.tree is not None
        decided = row is not None and row.status in ("accepted", "rejected")
        waiting = row is not None and row.mark == "judging"
        put(self._pick, "visible", can_work and not has_tree)
        put(self._pick, "color", "blue" if work is None and len(desk.items) == 1 else "gray")
        put(self._accept, "visible", has_tree and row is not None and row.status != "accepted")
        put(self._accept, "disabled", waiting)
        refusal = None if work is None else desk.accepting.refusal(work)
        look = refusal is not None and refusal.wants_a_look
        label = "Accept as it is (Y)" if look else "Accept (Y)"
        put(self._accept, "label", "Being judged…" if waiting else label)
        can_reject = work is not None and not (decided and row and row.status == "rejected")
        self._reject.draw(can_reject)

    def _text(self, id: str | None) -> str:
        desk = self._desk
        if id is None or id not in desk.items:
            return "Click an object in the picture or in the list. N goes to the least sure one."
        item, work = desk.items[id], desk.work(id)
        lines = [f"**{plain(id, 80)}** · {palette.SCENE_WORDS[desk.row(item).shown]}"]
        if item.obj.description and item.obj.description != id:
            lines.append(plain(item.obj.description, 200))
        why = plain(item.decision.reason, 300)
        said = desk.document.articulable.get(id)
        if said is not None:
            lines.append(f"A person said: {'articulable' if said else 'static'}.")
        lines.append(f"Why: {why}")
        if work is None:
            missing = desk.missing_reason(item)
            lines += [f"⚠ {plain(missing, 300)}"] if missing else []
            return "\n\n".join(lines)
        twins = len(desk.twins(id))
        if twins > 1:
            lines.append(f"It stands here {twins} times; a decision counts for all of them.")
        lines += _about_work(work, desk.accepting.refusal(work), item.decision.parts)
        return "\n\n".join(lines)


def _about_work(work: Work, refusal: Refusal | None, expected: tuple[str, ...]) -> list[str]:
    doc, out = work.document, []
    if refusal is not None:
        if refusal.wants_a_look:
            then = "**Y again accepts it as it is; Enter shows it.**"
        else:
            then = "Enter shows where." if refusal.report is not None else ""
        out.append(f"⚠ Not accepted: {plain(refusal.why, 300)} {then}")
    if doc.tree is None:
        if expected:
            out.append(f"Expected to move: {plain(', '.join(expected))}")
        if work.reason:
            out.append(f"⚠ Left for you: {plain(in_words(doc, work.reason), 300)}")
        elif not work.prepared:
            out.append("Not predicted yet.")
        return out
    review = doc.review
    if review.state in ("accepted", "rejected") and review.by:
        reason = f": {plain(review.reason.replace('_', ' '))}" if review.reason else ""
        out.append(f"{palette.STATE_WORDS[review.state]} by {plain(review.by)}{reason}")
    return out


def _number(count: int) -> str:
    return f"{count} object{'s'[: count != 1]}" if count else ""


def count_text(rows: Sequence[Row], count: int, above: float, coming: int = 0) -> str:
    """What is left to decide; ``count`` objects are at least ``above`` sure, 0..1, and ``coming``
    are still to be predicted."""
    shown = Counter(r.shown for r in rows)
    known, going, held, clicks = (shown[s] for s in ("predicted", "judging", "held", "todo"))
    clicks -= coming
    lines = [f"{going} {'is' if going == 1 else 'are'} being judged."] if going else []
    if known:
        lines.append(
            f"**{count}** of {known} predicted objects: at least {100 * above:.0f} % sure."
        )
    if held:
        lines.append(f"{held} held back by the gate (⚠ in the list).")
    if coming:
        lines.append(f"{coming} still to be predicted.")
    if clicks:
        lines.append(f"{clicks} {'wants' if clicks == 1 else 'want'} clicks (✎ in the list).")
    if not lines and any(r.work is not None for r in rows):
        lines.append(f"{decided_text(rows)}.")
    nothing = "Nothing here can be articulated."
    if len(rows) == 1 and rows[0].status == "static":
        nothing = "Nothing yet: pick an object out of it."
    return " ".join(lines) or nothing
