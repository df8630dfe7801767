"""Every command and option is explained, and docs/command-line.md is up to date."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from app.cli.main import make_parser
from app.cli.options import (
    Command,
    Option,
    add_commands,
    argument,
    flag,
    from_namespace,
    group,
    option,
    repeated,
    required,
)
from app.cli.reference import DOCUMENT, arguments, parsers, reference


def test_the_reference_is_up_to_date():
    assert DOCUMENT.read_text(encoding="utf-8") == reference(), "run: python -m app.cli.reference"


def test_every_command_and_option_is_explained():
    for parser in parsers(make_parser()):
        assert parser.description and parser.description.endswith("."), parser.prog
        for action in arguments(parser):
            assert action.help, action


@dataclass(frozen=True, kw_only=True)
class Size:
    """A group of options."""

    size: float = option("size", "M", 1.0)


@dataclass(frozen=True, kw_only=True)
class Made(Command):
    """Make an example."""

    paths: tuple[Path, ...] = argument("paths", "PATH", "*", ())
    out: Path = required("folder", "DIR")
    kind: Literal["a", "b"] = option("kind", None, "a")
    pair: tuple[int, int] | None = option("two numbers", ("X", "Y"))
    names: tuple[str, ...] = repeated("names", "NAME", flag="--name")
    many: tuple[int, ...] = option("numbers", "N", (7,), nargs="+")
    user: str = option(
        "user", "USER", "me", synonym=Option("group", "GROUP", "--group", "group:{}".format)
    )
    on: bool = flag("on by default", True)
    off: bool = flag("off by default")
    size: Size = group(Size)


def made(*words: str) -> Made:
    parser = argparse.ArgumentParser()
    add_commands(parser, {"made": Made})
    values = parser.parse_args(["made", "--out", "o", *words])
    command = from_namespace(values.command, values)
    assert isinstance(command, Made)
    return command


def test_defaults_come_from_the_fields():
    assert made() == Made(out=Path("o"))


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (["p", "q"], "paths", (Path("p"), Path("q"))),
        (["--kind", "b"], "kind", "b"),
        (["--pair", "1", "2"], "pair", (1, 2)),
        (["--name", "a", "--name", "b"], "names", ("a", "b")),
        (["--many", "1", "2"], "many", (1, 2)),
        (["--user", "you"], "user", "you"),
        (["--group", "us"], "user", "group:us"),
        (["--no-on"], "on", False),
        (["--off"], "off", True),
        (["--size", "2"], "size", Size(size=2.0)),
    ],
)
def test_values_are_read_by_the_fields_type(words, name, value):
    assert getattr(made(*words), name) == value


def test_what_a_type_cant_read_is_refused(capsys):
    for words in (["--kind", "c"], ["--pair", "1"], ["--pair", "1", "x"], ["--no-off"]):
        with pytest.raises(SystemExit):
            made(*words)
    assert "--kind" in capsys.readouterr().err
