"""The subcommands for work in a team: figures, quality and releases.

Each ``run`` imports the module that does the work; nothing else here does.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from app.cli.command import Command, argument, option
from app.cli.options import json_flag, positive_number
from model.core.registry import at_place


def moment(text: str) -> float:
    """Read a day or a moment, ISO 8601, UTC where it says no zone; seconds since 1970."""
    found = datetime.fromisoformat(text)
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


moment.__name__ = "day (2026-01-31) or time (2026-01-31T12:00)"


@dataclass(frozen=True, kw_only=True)
class StatsCommand(Command):
    """Say how long people worked, what they did and what it cost."""

    workspace: Path = argument("folder of sessions and accepted assets", "WORKSPACE")
    by: Literal["person", "category", "predictor", "step", "object", "day"] = option(
        "a row for each of these", default="person"
    )
    since: float | None = option("leave out what was done before", "TIME", parse=moment)
    rate: float | None = option(
        "price of an hour of active time, for the cost", "PRICE", parse=positive_number
    )
    csv: Path | None = option("write the rows into this file, too", "FILE")
    database: str | None = option(
        "URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL"
    )
    json: bool = json_flag()

    def run(self) -> int:
        """Print the figures."""
        return at_place("app.cli.stats:stats")(self)
