"""Command-line options declared as documented dataclasses, and those that several commands share.

A subcommand is a :class:`Command`: a frozen dataclass whose fields are its arguments and options,
each with its help beside it. tyro makes the parser, the help pages and ``docs/command-line.md`` of
these fields.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_origin, get_type_hints

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from model.core.packages import at_place
from model.prediction import DEFAULT, TOKEN_VARIABLE

T = TypeVar("T")


class Options:
    """A group of options; its subclasses are frozen dataclasses."""


class Command(Options):
    """A subcommand; the first line of a subclass's docstring is its description.

    Attributes:
        place: "module:function" that does the work. It is imported when the command runs, as it may
            be heavy; it takes the command and a :class:`~model.core.progress.Progress`, and returns
            a :class:`~app.cli.output.Result`.
        log_level: least severe message that is shown.
    """

    place: ClassVar[str]
    log_level: ClassVar[int] = logging.ERROR

    def run(self) -> int:
        """Carry the command out, print its result and return the exit code."""
        from app.cli.output import run

        return run(at_place(self.place), self, getattr(self, "json", False))


@dataclass(frozen=True)
class Group:
    """Subcommands below one name.

    Attributes:
        help: one sentence.
        default: the subcommand that is meant where none is named, or "".
    """

    help: str
    commands: Mapping[str, type[Command] | Group]
    default: str = ""


def description(command: type[Command] | Group) -> str:
    """One sentence on a command or group."""
    return command.help if isinstance(command, Group) else str(command.__doc__).splitlines()[0]


def option(
    help: str,
    metavar: str | None = None,
    default: Any = None,
    *,
    flag: str | None = None,
    parse: Callable[[str], Any] | None = None,
    marker: Any = None,
    tokens: tuple[str, ...] = (),
) -> Any:
    """Declare a field as an option with a value; a tuple takes several words.

    Args:
        help: one line; the default is appended.
        metavar: stands for the value; None for the choices.
        flag: name of the option, unless it is that of the field.
        parse: converts a word to the value; raises ValueError, which shows its ``__name__``.
        marker: of :mod:`tyro.conf`.
        tokens: values that begin with a minus.
    """
    shown = tyro.conf.arg(
        name=flag, metavar=metavar, help=help + _default_text(help, default), help_behavior_hint=""
    )
    settings = {"shown": shown, "parse": parse, "marker": marker, "tokens": tokens}
    return field(default=default, metadata=settings)


def required(help: str, metavar: str, **settings: Any) -> Any:
    """Declare a field as an option that must be given; ``settings`` as of :func:`option`."""
    return option(help, metavar, MISSING, **settings)


def repeated(help: str, metavar: str, default: Any = (), **settings: Any) -> Any:
    """Declare a tuple as an option that may be repeated, one value each time."""
    text = f"{help}{_default_text(help, default)}; may be repeated"
    return option(text, metavar, default, marker=UseAppendAction, **settings)


def argument(help: str, metavar: str | None, default: Any = MISSING) -> Any:
    """Declare a field as a positional argument; a tuple takes several."""
    return option(help, metavar, default, marker=Positional)


def flag(help: str, default: bool | None = False, *, negatable: bool = False) -> Any:
    """Declare a ``bool`` as an option without a value; one that isn't off has a ``--no-`` form."""
    pair = negatable or default is not False
    return option(help, None, default, marker=None if pair else FlagCreatePairsOff)


def group(options: type[T]) -> T:
    """Declare a field that holds a dataclass of options, which get a box of their own in help."""
    return field(default_factory=options)


def _default_text(help: str, default: Any) -> str:
    unsaid = default is MISSING or default is None or isinstance(default, bool)
    if unsaid or default in ("", (), math.inf) or "(default:" in help:
        return ""
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    return f" (default: {shown:g})" if isinstance(shown, float) else f" (default: {shown})"


REGISTRY = ConstructorRegistry()
"""tyro's rules, with one for :class:`Options`."""


@REGISTRY.struct_rule
def _options_of(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Fields of a dataclass of options, as they were declared."""
    if not (isinstance(info.type, type) and issubclass(info.type, Options)):
        return None
    found = tuple(
        StructFieldSpec(
            each.name,
            _annotated(hint, **each.metadata) if each.metadata else hint,
            tyro.MISSING if each.default is MISSING else each.default,
        )
        for each, hint in declared(info.type)
    )
    return StructConstructorSpec(info.type, found)


def declared(options: type[Options]) -> Iterator[tuple[Field[Any], Any]]:
    """Each field and its type, inherited ones last; groups of options have no metadata."""
    hints = get_type_hints(options)
    named = {each.name: each for each in fields(options)}  # type: ignore[arg-type]
    order = [name for kind in options.__mro__ for name in vars(kind).get("__annotations__", ())]
    for name in dict.fromkeys(order):
        if name in named:
            yield named[name], hints[name]


def shown(options: type[Options]) -> dict[str, str]:
    """Each option as help shows it, such as "--out DIR" → help, groups' ones too."""
    found: dict[str, str] = {}
    for each, hint in declared(options):
        if not each.metadata:
            found |= shown(hint)
            continue
        conf, marker = each.metadata["shown"], each.metadata["marker"]
        value = conf.metavar or _reader(_kind(hint), None).metavar
        name = f"--{conf.name or each.name}".replace("_", "-")
        if marker is Positional:
            name = ""
        elif _kind(hint) is bool and marker is None:
            name = f"{name}, --no-{name[2:]}"
        needed = " (required)" if each.default is MISSING else ""
        found[f"{name} {value}".strip()] = conf.help + needed
    return found


def _annotated(hint: Any, shown: Any, parse: Any, marker: Any, tokens: tuple[str, ...]) -> Any:
    """A field's type with what tyro needs to know of it."""
    kind = _kind(hint)
    if marker is UseAppendAction:
        element = get_args(kind)[0]
        hint = tuple[Annotated[element, _reader(element, parse)], ...]  # type: ignore[misc]
    elif kind is not bool:
        hint = Annotated[hint | Literal[tokens] if tokens else hint, _reader(kind, parse)]
    return Annotated[marker[hint] if marker else hint, shown]


def _kind(hint: Any) -> Any:
    """``X`` of ``X | None``."""
    kinds = [kind for kind in get_args(hint) if kind is not NoneType]
    return kinds[0] if len(kinds) < len(get_args(hint)) else hint


def _reader(kind: Any, parse: Callable[[str], Any] | None) -> PrimitiveConstructorSpec[Any]:
    """The rule that reads one or several words as a value of type ``kind``."""
    several = get_origin(kind) is tuple and (parse is None or get_args(kind)[-1] is Ellipsis)
    element = get_args(kind)[0] if several else kind
    choices = get_args(element) if get_origin(element) is Literal else None
    read = parse or (str if choices else element)
    expected = {int: "whole number", float: "number"}.get(read, read.__name__)

    def from_words(words: list[str]) -> Any:
        if not words:
            raise ValueError("needs a value")
        try:
            values = tuple(read(word) for word in words)
        except ValueError as error:
            raise ValueError(f"{' '.join(words)} is no {expected}") from error
        return values if several else values[0]

    count = len(get_args(kind)) if several else 1
    return PrimitiveConstructorSpec(
        nargs="*" if several and get_args(kind)[-1] is Ellipsis else count,
        metavar="" if choices is None else f"{{{','.join(choices)}}}",
        instance_from_str=from_words,
        is_instance=lambda _: True,
        str_from_instance=lambda value: [str(value)],
        choices=choices,
    )


Vector = tuple[float, float, float]

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")

ENGINE_HELP = "engines that drive the joints: mujoco, or mujoco,sapien"
MASKS_HELP = "start from masks of another system: .npy, .npz, .ply, .glb, or a folder of meshes"
SEGMENTER_HELP = "segmenter that turns clicks into parts (default: ArtiWorld's own)"


def _number(kind: type[float], low: float, named: str, *, above: bool = False) -> Any:
    """Make a reader of finite numbers from ``low`` on, or above it."""

    def read(text: str) -> float:
        value = kind(text)
        if not (low < value if above else low <= value) or math.isinf(value):
            raise ValueError
        return value

    read.__name__ = named
    return read


positive_number = _number(float, 0, "positive number", above=True)
count = _number(int, 0, "whole number from 0")
positive_count = _number(int, 1, "number from 1")


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


@dataclass(frozen=True, kw_only=True)
class ReadingOptions(Options):
    """Options for reading geometry files."""

    up_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = option(
        f"up axis of the files, one of {', '.join(UP_AXES)} (default: by format)", "AXIS"
    )
    unit_scale: float = option(
        "metres per unit of the files, 0.001 for millimetres", "METRES", 1.0, parse=positive_number
    )


@dataclass(frozen=True, kw_only=True)
class OidcOptions(Options):
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
class PredictorOptions(Options):
    """The predictor, or an ArtiWorld backend that has one."""

    predictor: str = option("predictor of the joints", "NAME", DEFAULT)
    backend: str | None = option("ask an artiworld backend instead of predicting here", "URL")
    backend_token: str | None = option(f"token of the backend; or set {TOKEN_VARIABLE}", "TOKEN")


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions(Options):
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


@dataclass(frozen=True, kw_only=True)
class SegmenterOptions(Options):
    """The segmenter."""

    segmenter: str = option(SEGMENTER_HELP, "NAME", "default")
    point_sam: Path | None = option(
        "use Point-SAM, with the published weights at PATH, as --segmenter point-sam:PATH", "PATH"
    )

    def __post_init__(self) -> None:
        if self.point_sam is not None:
            object.__setattr__(self, "segmenter", f"point-sam:{self.point_sam}")


@dataclass(frozen=True, kw_only=True)
class ReportCommand(Command):
    """A command with a result that a program can read."""

    json: bool = flag("print JSON and nothing else")


def workspace_option() -> Any:
    """``--workspace DIR``."""
    return option("folder of sessions and accepted assets", "DIR", Path("workspace"))


def database_option() -> Any:
    """``--database URL``."""
    return option("URL of a SQLite or PostgreSQL database (default: one in the workspace)", "URL")


def seed_option(help: str = "the only source of randomness") -> Any:
    """``--seed SEED``."""
    return option(help, "SEED", 0, parse=count)
