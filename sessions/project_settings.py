"""Settings of a manager for all who work on a project: instructions, labels, checks, export."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

from sqlalchemy import Column, Integer, String, Table, Text, delete, insert, select

from model.core import codec
from model.core.errors import CommandError, ConfigurationError
from model.io.export.registry import exporter_names
from model.validation.report import Kind
from sessions.account_tables import accounts, record
from sessions.accounts import COMMAND_LINE, in_use
from sessions.checks import NAME_LIMIT, clean_field, clean_text, put_field
from sessions.database import Database, metadata, now
from sessions.review import NotPermittedError

Form = Literal["folder", "webdataset", "huggingface"]
FORMS: Final[tuple[str, ...]] = get_args(Form)


INSTRUCTIONS_LIMIT = 20_000
"""Characters: ten pages, which a browser gets with each change."""
MOST_LABELS = 500
Collision = Literal["", "hollow", "auto", "coacd", "hull", "none"]
"""Methods of collision shapes; "" keeps those that were saved, "none" writes none."""

project = Table(
    "project",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("settings", Text, nullable=False),
    Column("who", Text, nullable=False),
    Column("at", String(32), nullable=False),
)


@dataclass(frozen=True)
class Label:
    """A category, and the names of its parts; none: any name."""

    category: str
    parts: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProjectSettings:
    """Settings of a project.

    Attributes:
        name: shown above the project page.
        instructions: Markdown, shown beside the picture.
        labels: categories and the names of their parts, which are offered first.
        strict: whether a name that isn't in ``labels`` is an error of the checks.
        required: kinds of findings (:data:`~model.validation.report.KINDS`) whose warnings and
            errors prevent acceptance, with no override.
        formats: simulators' formats that an export begins with.
        collision: method of collision shapes.
        form: of releases.
        license, author: of releases; "" for those of the last SimReady package.

    Raises:
        ConfigurationError: naming the setting, the value, and what would be right.
    """

    name: str = ""
    instructions: str = ""
    labels: tuple[Label, ...] = ()
    strict: bool = False
    required: tuple[Kind, ...] = ()
    formats: tuple[str, ...] = ("urdf",)
    collision: Collision = ""
    form: Form = "folder"
    license: str = ""
    author: str = ""

    def __post_init__(self) -> None:
        try:
            for field in ("name", "license", "author"):
                clean_field(self, field, 200, field)
            clean_field(self, "instructions", INSTRUCTIONS_LIMIT, "instructions", lines=True)
            labels = tuple(_clean(label) for label in self.labels)
        except CommandError as error:
            raise ConfigurationError(str(error)) from error
        put_field(self, "labels", labels)
        wrong = [f for f in self.formats if f not in exporter_names()]
        if wrong or not self.formats:
            known = ", ".join(exporter_names())
            raise ConfigurationError(f"formats: {wrong or 'nothing'} is given; choose of {known}")
        names = [label.category.casefold() for label in labels]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise ConfigurationError(f"labels: the category {twice} is there twice")
        if sum(1 + len(label.parts) for label in labels) > MOST_LABELS:
            raise ConfigurationError(f"labels: at most {MOST_LABELS} names are allowed")
        if self.strict and not labels:
            raise ConfigurationError("strict: only names of the list are allowed; give labels")

    @property
    def categories(self) -> tuple[str, ...]:
        """The categories in the order of the list."""
        return tuple(label.category for label in self.labels)

    def part_names(self, category: str | None) -> tuple[str, ...]:
        """Names of parts of a category; those of all where it isn't listed."""
        mine = [label for label in self.labels if _same(label.category, category)]
        return tuple(dict.fromkeys(n for label in mine or self.labels for n in label.parts))

    def knows_category(self, category: str) -> bool:
        """True if a category may be used."""
        return not self.strict or any(_same(c, category) for c in self.categories)

    def knows_part(self, name: str, category: str | None) -> bool:
        """True if a part of such an object may have that name."""
        names = self.part_names(category)
        return not self.strict or not names or any(_same(n, name) for n in names)

    def changed(self, fields: Mapping[str, Any]) -> ProjectSettings:
        """Return settings with other values, as JSON data.

        Raises:
            ConfigurationError: where a field is unknown or its value unusable.
        """
        try:
            return replace(self, **codec.read_fields(ProjectSettings, fields, "project"))
        except codec.CodecError as error:
            raise ConfigurationError(str(error)) from error


class Project:
    """The settings of a workspace, known without asking the database each time.

    Methods may be called from any thread.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._known: ProjectSettings | None = None

    @property
    def settings(self) -> ProjectSettings:
        """As they were at the last :meth:`refresh`, or changed here since."""
        if self._known is None:
            self.refresh()
        assert self._known is not None
        return self._known

    def refresh(self) -> bool:
        """Read what others changed; whether anything did since they were read last."""
        with self._lock, self._database.reading() as connection:
            text = connection.execute(select(project.c.settings)).scalar()
            before, self._known = self._known, _read(text)
        return before is not None and self._known != before

    def change(self, fields: Mapping[str, Any], by: str = COMMAND_LINE) -> ProjectSettings:
        """Change some settings; returns all of them.

        Args:
            fields: as JSON data; what is left out stays.
            by: author, a manager where there are accounts.

        Raises:
            ConfigurationError: where a value is unusable.
            NotPermittedError: where ``by`` is no manager now.
        """
        with self._lock, self._database.writing() as connection:
            role = select(accounts.c.role).where(accounts.c.name == by)
            role = role.where(accounts.c.status == "active")
            if (
                by != COMMAND_LINE
                and in_use(connection)
                and connection.execute(role).scalar() != "manager"
            ):
                raise NotPermittedError("only a manager may change the project's settings")
            before = _read(connection.execute(select(project.c.settings)).scalar())
            after = before.changed(fields)
            if after != before:
                text = json.dumps(codec.write(after), separators=(",", ":"))
                connection.execute(delete(project))
                values = {"id": 1, "settings": text, "who": by, "at": now()}
                connection.execute(insert(project).values(values))
                differ = [f for f in fields if getattr(before, f) != getattr(after, f)]
                record(connection, "project_changed", by, "project", ", ".join(differ))
        self._known = after
        return after


def labels_from_text(text: str) -> list[dict[str, Any]]:
    """Read labels as people write them, ``Oven: door, knob`` a line; as JSON data."""
    out = []
    for line in filter(str.strip, text.splitlines()):
        category, _, parts = line.partition(":")
        names = [p.strip() for p in parts.split(",") if p.strip()]
        out.append({"category": category.strip(), "parts": names})
    return out


def labels_to_text(labels: tuple[Label, ...]) -> str:
    """Write labels as :func:`labels_from_text` reads them."""
    return "\n".join(
        f"{e.category}: {', '.join(e.parts)}" if e.parts else e.category for e in labels
    )


def _read(text: str | None) -> ProjectSettings:
    return ProjectSettings() if text is None else ProjectSettings().changed(json.loads(text))


def _clean(label: Label) -> Label:
    category = clean_text(label.category, NAME_LIMIT, "a category")
    parts = tuple(clean_text(p, NAME_LIMIT, "a part's name") for p in label.parts)
    for what, name in (("category", category), *(("part", p) for p in parts)):
        if not name or any(c in name for c in ",:\n"):
            raise ConfigurationError(
                f"labels: the {what} {name!r} needs letters, and neither comma nor colon"
            )
    return Label(category, tuple(dict.fromkeys(parts)))


def _same(one: str, other: str | None) -> bool:
    """True if two names are alike: "washing machine" is WashingMachine."""
    return one.replace(" ", "").casefold() == (other or "").replace(" ", "").casefold()
