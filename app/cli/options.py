"""Command-line options declared as documented dataclasses, and those that several commands share.

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
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from model.prediction import DEFAULT, TOKEN_VARIABLE

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
            name,
            dest=each.name,
            required=each.default is MISSING,
            default=list(default) if isinstance(default, tuple) else default,
            **_settings(spec, hint, default),
        )
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


Vector = tuple[float, float, float]

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
SIGNED_OPTIONS = ("--up-axis", "--up", "--length")
"""Options whose value may begin with a minus."""

ENGINE_HELP = "engines that drive the joints: mujoco, or mujoco,sapien"
MASKS_HELP = "start from masks of another system: .npy, .npz, .ply, .glb, or a folder of meshes"
SEGMENTER_HELP = "segmenter that turns clicks into parts (default: ArtiWorld's own)"


def positive_number(text: str) -> float:
    """Read a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def count(text: str) -> int:
    """Read a whole number from 0."""
    value = int(text)
    if value < 0:
        raise ValueError
    return value


def positive_count(text: str) -> int:
    """Read a whole number from 1."""
    value = int(text)
    if value < 1:
        raise ValueError
    return value


def direction(text: str) -> Vector | None:
    """Read an axis with its sign or three numbers "X,Y,Z"; None for "auto"."""
    if text == "auto":
        return None
    if text in UP_AXES:
        x, y, z = (float(letter == text[-1]) for letter in "xyz")
        sign = -1.0 if text[0] == "-" else 1.0
        return sign * x, sign * y, sign * z
    x, y, z = (float(word) for word in text.split(","))
    if not 1e-9 < x * x + y * y + z * z < float("inf"):
        raise ValueError
    return x, y, z


def measured(text: str) -> tuple[Vector, Vector, float]:
    """Read a known length, "x1,y1,z1,x2,y2,z2=M"."""
    places, _, metres = text.partition("=")
    a, b, c, d, e, f = (float(word) for word in places.split(","))
    return (a, b, c), (d, e, f), float(metres)


direction.__name__ = "up direction (auto, x, -x, y, -y, z, -z or X,Y,Z)"
measured.__name__ = "length (x1,y1,z1,x2,y2,z2=METRES)"
positive_number.__name__ = "positive number"
count.__name__ = "whole number"
positive_count.__name__ = "number from 1"


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Options for reading geometry files."""

    up_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = option(
        f"up axis of the files, one of {', '.join(UP_AXES)} (default: by format)", "AXIS"
    )
    unit_scale: float = option(
        "metres per unit of the files, 0.001 for millimetres", "METRES", 1.0, parse=positive_number
    )


@dataclass(frozen=True, kw_only=True)
class OidcOptions:
    """Login with an organisation's OpenID Connect provider."""

    oidc_issuer: str | None = option("OpenID Connect provider with which people log in", "URL")
    oidc_client: str = option("id under which this server is registered there", "ID", "artiworld")
    oidc_secret: str | None = option("its secret; or set ARTIWORLD_OIDC_SECRET", "SECRET")
    oidc_name_claim: str = option(
        "claim that names a person at the first login", "NAME", "preferred_username"
    )
    oidc_role_claim: str | None = option(
        "claim that holds the role: annotator, reviewer or manager (default: roles are set here)",
        "NAME",
    )
    oidc_anybody: bool = flag("give people without an invitation an account, as annotators")
    oidc_label: str = option("label of the button", "TEXT", "Log in with your organisation")


@dataclass(frozen=True, kw_only=True)
class PredictorOptions:
    """The predictor, or an ArtiWorld backend that has one."""

    predictor: str = option("predictor of the joints", "NAME", DEFAULT)
    backend: str | None = option("ask an artiworld backend instead of predicting here", "URL")
    backend_token: str | None = option(f"token of the backend; or set {TOKEN_VARIABLE}", "TOKEN")


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """Mass, collision shapes and joint dynamics.

    An option for shapes, masses or dynamics replaces what the asset's source declares.
    """

    no_collision: bool = flag("leave collision shapes out")
    method: str | None = option(
        "make collision shapes, also where the file declares them: hollow, coacd, hull, or auto "
        "(hollow, and coacd where that is better) (default: hollow, where the file declares none)",
        "NAME",
    )
    max_hulls: int | None = option(
        "most collision shapes of a part, made for all parts (default: 24)", "N"
    )
    density: float | None = option("kg/m³ of every part, instead of the table's", "KG")
    material: str | None = option("material of every part, such as wood or metal", "NAME")
    materials: Path | None = option(
        "your own table, in the form of static_assets/physics/materials.json", "FILE"
    )
    turning: str | None = option("of turning joints, in N m s/rad,N m", "DAMPING,FRICTION")
    sliding: str | None = option("of sliding joints, in N s/m,N", "DAMPING,FRICTION")
    free_base: bool = flag("let the base move, in formats that state it (MJCF, SDF, USD)")
    cache: Path | None = option(
        "folder of cached collision shapes (default: ~/.cache/artiworld/collision)", "DIR"
    )
    no_cache: bool = flag("cache no collision shapes")


def json_flag() -> Any:
    """``--json``."""
    return flag("print JSON and nothing else")


def seed_option(help: str = "the only source of randomness") -> Any:
    """``--seed SEED``."""
    return option(help, "SEED", 0, parse=count)


def segmenter_option() -> Any:
    """``--segmenter NAME``; ``--point-sam PATH`` stands for ``--segmenter point-sam:PATH``."""
    point_sam = Option(
        "use Point-SAM, with the published weights at PATH",
        "PATH",
        "--point-sam",
        "point-sam:{}".format,
    )
    return option(SEGMENTER_HELP, "NAME", "default", synonym=point_sam)
