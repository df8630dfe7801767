"""Accept, reject, and what happened so far."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import viser

from app.viewer import palette
from app.viewer.joints_panel import part_title, range_text
from app.viewer.text import plain
from app.viewer.widgets import put
from app.workbench import OpenObject
from model.errors import CommandError
from sessions import commands as cmd
from sessions.document import Document
from sessions.review import RejectReason

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

REASONS: dict[str, RejectReason] = {
    "range": "range",
    "axis": "axis",
    "type": "type",
    "parts": "parts",
    "not articulated": "not_articulated",
    "other": "other",
}
HISTORY_SHOWN = 12
DOWNLOAD_BYTES = 400_000_000


class ReviewPanel:
    """The third step: is it right?"""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._drawn: Any = None
        gui = app.client.gui
        self._summary = gui.add_markdown("")
        self._comment = gui.add_text("Comment", "", multiline=True)
        self._accept = gui.add_button("Accept (Y)", icon=viser.Icon.CHECK, color="green")
        self._reason = gui.add_dropdown("What is wrong", tuple(REASONS))
        self._reject = gui.add_button("Reject (X)", icon=viser.Icon.X, color="red")
        self._reopen = gui.add_button("Reopen", color="gray", visible=False)
        self._saved = gui.add_markdown("", visible=False)
        self._download = gui.add_button(
            "Download the asset", icon=viser.Icon.DOWNLOAD, color="gray", visible=False
        )
        with gui.add_folder("History", expand_by_default=False):
            self._history = gui.add_markdown("")
        self._accept.on_click(lambda _: app.act(app.accept))
        self._reject.on_click(lambda _: app.act(app.reject))
        self._reopen.on_click(lambda _: app.act(lambda: app.do(cmd.Reopen(self.comment_text))))
        self._download.on_click(lambda _: app.act(self._send))

    @property
    def comment_text(self) -> str:
        """What stands in the comment box."""
        return self._comment.value

    @property
    def chosen_reason(self) -> RejectReason:
        """The chosen reason to reject."""
        return REASONS[self._reason.value]

    def clear_comment(self) -> None:
        """Empty the comment box."""
        self._comment.value = ""

    def _send(self) -> None:
        saved = self._app.need_object().document.saved
        if saved is None or not Path(saved.folder).is_dir():
            raise CommandError("the saved asset isn't on this server's disk; accept again")
        folder = Path(saved.folder)
        files = sorted(p for p in folder.rglob("*") if p.is_file())
        if sum(p.stat().st_size for p in files) > DOWNLOAD_BYTES:
            raise CommandError(f"too large to send through the browser; it lies in {folder}")
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in files:
                archive.write(path, Path(folder.name) / path.relative_to(folder))
        self._app.client.send_file_download(f"{folder.name}.zip", buffer.getvalue())

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        doc = obj.document
        checks = tuple((c.joint, c.where) for c in obj.checks)
        now = (
            obj.record.id,
            obj.state.seq,
            doc.tree,
            doc.review,
            doc.saved,
            checks,
            tuple(obj.busy),
        )
        if now == self._drawn:
            return
        if self._drawn is not None and self._drawn[0] != obj.record.id:
            self.clear_comment()
        self._drawn = now
        put(self._summary, "content", summary(obj, doc))
        fixed = bool(doc.edited_joints)
        put(self._accept, "label", "Fix and accept (Y)" if fixed else "Accept (Y)")
        put(self._accept, "disabled", doc.tree is None or "save" in obj.busy)
        decided = doc.review.state in ("accepted", "rejected")
        put(self._reopen, "visible", decided)
        put(self._download, "visible", doc.saved is not None)
        put(self._saved, "visible", doc.saved is not None)
        if doc.saved is not None:
            put(self._saved, "content", f"Saved in `{plain(doc.saved.folder, 200)}`")
        self._draw_history()

    def _draw_history(self) -> None:
        app = self._app
        entries = app.bench.store.history(app.need_object().record.id)[-HISTORY_SHOWN:]
        lines = [
            f"- {plain(e.at[11:19])} {plain(e.who, 24)}: {plain(e.kind)}" for e in reversed(entries)
        ]
        put(self._history, "content", "\n".join(lines) or "Nothing yet.")


def summary(obj: OpenObject, doc: Document) -> str:
    """What a reviewer must know before deciding."""
    review = doc.review
    lines = [
        f"**{palette.STATE_WORDS[review.state]}**"
        + (f" by {plain(review.by)}" if review.by else "")
    ]
    if review.reason:
        lines.append(f"Reason: {plain(review.reason.replace('_', ' '))}")
    if review.comment:
        lines.append(f"“{plain(review.comment, 500)}”")
    if doc.tree is None:
        lines.append("No joints yet: there is nothing to accept.")
        return "\n\n".join(lines)
    rows = ["| joint | type | range |", "|---|---|---|"]
    for joint in doc.tree.joints:
        edited = " ✎" if joint.child in doc.edited_joints else ""
        rows.append(
            f"| {plain(part_title(doc, joint.child), 40)}{edited} | {joint.type} "
            f"| {range_text(joint)} |"
        )
    lines.append("\n".join(rows))
    problems = [] if doc.prediction is None else [plain(p, 300) for p in doc.prediction.problems]
    problems += [
        f"{plain(c.joint)} collides: {1000 * float(c.depth.max()):.1f} mm deep"
        for c in obj.checks
        if c.where is not None
    ]
    if doc.prediction_stale:
        problems.append("the parts changed since the prediction")
    if problems:
        lines.append("**Look at:**\n" + "\n".join(f"- {p}" for p in problems))
    elif "check" in obj.busy:
        lines.append("*Sweeping the joints…*")
    else:
        lines.append("No collision over the joints' ranges.")
    return "\n\n".join(lines)
