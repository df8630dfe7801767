"""The project page: progress, today's figures, a plot of two weeks, the latest objects, and the
dialogs of the settings.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

import numpy as np
import viser
import viser.uplot

from app.server.app_state import AppState
from app.server.job import Job
from app.viewer.panels.widgets import Dialog, Presses, button
from app.viewer.tab import Tab, plain
from app.viewer.words import common
from app.viewer.words import project as words
from app.viewer.words import queue as export_words
from app.viewer.words.queue import STATE_ORDER
from model.io.export.registry import exporter_names, format_title
from model.prediction.experience import in_use, record_of
from sessions.project_settings import Project, labels_from_text, labels_to_text
from sessions.review import ROLES, NotPermittedError
from sessions.statistics import Overview, csv_text, duration, read_overview


class ProjectDialogs(Dialog):
    """Instructions and labels in one dialog, checks and export in the other.

    Args:
        changed: is called once settings changed, so that all screens are drawn.
    """

    def __init__(self, tab: Tab, project: Project, changed: Callable[[], None]) -> None:
        super().__init__(tab)
        self._project, self._changed = project, changed

    def show(self, which: str) -> None:
        """Show a dialog: "labels" or "checks"."""
        gui, tab = self._tab.client.gui, self._tab
        fill = self._checks if which == "checks" else self._labels
        with self._open({w: label for w, label, _ in words.DIALOGS}[which]):
            fields = fill(gui)
            save = gui.add_button(words.SAVE, icon=viser.Icon.CHECK, color="blue")
            self._add_close(words.CANCEL)
        save.on_click(lambda _: tab.act(lambda: self._save(fields())))

    def _labels(self, gui: Any) -> Callable[[], dict[str, Any]]:
        known = self._project.settings
        name = gui.add_text(words.NAME, known.name)
        text = gui.add_text(
            words.INSTRUCTIONS, known.instructions, multiline=True, hint=words.MARKDOWN
        )
        labels = gui.add_text(
            words.LABELS, labels_to_text(known.labels), multiline=True, hint=words.LABELS_HINT
        )
        gui.add_markdown(words.LABELS_HINT)
        strict = gui.add_checkbox(words.STRICT, known.strict, hint=words.STRICT_HINT)
        return lambda: {
            "name": name.value,
            "instructions": text.value,
            "labels": labels_from_text(labels.value),
            "strict": strict.value,
        }

    def _checks(self, gui: Any) -> Callable[[], dict[str, Any]]:
        known, collisions = self._project.settings, export_words.COLLISIONS
        gui.add_markdown(words.REQUIRED)
        kinds = {
            kind: gui.add_checkbox(label, kind in known.required)
            for kind, label in words.KINDS.items()
        }
        gui.add_markdown(words.EXPORT)
        formats = {
            n: gui.add_checkbox(format_title(n), n in known.formats) for n in exporter_names()
        }
        now = next(k for k, v in collisions.items() if v == known.collision)
        collision = gui.add_dropdown(export_words.COLLISION, tuple(collisions), initial_value=now)
        form = gui.add_dropdown(
            words.FORM, tuple(words.FORMS), initial_value=words.form_label(known.form)
        )
        license = gui.add_text(export_words.LICENSE, known.license, hint=export_words.LICENSE_HINT)
        author = gui.add_text(export_words.AUTHOR, known.author)
        return lambda: {
            "required": [k for k, box in kinds.items() if box.value],
            "formats": [n for n, box in formats.items() if box.value],
            "collision": collisions[collision.value],
            "form": words.FORMS[form.value],
            "license": license.value,
            "author": author.value,
        }

    def _save(self, fields: dict[str, Any]) -> None:
        self._project.change(fields, self._tab.user)
        self.close()
        self._tab.notify(words.TITLE, words.SAVED, "green", elsewhere=True)
        self._changed()


_SECONDS = 60.0
"""Longest reading of the log."""
_COLORS = ("#2f9e44", "#5b8def")
"""Colors of the plot's two lines; seen on light and dark ground alike."""


class ProjectPage(Dialog):
    """Shows the page over the picture.

    Args:
        open_object: gets the id of an object that was chosen.
    """

    def __init__(
        self, tab: Tab, app_state: AppState, presses: Presses, open_object: Callable[[int], None]
    ) -> None:
        super().__init__(tab)
        self._app_state, self._open_object = app_state, open_object
        self._found: Overview | None = None
        presses.on("project", lambda _: self.show())
        presses.on("project_object", self._chosen)
        presses.on("project_close", self._close_clicked, at_once=True)
        presses.on("project_csv", lambda _: self._send())
        self.dialogs = ProjectDialogs(tab, app_state.store.project, app_state.queue.changed)
        presses.on("project_settings", self._change)
        presses.on("project_learn", lambda _: self._learn())

    def show(self) -> None:
        """Show the page; a worker adds up the figures, as the log may be long."""
        gui, config = self._tab.client.gui, self._app_state.config
        title = plain(self._app_state.store.project.settings.name) or words.TITLE
        with self._open(title) as modal:
            said = gui.add_html(f'<p class="aw-project">{words.READING}</p>')
        job = self._app_state.workers.reading.submit(
            read_overview,
            self._app_state.workspace,
            config.database,
            time.time(),
            self._only(),
            most_seconds=_SECONDS,
        )
        job.add_done_callback(lambda job: self._tab.act(lambda: self._read(job, modal, said)))

    @property
    def _may_change(self) -> bool:
        """True if this person may change the project's settings."""
        account = self._tab.account
        return account is None or account.role == ROLES[-1]

    def _change(self, which: str) -> None:
        self.close()
        self.dialogs.show(which)

    def _learn(self) -> None:
        """Learn from accepted objects and notify the current user of the result."""
        tab = self._tab
        if not self._may_change:  # the page has no button for them, but a script can send anything
            raise NotPermittedError(words.MANAGERS_ONLY)

        def done(job: Job[dict[str, Any]]) -> None:
            tab.act(lambda: tab.notify(*learned_text(job.result(0)), "green"))

        self._app_state.learning.start(done)
        tab.notify(words.LEARNING, "", "blue")

    def _only(self) -> str | None:
        """Whose figures are shown: who annotates sees nobody else's."""
        account = self._tab.account
        return account.name if account is not None and account.role == ROLES[0] else None

    def _read(self, job: Job[Overview], modal: Any, said: Any) -> None:
        if self._modal is not modal:
            return  # closed meanwhile
        try:
            found = job.result(0)
        except BaseException:
            self.close()
            raise
        self._found = found
        # All at once: a button that moves while it is pressed isn't pressed.
        with self._tab.client.atomic(), modal:
            said.remove()
            self._fill(found)

    def _fill(self, found: Overview) -> None:
        gui, now = self._tab.client.gui, time.time()
        gui.add_html(
            f'<div class="aw-project">{progress_html(found, self._may_change)}'
            f"{self._learned_html()}"
            f'<h3 title="{escape(words.ACTIVE_HINT)}">{words.TODAY}</h3>{today_html(found)}'
            f"<h3>{words.LAST_DAYS}</h3></div>"
        )
        _add_plot(gui, found, now)
        gui.add_html(
            f'<div class="aw-project"><h3>{words.RECENT}</h3>{recent_html(found, now)}</div>'
        )

    def _learned_html(self) -> str:
        folder = in_use(self._app_state.workspace)
        record = {} if folder is None else record_of(folder)
        if not record:
            return ""
        text = learned_text({**record, "taken": True})[1]  # it is in use, also if by hand
        return f"<p>{escape(text)}.</p>"

    def _send(self) -> None:
        if self._found is not None:
            rows = csv_text(self._found.rows)
            send = self._tab.client.send_file_download
            send(words.FILE, rows.encode(), save_immediately=True)

    def _chosen(self, id: str) -> None:
        self.close()
        self._open_object(int(id))

    def close(self) -> bool:
        """Close the page and its dialogs; whether any was there."""
        dialog = self.dialogs.close()
        return super().close() or dialog


def learned_text(record: Mapping[str, Any]) -> tuple[str, str]:
    """Result of learning, as a title and a sentence."""
    after, before = (
        round(100 * record[side]["usable"] / max(record[side]["joints"], 1))
        for side in ("after", "before")
    )
    objects = len(record["assets"])
    if not record["taken"]:
        return words.NOT_BETTER, words.not_better(objects, after, before)
    return words.LEARNED, words.learned(objects, record["version"], after, before)


def _add_plot(gui: Any, found: Overview, now: float) -> None:
    """Accepted objects and active time of each day, with an axis for each."""
    ends = np.arange(len(found.days), dtype=np.float64) - len(found.days) + 1
    accepted = np.array([d.accepted for d in found.days], np.float64)
    active = np.array([d.active for d in found.days], np.float64)
    short = active.max() < 3600
    name, unit = (words.MINUTES, 60.0) if short else (words.HOURS, 3600.0)
    series = (
        viser.uplot.Series(label=words.DAY, value="{YYYY}-{MM}-{DD}"),
        viser.uplot.Series(
            label=words.ACCEPTED, stroke=_COLORS[0], fill=f"{_COLORS[0]}30", width=2, scale="y"
        ),
        viser.uplot.Series(label=name, stroke=_COLORS[1], width=2, scale="time"),
    )
    scales = {
        "x": viser.uplot.Scale(time=True),
        "y": viser.uplot.Scale(range=_range(accepted.max())),
        "time": viser.uplot.Scale(range=_range(active.max() / unit)),
    }
    axes = (
        viser.uplot.Axis(),
        viser.uplot.Axis(label=words.ACCEPTED, scale="y", labelSize=18, size=42),
        viser.uplot.Axis(
            label=name, scale="time", side=1, labelSize=18, size=46, grid={"show": False}
        ),
    )
    gui.add_uplot(
        ((math.floor(now / 86400) + ends) * 86400, accepted, active / unit),
        series,
        scales=scales,
        axes=axes,
        height=170,
        padding=(8, 0, 0, 0),
    )


def _range(most: float) -> tuple[float, float]:
    """From 0 to a bit above the largest value; a scale of nothing has some height, too."""
    return 0.0, 1.15 * float(most) if most else 1.0


def progress_html(found: Overview, may_change: bool = False) -> str:
    """A bar with a stretch for each state, and the numbers below it."""
    total = sum(found.states.values())
    accepted = found.states.get("accepted", 0)
    shown = [s for s in STATE_ORDER if found.states.get(s)]
    bar = "".join(
        f'<i data-state="{s}" style="flex-grow:{found.states[s]}" '
        f'title="{found.states[s]} {escape(common.STATES[s])}"></i>'
        for s in shown
    )
    numbers = "".join(
        f'<span data-state="{s}"><i></i>{found.states[s]} {escape(common.STATES[s])}</span>'
        for s in shown
    )
    share = round(100 * accepted / total) if total else 0
    head = f"<b>{words.accepted_of(accepted, total, share)}</b>"
    csv = button("project_csv", "", words.DOWNLOAD, tip=words.DOWNLOAD_HINT, style="aw-small")
    if may_change:
        csv = (
            "".join(
                button("project_settings", which, label, tip=tip, style="aw-small")
                for which, label, tip in words.DIALOGS
            )
            + csv
        )
        if accepted:
            learn = button("project_learn", "", words.LEARN, tip=words.LEARN_HINT, style="aw-small")
            csv = learn + csv
    close = button("project_close", "", words.CLOSE, style="aw-small")
    return (
        f'<header>{head}{csv}{close}</header><div class="aw-states">{bar}</div>'
        f'<p class="aw-legend">{numbers}</p>'
    )


def today_html(found: Overview) -> str:
    """A row for each person who did something today."""
    if not found.people:
        return f"<p>{words.NOBODY}</p>"
    rows = [
        (
            who,
            f.objects,
            f.accepted,
            words.TOO_FEW if math.isnan(f.per_hour) else f"{f.per_hour:.1f}",
            duration(f.active),
            duration(f.waiting),
            f.clicks,
            f.corrections,
        )
        for who, f in found.people.items()
    ]
    head = "".join(f"<th>{escape(c)}</th>" for c in words.COLUMNS)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def recent_html(found: Overview, now: float) -> str:
    """Buttons that open the objects that were worked on last."""
    if not found.recent:
        return f"<p>{words.NOTHING}</p>"
    rows = []
    for each in found.recent:
        about = " · ".join((common.STATES[each.state], each.who, words.ago(now - each.at)))  # type: ignore[index]
        content = f"<b>{escape(each.name)}</b><small>{escape(about)}</small>"
        rows.append(
            f'<li data-state="{each.state}">'
            + button("project_object", str(each.id), f"{each.name}: {about}", content=content)
            + "</li>"
        )
    return f"<ul>{''.join(rows)}</ul>"
