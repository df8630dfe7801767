"""``artiworld project``: what all who work on a project share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.cli import printing
from app.cli.team_commands import ProjectSetCommand, ProjectShowCommand
from model.core import codec
from model.core.errors import ConfigurationError, InputFileError
from sessions.command_log import check_workspace
from sessions.project_settings import ProjectSettings, labels_from_text, labels_to_text
from sessions.store import Store


def show(options: ProjectShowCommand, fields: dict[str, Any] | None = None) -> int:
    """Print the settings, once ``fields`` are changed; returns the exit code."""
    check_workspace(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        settings = store.project.change(fields) if fields else store.project.settings
    finally:
        store.close()
    with printing.session(options.json) as shown:
        pass
    shown.result(codec.write(settings), lambda: _print(settings))
    return 0


def change(options: ProjectSetCommand) -> int:
    """Change what is given, and print all; returns the exit code."""
    same = ("name", "strict", "collision", "form", "license", "author")
    fields: dict[str, Any] = {k: getattr(options, k) for k in same}
    if options.instructions is not None:
        fields["instructions"] = _text(options.instructions)
    if options.labels is not None:
        fields["labels"] = labels_from_text(_text(options.labels))
    if options.require is not None:
        fields["required"] = _list("" if options.require == "none" else options.require)
    if options.format is not None:
        fields["formats"] = _list(options.format)
    fields = {k: v for k, v in fields.items() if v is not None}
    if not fields:
        raise ConfigurationError("nothing to change; give --instructions, --labels, …")
    return show(options, fields)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputFileError(path, "can't be read as text", "give a file in UTF-8") from error


def _list(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _print(settings: ProjectSettings) -> None:
    rows = [
        ("name", settings.name),
        ("instructions", f"{len(settings.instructions)} characters"),
        ("labels", labels_to_text(settings.labels)),
        ("names outside of the labels", "errors" if settings.strict else "allowed"),
        ("required checks", ", ".join(settings.required)),
        ("export", f"{', '.join(settings.formats)} {settings.collision}".strip()),
        ("release", f"{settings.form} {settings.license} {settings.author}".strip()),
    ]
    title = settings.name or "Project"
    printing.console().print(printing.table_of(title, ("setting", "value"), rows))
