"""Accept, reject, and what happened so far."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import viser

from app.server.accepting import accept, withdraw
from app.server.names import display_text, joint_title
from app.server.open_object import OpenObject
from app.server.validating import UnseenWarningsError
from app.viewer.panels.joint_tree import confidence_text, range_text
from app.viewer.panels.reviewing import RejectButtons, Rejecting, ValidationList, send_folder
from app.viewer.panels.widgets import put
from app.viewer.picture.motion import Motion
from app.viewer.tab import Tab, plain
from app.viewer.words import review as words
from app.viewer.words.common import EDITED, NONE, STATES
from model.core.errors import ArtiworldError, CommandError
from model.validation.report import Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import Document, review_problems
from sessions.review import RejectReason
from sessions.store import ObjectRecord

DECIDED = ("accepted", "rejected")


@dataclass(frozen=True)
class ReviewActions:
    """Callbacks of the review.

    Attributes:
        accept, reject: what the buttons do, once the object has been seen.
        go_on: goes to the next object after a decision.
        name_of: an object's name on the screens.
        drawn: whether the open object's picture was sent.
        ask_place: has the next click be the place of a comment.
    """

    accept: Callable[[], None]
    reject: Callable[[], None]
    go_on: Callable[[], None]
    name_of: Callable[[ObjectRecord], str]
    drawn: Callable[[], bool]
    ask_place: Callable[[], None]


class ReviewStep:
    """The third step: is it right?

    Attributes:
        validation_list: what the checks say of the joints.
    """

    def __init__(
        self, tab: Tab, motion: Motion, rejecting: Rejecting, actions: ReviewActions
    ) -> None:
        self._tab, self._rejecting, self._actions = tab, rejecting, actions
        self._drawn: Any = None
        self._asked: tuple[int, int] | None = None  # the object, and its state at that time
        tab.selection.on_open(self._leave)
        gui = tab.client.gui
        self.validation_list = ValidationList(tab, motion, actions.drawn)
        self._override = gui.add_text(
            words.OVERRIDE,
            "",
            visible=False,
            hint=words.OVERRIDE_HINT,
        )
        self._accept = gui.add_button(
            words.accept(False, False, False), icon=viser.Icon.CHECK, color="green"
        )
        self._reject = RejectButtons(tab, rejecting, actions.reject)
        self._complete = gui.add_checkbox(words.COMPLETE, False, hint=words.COMPLETE_HINT)
        self.validation_list.build_list()
        self._summary = gui.add_markdown("")
        self._comment = gui.add_text(words.COMMENT, "", multiline=True)
        self._about = gui.add_dropdown(words.ABOUT, (NONE,), visible=not tab.submits)
        self._comment_buttons = gui.add_button_group(
            "", (words.PIN, words.ADD_COMMENT), visible=not tab.submits, hint=words.PIN_HINT
        )
        self._comment_buttons.on_click(
            lambda e: tab.act(lambda: self._add_comment(e.target.value == words.PIN))
        )
        self._about_joints: dict[str, str] = {}
        self._auto_advance = gui.add_checkbox(
            words.AUTO_ADVANCE, True, hint=words.AUTO_ADVANCE_HINT
        )
        self._saved = gui.add_markdown("", visible=False)
        self._download = gui.add_button(
            words.DOWNLOAD, icon=viser.Icon.DOWNLOAD, color="gray", visible=False
        )
        self._accept.on_click(lambda _: actions.accept())
        tab.on_update(self._complete, lambda: tab.do(cmd.SetCompletion(self._complete.value)))
        self._download.on_click(lambda _: tab.act(self._send))

    @property
    def comment_text(self) -> str:
        """The text of the comment box."""
        return self._comment.value

    @property
    def override_text(self) -> str:
        """The reason for accepting despite errors."""
        return self._override.value if self._override.visible else ""

    # --- decisions

    def accept(self) -> None:
        """Accept the object; its asset is written first."""
        tab, selection = self._tab, self._tab.selection
        self._rejecting.cancel()
        selection.set_step("Review")  # where a reason is asked for, and the next object follows
        obj = selection.need_object()
        if tab.submits:
            self._submit(obj)
            return
        if obj.document.review.state == "accepted":
            tab.notify(*words.ALREADY_ACCEPTED, "gray")
            return

        def refused(error: ArtiworldError) -> None:
            tab.act(lambda: self._refused(obj, error))

        try:
            with self._deciding():
                accept(
                    obj,
                    self.comment_text,
                    tab.user,
                    self.override_text,
                    seen=self.validation_list.looked_at(obj),
                    refused=refused,
                )
        except CommandError as error:
            self._refused(obj, error)

    def _submit(self, obj: OpenObject) -> None:
        """Hand the object in for review."""
        tab, state = self._tab, obj.state
        problems = (*review_problems(state.present), obj.validation.required_problem())
        if any(problems):
            raise CommandError("; ".join(filter(None, problems)))
        with self._deciding():
            obj.live.do(cmd.Submit(self.comment_text), tab.user, since=state)
        self._clear()
        name = self._actions.name_of(obj.record)
        tab.notify(words.SUBMITTED, words.to_reviewer(name), "green", elsewhere=True)

    def _refused(self, obj: OpenObject, error: ArtiworldError) -> None:
        """Say why an acceptance was refused, and show the worst finding."""
        tab, name = self._tab, self._actions.name_of(obj.record)
        self._forget_decision(obj)
        shown = tab.selection.object is obj
        if isinstance(error, UnseenWarningsError) and shown:
            tab.selection.set_step("Review")
            self.validation_list.show_worst()
            tab.notify(words.NOT_ACCEPTED_YET, words.about(name, str(error)), "yellow")
        elif not shown and obj.hold_reason:  # the queue has a button that opens it
            tab.notify(words.ON_HOLD, words.about(name, obj.hold_reason), "yellow", elsewhere=True)
        else:
            text = words.about(name, str(error))
            tab.notify(words.NOT_ACCEPTED, text, "yellow", elsewhere=not shown)

    def withdraw(self) -> None:
        """Withdraw an acceptance that waits for the checks. May be called on any thread."""
        obj = self._tab.selection.object
        if obj is not None and withdraw(obj):
            self._forget_decision(obj)

    def reject(self, reason: RejectReason) -> None:
        """Send the object back to its annotator."""
        tab = self._tab
        name = self._actions.name_of(tab.selection.need_object().record)
        with self._deciding():
            joint = self._about_joints.get(self._about.value, "")
            tab.do(cmd.Reject(reason, self.comment_text, joint=joint, listed=True))
        self._clear()
        # The next object is shown by now.
        tab.notify(words.REJECTED, words.sent_back(name), "orange")

    def _add_comment(self, pinned: bool) -> None:
        """Add the typed comment, once its place is clicked where it is to be pinned."""
        self._tab.selection.need_object()
        if not self.comment_text.strip():
            raise CommandError(words.NEED_COMMENT)
        if pinned:
            self._actions.ask_place()
        else:
            self.pin(None)

    def pin(self, place: tuple[float, float, float] | None) -> None:
        """Add the typed comment about a place (3,), metres, or about the chosen joint."""
        joint = self._about_joints.get(self._about.value, "")
        self._tab.do(cmd.AddComment(self.comment_text, joint, place))
        self._comment.value, self._about.value = "", NONE
        self._tab.say(words.COMMENTED)

    @contextmanager
    def _deciding(self) -> Iterator[None]:
        """Go on once the decision made within is recorded; not where it is refused.

        Noted beforehand: the tab may draw the decision before the call returns.
        """
        obj = self._tab.selection.need_object()
        self._asked = (obj.record.id, obj.state.seq)
        try:
            yield
        except BaseException:
            self._asked = None
            raise

    def _leave(self) -> None:
        """Another object is opened: going on is done."""
        self._asked = None

    def _forget_decision(self, obj: OpenObject) -> None:
        """Don't go on after a decision: the one of this tab was refused."""
        if self._asked is not None and self._asked[0] == obj.record.id:
            self._asked = None

    def _clear(self) -> None:
        """Empty what was typed."""
        self._comment.value = ""
        self._override.value = ""

    def _say_again(self, obj: OpenObject) -> None:
        """Restore the texts of an acceptance that was interrupted or is on hold."""
        pending_acceptance = obj.pending_acceptance
        if pending_acceptance is not None:
            self._comment.value = pending_acceptance.comment
            self._override.value = pending_acceptance.override

    def _send(self) -> None:
        obj = self._tab.selection.need_object()
        folder = obj.services.store.assets.folder(obj.document.saved)
        if folder is None:
            raise CommandError(words.ASSET_MISSING)
        send_folder(self._tab, folder, folder.name)

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        doc = obj.document
        self.validation_list.draw(obj, doc)
        self._reject.draw(not self._tab.submits)
        report, shown = obj.validation.report, obj.shown_state
        now = (
            obj.record.id,
            obj.state.seq,
            doc.tree,
            doc.review,
            doc.saved,
            doc.complete,
            report,
            shown,
            self.validation_list.looked_at(obj) is not None,
            obj.hold_reason,
        )
        if now == self._drawn:
            return
        if self._drawn is None or self._drawn[0] != obj.record.id:
            if self._drawn is not None:
                self._clear()
            self._say_again(obj)
        self._drawn = now
        pending = words.pending(shown, plain(obj.hold_reason, 500))
        put(self._summary, content=summary(doc, pending))
        self._draw_buttons(obj, doc, report)
        self._draw_about(doc)
        decided = ("submitted",) if self._tab.submits else DECIDED
        self._advance(obj, decided=doc.review.state in decided)

    def _draw_about(self, doc: Document) -> None:
        """Offer the joints that a comment can be about."""
        joints = () if doc.tree is None else doc.tree.joints
        self._about_joints = {joint_title(doc, j.child): j.child for j in joints}
        put(self._about, options=(NONE, *self._about_joints))

    def _draw_buttons(
        self, obj: OpenObject, doc: Document, report: ValidationReport | None
    ) -> None:
        decided = doc.review.state in DECIDED
        broken = report is not None and report.severity == Severity.ERROR and not decided
        put(self._complete, value=bool(doc.complete), disabled=decided or "save" in obj.busy)
        asset = obj.asset
        put(self._complete, visible=asset is not None and asset.element_kind == "point")
        put(self._override, visible=broken)
        warned = (
            report is not None and self.validation_list.looked_at(obj) is report and not decided
        )
        label = words.accept(bool(doc.edited_joints), warned, broken)
        label = words.ACCEPTING if obj.being_accepted else label
        put(self._accept, label=words.SUBMIT if self._tab.submits else label)
        put(self._accept, color="yellow" if broken else "green")
        put(self._accept, disabled=doc.tree is None or obj.being_accepted)
        put(self._accept, visible=doc.review.state != "accepted")
        saved = doc.saved if doc.review.state == "accepted" else None
        put(self._download, visible=saved is not None)
        put(self._saved, visible=saved is not None)
        if saved is not None:
            put(self._saved, content=words.saved_in(plain(saved.folder, 200)))

    def _advance(self, obj: OpenObject, *, decided: bool) -> None:
        """Go to the next object once the decision of this tab is made."""
        id, before = self._asked or (None, 0)
        # Neither the checks nor writing the asset keep the user waiting.
        done = obj.being_accepted or (decided and obj.state.seq > before)
        if id == obj.record.id and done:
            self._asked = None
            if self._auto_advance.value:
                self._tab.act(self._actions.go_on)


def summary(doc: Document, pending: str = "") -> str:
    """State or ``pending`` acceptance, reasons, joints and warnings of an object."""
    review = doc.review
    said = words.state(STATES[review.state], plain(review.by) if review.by else "")
    if review.state == "predicted" and doc.joints_file is not None:
        said = words.from_file(plain(doc.joints_file))
    lines = [pending or said]
    if review.reason:
        lines.append(words.reason(plain(review.reason.replace("_", " "))))
    if review.comment:
        lines.append(words.comment(plain(review.comment, 500)))
    if review.joint:
        lines.append(words.about_joint(plain(joint_title(doc, review.joint))))
    if review.place is not None:
        place = ", ".join(f"{value:.3f}" for value in review.place)
        lines.append(words.about_place(f"({place})"))
    if review.override:
        lines.append(words.override(plain(review.override, 500)))
    if doc.tree is None:
        lines.append(words.NO_JOINTS)
        return "\n\n".join(lines)
    rows = [words.TABLE_HEAD, "|---|---|---|---|"]
    for joint in doc.tree.joints:
        edited = EDITED * (joint.child in doc.edited_joints)
        rows.append(
            f"| {plain(joint_title(doc, joint.child), 40)}{edited} | {joint.type} "
            f"| {range_text(joint)} | {confidence_text(doc, joint.child)} |"
        )
    lines.append("\n".join(rows))
    found = () if doc.prediction is None else doc.prediction.problems
    problems = [plain(display_text(doc, p), 300) for p in found]
    if doc.prediction_stale:
        problems.append(words.STALE)
    if problems:
        lines.append(words.PROBLEMS + "\n" + "\n".join(f"- {p}" for p in problems))
    return "\n\n".join(lines)
