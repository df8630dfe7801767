"""The compact vocabulary: structural strings, joint types, candidates and numbers as single tokens.

Parts are no words but are pointed at, so that an object can have any number of them.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from model.core.names import category_key, known_word, words
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS

TYPES = ("revolute", "continuous", "prismatic", "screw", "fixed")
REVOLUTE, CONTINUOUS, PRISMATIC, SCREW, FIXED = range(len(TYPES))
"""``screw`` stands for two joints along one axis, prismatic and continuous, with a helper link."""

_STRUCTURAL = (
    "<pad>",
    "<bos>",
    "<g_start>",
    "<g_end>",
    "<p_start>",
    "<p_end>",
    "<json_start>",
    "<close>",
    "<json_end>",
    "<urdf_start>",
    "<links>",
    "<free>",
    "<as_offered>",
    "<urdf_end>",
    "<child>",
    "<joint>",
    "<unknown>",
)
STEPS = 20
"""Numbers have 2 * STEPS + 1 levels."""

# Weights refer to words by index: never change the order, append new ones.
CATEGORIES = tuple(
    """bottle box bucket camera cart chair clock coffeemachine dishwasher dispenser display door
    eyeglasses fan faucet foldingchair globe kettle keyboard kitchenpot knife lamp laptop lighter
    microwave mouse oven pen phone pliers printer refrigerator remote safe scissors stapler
    storagefurniture suitcase switch table toaster toilet trashcan usb washingmachine
    window""".split()  # noqa: SIM905
)
NAME_WORDS = tuple(
    """arm backrest bail ball basket blade bolt bracket bulb button cap cartridge caster circle
    container cork cover crank crown dial display door drawer drum fan faucet flap footrest gate
    gear globe hand handle hatch head jaw key knob lamp latch leg lens lever lid lock monitor neck
    nozzle pad pedal plate plug plunger propeller pump rack ring rocker roller rotor sash screen
    seat shade shaft shelf shutter slider sphere spout stopper switch tabletop tap temple toggle
    tool tray trigger turntable wheel window""".split()  # noqa: SIM905
)


def _tokens() -> tuple[str, ...]:
    out = list(_STRUCTURAL)
    out += [f"<{t}>" for t in TYPES]
    out += [f"<{m}.{r}>" for m in MECHANISMS for r in range(RANKS)]
    out += [f"<{i:+d}>" for i in range(-STEPS, STEPS + 1)]
    out += [f"<category {c}>" for c in CATEGORIES]
    out += [f"<name {w}>" for w in NAME_WORDS]
    return tuple(out)


TOKENS = _tokens()
ID = {t: i for i, t in enumerate(TOKENS)}
SIZE = len(TOKENS)

TYPE_IDS = np.array([ID[f"<{t}>"] for t in TYPES])
SLOT_IDS = np.array([ID[f"<{m}.{r}>"] for m in MECHANISMS for r in range(RANKS)])
NUMBER_IDS = np.array([ID[f"<{i:+d}>"] for i in range(-STEPS, STEPS + 1)])
assert len(SLOT_IDS) == SLOTS


def category_id(category: str | None) -> int:
    """Id of the category's token, or of ``<unknown>``."""
    return ID.get(f"<category {category_key(category)}>", ID["<unknown>"])


def name_ids(name: str | None) -> tuple[int, ...]:
    """Ids of the known words of a part's name, at most two, last ones first."""
    out: list[int] = []
    for word in reversed(words(name)):
        hit = known_word(word, NAME_WORDS)
        if hit is not None:
            out.append(ID[f"<name {hit}>"])
    return tuple(out[:2])


Levels = npt.NDArray[np.int64]


def angle_levels(values: npt.ArrayLike) -> Levels:
    """Radians in ±pi → level indices."""
    return _clipped(np.asarray(values, float) / math.pi * STEPS)


def level_angle(level: int) -> float:
    """Level index → radians."""
    return (level - STEPS) * math.pi / STEPS


def travel_levels(values: npt.ArrayLike) -> Levels:
    """Diagonals in ±1 → level indices, finer near zero."""
    v = np.asarray(values, float)
    return _clipped(np.sign(v) * np.sqrt(np.abs(v)) * STEPS)


def level_travel(level: int) -> float:
    """Level index → diagonals."""
    share = (level - STEPS) / STEPS
    return math.copysign(share * share, share)


def coordinate_levels(values: npt.ArrayLike, reach: float) -> Levels:
    """Numbers in ±reach → level indices."""
    return _clipped(np.asarray(values, float) / reach * STEPS)


def level_coordinate(level: int, reach: float) -> float:
    """Level index → number in ±reach."""
    return (level - STEPS) / STEPS * reach


def _clipped(values: npt.NDArray[np.float64]) -> Levels:
    return np.clip(np.rint(np.nan_to_num(values)), -STEPS, STEPS).astype(np.int64) + STEPS
