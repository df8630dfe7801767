"""Command-line options declared as documented dataclasses.

A subcommand is a :class:`Command`: a frozen dataclass whose fields are its arguments and options,
each with its help beside it, and whose ``run`` does the work. The parser, the help pages and
``docs/command-line.md`` are made of these fields alone.
"""

from __future__ import annotations

import argparse
import logging
import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


class Command:
    """A subcommand; the first line of a subclass's docstring is its description.

    Attributes:
        log_level: least severe message that is shown.
        subcommands: name → command, where the command only groups others.
        default_subcommand: the one of them that is meant where none is named, or "".
    """

    log_level: ClassVar[int] = logging.ERROR
    subcommands: ClassVar[dict[str, type[Command]]] = {}
    default_subcommand: ClassVar[str] = ""

    def run(self) -> int:
        """Carry the command out and return the exit code. Heavy modules are imported here."""
        raise NotImplementedError


@dataclass(frozen=True)
class Option:
    """Help text and parsing of a field.

    Attributes:
        help: one line; the default is appended.
        metavar: stands for the value.
        flag: option name, unless it is that of the field; "" for a positional argument.
        parse: converts a word to the value; raises ValueError, which shows its ``__name__``.
        repeat: whether the option may be repeated; the field is a tuple.
        nargs: "+" or "*" for several words; the field is a tuple.
        negatable: whether a flag has a ``--no-`` form.
        synonym: a second option that sets the same field.
        instead_of: the field of a required option that isn't needed where this one is given.
    """

    help: str
    metavar: str | tuple[str, ...] | None = None
    flag: str | None = None
    parse: Callable[[str], Any] | None = None
    repeat: bool = False
    nargs: str | None = None
    negatable: bool = False
    synonym: Option | None = None
    instead_of: str = ""


def required(help: str, metavar: str, **settings: Any) -> Any:
    """Declare a field as an option that must be given; ``settings`` as of :class:`Option`."""
    return field(metadata={"option": Option(help, metavar, **settings)})


def option(
    help: str, metavar: str | tuple[str, ...] | None = None, default: Any = None, **settings: Any
) -> Any:
    """Declare a field as an option with a value; ``tuple[X, X]`` takes two words."""
    return field(default=default, metadata={"option": Option(help, metavar, **settings)})


def repeated(help: str, metavar: str, default: Any = (), **settings: Any) -> Any:
    """Declare a tuple as an option that may be repeated, one value each time."""
    return option(help, metavar, default, repeat=True, **settings)


def flag(help: str, default: bool | None = False, *, negatable: bool = False) -> Any:
    """Declare a ``bool`` as an option without a value; one that is on can be switched off."""
    return option(help, None, default, negatable=negatable or bool(default))


def argument(
    help: str, metavar: str | None, nargs: str | None = None, default: Any = MISSING
) -> Any:
    """Declare a field as a positional argument."""
    return field(default=default, metadata={"option": Option(help, metavar, "", nargs=nargs)})


def group(options: type[T], title: str | None = None) -> T:
    """Declare a field that holds a dataclass of options, which stand among the command's own."""
    return field(default_factory=options, metadata={"title": title})


def add_commands(
    parser: argparse.ArgumentParser, commands: dict[str, type[Command]], **settings: Any
) -> None:
    """Add ``commands`` and their options to ``parser``; the one chosen becomes ``command``.

    Args:
        settings: of :meth:`argparse.ArgumentParser.add_subparsers`.
    """
    kinds = parser.add_subparsers(required=True, parser_class=type(parser), **settings)
    for name, command in commands.items():
        text = (command.__doc__ or "").partition("\n")[0]
        short = text[0].lower() + text[1:].rstrip(".")
        below = kinds.add_parser(name, help=short, description=text)
        if command.subcommands:
            add_commands(below, command.subcommands, metavar="|".join(command.subcommands))
        else:
            add_options(below, command)
            below.set_defaults(command=command)
        # Also after the command; SUPPRESS keeps its default from undoing the one before it.
        below.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS
        )


def add_options(parser: Any, options: type) -> None:
    """Add the fields of a dataclass to ``parser``, an argparse parser or argument group."""
    hints = get_type_hints(options)
    for each in fields(options):
        hint = hints[each.name]
        if is_dataclass(hint):
            title = each.metadata["title"]
            add_options(parser.add_argument_group(title) if title else parser, hint)  # type: ignore[arg-type]
            continue
        spec: Option = each.metadata["option"]
        default = None if each.default is MISSING else each.default
        if spec.flag == "":
            settings = {} if default is None else {"default": default}
            parser.add_argument(each.name, **settings, **_settings(spec, hint, default))
            continue
        name = spec.flag or f"--{each.name.replace('_', '-')}"
        parser.add_argument(
            name, dest=each.name, required=each.default is MISSING,
            default=list(default) if isinstance(default, tuple) else default,
            **_settings(spec, hint, default),
        )  # fmt: skip
        if (also := spec.synonym) is not None:
            settings = _settings(also, hint, None)
            parser.add_argument(also.flag, dest=each.name, default=argparse.SUPPRESS, **settings)


def _settings(spec: Option, hint: Any, default: Any) -> dict[str, Any]:
    """Arguments of ``add_argument`` for an option whose field has the type ``hint``."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    repeat = "; may be repeated" if spec.repeat else ""
    text = {"help": spec.help + _default_text(spec.help, default) + repeat}
    if hint is bool:
        return text | {"action": argparse.BooleanOptionalAction if spec.negatable else "store_true"}
    settings: dict[str, Any] = text | {"metavar": spec.metavar}
    if spec.instead_of:
        settings |= {"action": _InsteadOf, "const": spec.instead_of}
    if spec.repeat:
        settings["action"] = "append"
    elif spec.nargs:
        settings["nargs"] = spec.nargs
    elif get_origin(hint) is tuple and spec.parse is None:
        settings["nargs"] = len(get_args(hint))
    if get_origin(hint) is tuple:
        hint = get_args(hint)[0]
    if get_origin(hint) is Literal:
        return settings | {"choices": get_args(hint)}
    return (
        settings if spec.parse is None and hint is str else settings | {"type": spec.parse or hint}
    )


class _InsteadOf(argparse.Action):
    """Stores its value; the option of the field ``const`` isn't required any more."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        setattr(namespace, self.dest, values)
        for each in parser._actions:
            each.required &= each.dest != self.const


def _default_text(help: str, default: Any) -> str:
    if default is None or isinstance(default, bool) or default in ("", (), math.inf):
        return ""
    if "(default:" in help:
        return ""
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    return f" (default: {shown:g})" if isinstance(shown, float) else f" (default: {shown})"


def from_namespace(options: type[T], values: argparse.Namespace) -> T:
    """The dataclass ``options`` with what :func:`add_options` read; lists become tuples."""
    hints = get_type_hints(options)
    found: dict[str, Any] = {}
    for each in fields(options):  # type: ignore[arg-type]
        if is_dataclass(hints[each.name]):
            found[each.name] = from_namespace(hints[each.name], values)  # type: ignore[arg-type]
            continue
        value = getattr(values, each.name)
        found[each.name] = tuple(value) if isinstance(value, list) else value
    return options(**found)
