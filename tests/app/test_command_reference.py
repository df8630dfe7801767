"""Every command and option is explained, and docs/command-line.md is up to date."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
import tyro

from app.cli.main import main
from app.cli.options import (
    REGISTRY,
    Command,
    Options,
    argument,
    description,
    flag,
    group,
    option,
    repeated,
    required,
    shown,
)
from app.cli.reference import DOCUMENT, commands, reference


def test_the_reference_is_up_to_date():
    assert DOCUMENT.read_text(encoding="utf-8") == reference(), "run: python -m app.cli.reference"


@pytest.mark.parametrize(("name", "command"), list(commands()))
def test_every_command_and_option_is_explained(name, command, capsys):
    assert description(command).endswith(".")
    assert main([*name.split(), "--help"]) == 0
    page = capsys.readouterr().out
    assert page.startswith(f"usage: artiworld {name} ")
    for each, help in shown(command).items():
        assert help and each in page


@dataclass(frozen=True, kw_only=True)
class Size(Options):
    """A group of options."""

    size: float = option("size", "M", 1.0)


@dataclass(frozen=True, kw_only=True)
class Made(Command):
    """Make an example."""

    paths: tuple[Path, ...] = argument("paths", "PATH", ())
    out: Path = required("folder", "DIR")
    kind: Literal["a", "b"] = option("kind", None, "a")
    pair: tuple[int, int] | None = option("two numbers", "X Y")
    names: tuple[str, ...] = repeated("names", "NAME", flag="name")
    many: tuple[int, ...] = option("numbers", "N...", (7,))
    axis: str | None = option("axis", "AXIS", tokens=("-z",))
    on: bool = flag("on by default", True)
    off: bool = flag("off by default")
    size: Size = group(Size)


def made(*words: str) -> Made:
    return tyro.cli(
        Made,
        args=["--out", "o", *words],
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
        registry=REGISTRY,
    )


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        ([], "many", (7,)),
        (["p", "q"], "paths", (Path("p"), Path("q"))),
        (["--kind", "b"], "kind", "b"),
        (["--pair", "1", "2"], "pair", (1, 2)),
        (["--name", "a", "--name", "b"], "names", ("a", "b")),
        (["--many", "1", "2"], "many", (1, 2)),
        (["--axis", "-z"], "axis", "-z"),
        (["--no-on"], "on", False),
        (["--off"], "off", True),
        (["--size", "2"], "size", Size(size=2.0)),
    ],
)
def test_values_are_read_by_the_fields_type(words, name, value):
    assert getattr(made(*words), name) == value


@pytest.mark.parametrize("words", ["--kind c", "--pair 1", "--pair 1 x", "--no-off", "--many"])
def test_what_a_type_cant_read_is_refused(words, capsys):
    with pytest.raises(SystemExit):
        made(*words.split())
    assert re.search("--kind|--pair|--no-off|--many", capsys.readouterr().err)
