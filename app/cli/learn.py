"""``artiworld train --workspace``: predictions that know what was accepted."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

from app.cli import printing
from app.cli.research_commands import TrainCommand
from app.server.learning import learn_from
from app.server.leftovers import WorkspaceLease
from model.prediction.experience import FOLDER, record_of
from model.training.experience import use
from sessions.command_log import check_workspace


def learn(options: TrainCommand, workspace: Path) -> int:
    """Learn from a workspace, or go back to an earlier version; returns the exit code.

    Raises:
        ConfigurationError: for an unknown version or object, or too few accepted objects.
    """
    check_workspace(workspace, options.database)
    if options.use is not None:
        use(workspace, options.use)
        record = record_of(workspace / FOLDER / str(options.use)) if options.use else {}
        with printing.session(options.json) as show:
            text = f"predictions use version {options.use}" if options.use else "nothing is used"
            show.result(record, lambda: print(text))
        return 0
    with closing(WorkspaceLease(workspace)), printing.session(options.json) as show:
        learned = learn_from(
            workspace, options.database, options.without, options.jobs or 2, show.progress
        )
    show.result(learned, lambda: _print(learned))
    return 0


def _print(learned: dict[str, Any]) -> None:
    print(f"version {learned['version']}: {len(learned['assets'])} accepted objects")
    print("each predicted, against what was accepted:")
    for label, side in (("without", learned["before"]), ("with the others", learned["after"])):
        print(f"  {label:<16}{_figures(side)}")
    if learned["taken"]:
        print("it is better: predictions in this workspace use it from now on")
    else:
        print("it is no better: predictions stay as they are")


def _figures(side: dict[str, Any]) -> str:
    return (
        f"{side['usable']} of {side['joints']} joints and {side['objects']} objects usable, "
        f"calibration error {side['calibration_error']:.3f}"
    )
