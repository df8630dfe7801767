"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from app.cli.command import Option, flag, option
from model.prediction import DEFAULT, TOKEN_VARIABLE

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
        "use Point-SAM, with the published weights at PATH", "PATH", "--point-sam",
        "point-sam:{}".format,
    )  # fmt: skip
    return option(SEGMENTER_HELP, "NAME", "default", synonym=point_sam)
