"""Reports as Markdown. Names come from files and are escaped."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from model.core.files import written_to
from model.evaluation.report import COLUMNS, Report, faults, figure_row, paper_rows, summary_cells
from model.evaluation.summary import METRICS

MOST_FAULTS = 6


def to_markdown(reports: Sequence[Report]) -> str:
    """Format the table of all runs with the paper's rows, then each run's figures and failures."""
    first = reports[0]
    lines = [f"# Evaluation on {escaped(first.dataset)}", ""]
    rows = [r.row() for r in reports] + paper_rows()
    lines += table(("method", *COLUMNS), rows)
    lines += [
        "",
        "Means over joints; TC, tree and usable count missing and extra joints. APD and ALD in "
        "rad, OPD and DLD in metres. The paper's rows are its own figures on its own objects.",
    ]
    for report in reports:
        lines += _run(report)
    return "\n".join(lines) + "\n"


def write_markdown(reports: Sequence[Report], path: Path) -> Path:
    """Write :func:`to_markdown`.

    Raises:
        InputFileError: where it can't be written.
    """
    with written_to(path):
        path.write_text(to_markdown(reports), encoding="utf-8")
    return path


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table of escaped cells."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(escaped(cell) for cell in row) + " |" for row in rows),
    ]


def escaped(text: str) -> str:
    """Escape Markdown and HTML, on one line."""
    plain = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"([\\`*\[\]|!#])", r"\\\1", plain)


def _run(report: Report) -> list[str]:
    s = report.summary
    limits = report.settings.get("limits", {})
    lines = ["", f"## {escaped(report.label)}", ""]
    lines.append(
        f"{s.objects} objects, {s.joints} joints; {s.missing} missing, {s.unparseable} "
        f"unparseable, {s.extra} extra, {s.failed} objects without a prediction. "
        f"{_seconds(report)}"
    )
    if report.frame is not None:
        lines.append(f"Frame of the files: {escaped(report.frame)}.")
    lines += [
        f"A joint is usable where its type and parent are right, the axis is within "
        f"{limits.get('axis')} rad, the origin within {limits.get('origin')} of the diagonal from "
        f"the true line, and the range overlaps by {limits.get('range_iou')} (IoU) or both ends "
        f"are within {limits.get('angle')} rad or {limits.get('travel')} diagonals.",
        "",
    ]
    lines += table(
        ("figure", "value", "95 % interval", "unit", "definition", "source"),
        [figure_row(report, m) for m in METRICS],
    )
    lines += _calibration(report)
    lines += ["", "### By category", ""]
    lines += table(
        ("category (objects, joints)", *COLUMNS),
        [
            (f"{c} ({v.objects}, {v.joints})", *summary_cells(v))
            for c, v in report.by_category.items()
        ],
    )
    failed = [o for o in report.scores if not o.usable]
    lines += ["", f"### Not usable: {len(failed)} objects", ""]
    for o in failed:
        found = faults(o)
        more = "; …" if len(found) > MOST_FAULTS else ""
        shown = escaped("; ".join(found[:MOST_FAULTS]))
        lines.append(
            f"- {escaped(o.object_id)} ({escaped(o.category or 'unknown')}): {shown}{more}"
        )
    return lines + _execution(report)


def _execution(report: Report) -> list[str]:
    driven = [(o, o.execution) for o in report.scores if o.execution is not None]
    if not driven:
        return []
    stuck = [(o, run) for o, run in driven if not run.executable]
    kinds: dict[str, int] = {}
    for _, run in stuck:
        for kind in run.kinds:
            kinds[kind] = kinds.get(kind, 0) + 1
    counts = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items(), key=lambda k: -k[1]))
    lines = ["", f"### Not executable: {len(stuck)} of {len(driven)} objects", ""]
    lines += [f"Objects by kind of error: {counts}.", ""] if counts else []
    return lines + [f"- {escaped(o.object_id)}: {escaped(run.why)}" for o, run in stuck]


def _seconds(report: Report) -> str:
    mean = sum(report.seconds) / max(1, len(report.seconds))
    return (
        f"{mean:.2f} s an object, at most {max(report.seconds, default=0):.2f} s; the run took "
        f"{report.wall_seconds:.0f} s."
    )


def _calibration(report: Report) -> list[str]:
    c = report.calibration
    if not c.joints:
        return []
    rows = [
        (f"{b.low:.1f}–{b.high:.1f}", str(b.joints), f"{b.confidence:.2f}", f"{100 * b.usable:.0f}")
        for b in c.bins
    ]
    return [
        "",
        "### Confidence",
        "",
        f"{c.joints} joints with a confidence; expected calibration error {c.ece:.3f}, Brier score "
        f"{c.brier:.3f}.",
        "",
        *table(("confidence", "joints", "mean", "usable %"), rows),
    ]
