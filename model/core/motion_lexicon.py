"""Motion lexicon: readable tables from part names and categories to motions.

A *mechanism* is a way to move; :mod:`model.prediction.geometric.mechanisms` builds the joint for
each:

==============  =====================================================================
hinge           panel that turns about one of its edges, usually upright (doors)
flap            panel that turns about a level edge (lids, screens, seats)
drop            door hinged at its bottom edge (ovens, dishwashers)
temple          arm that folds about its own end (legs of glasses, stapler arms)
pivot           flat part that turns about its thin direction where it overlaps (scissors)
swing           bail handle that turns about the line through its two ends
lever           handle that turns about the stem that it stands on
toggle          rocker that tilts about its middle
tilt            head that nods about a level axis where it is held
spin            round part that turns freely about its symmetry axis
swivel          part that turns freely about an upright axis through its support
screw           cap or seat that turns and rises along one axis (two joints)
slide_out       drawer that comes out of the body
slide_along     panel or blade that slides within its own plane
lift            lid or plunger that moves upright
press           button that goes in a little
fixed           doesn't move on its own
==============  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from model.core.joint import JointType

# Weights know mechanisms by their place: add new ones before "fixed".
Mechanism = Literal[
    "hinge",
    "flap",
    "drop",
    "temple",
    "pivot",
    "swing",
    "lever",
    "toggle",
    "tilt",
    "spin",
    "swivel",
    "screw",
    "slide_out",
    "slide_along",
    "lift",
    "press",
    "fixed",
]
MECHANISMS: tuple[Mechanism, ...] = get_args(Mechanism)


@dataclass(frozen=True)
class MechanismRow:
    """Properties of a mechanism.

    Attributes:
        title: on screen.
        group: mechanisms that fail in the same way, such as the side of a door; a key of
            ``confidence.json``, "" for none.
        types: joint types that it can become when a person changes the type.
        noun: of its revolute joint in the names that files give joints.
    """

    title: str
    group: str
    types: tuple[JointType, ...] = ("revolute",)
    noun: str = "hinge"


_ROUND: tuple[JointType, ...] = ("revolute", "continuous")
MECHANISM_TABLE: dict[Mechanism, MechanismRow] = {
    "hinge": MechanismRow("Hinge", "panel"),
    "flap": MechanismRow("Lid hinge", "panel"),
    "drop": MechanismRow("Bottom hinge", "panel"),
    "temple": MechanismRow("Folding arm", "arm"),
    "pivot": MechanismRow("Pin joint", "arm"),
    "swing": MechanismRow("Bail", "arm"),
    "lever": MechanismRow("Lever", "arm", noun="turn"),
    "toggle": MechanismRow("Rocker", "rocker", noun="turn"),
    "tilt": MechanismRow("Tilt", "arm"),
    "spin": MechanismRow("Rotation", "round", _ROUND, "turn"),
    "swivel": MechanismRow("Swivel", "round", _ROUND, "turn"),
    "screw": MechanismRow("Screw", "screw", _ROUND, "turn"),
    "slide_out": MechanismRow("Drawer", "drawer", ("prismatic",)),
    "slide_along": MechanismRow("Slider", "slider", ("prismatic",)),
    "lift": MechanismRow("Lift", "slider", ("prismatic",)),
    "press": MechanismRow("Push button", "button", ("prismatic",)),
    "fixed": MechanismRow("Fixed", "", ()),
}

WORDS: dict[str, Mechanism] = {
    "door": "hinge",
    "gate": "hinge",
    "window": "hinge",
    "sash": "hinge",
    "shutter": "hinge",
    "hatch": "flap",
    "lid": "flap",
    "cover": "flap",
    "flap": "flap",
    "screen": "flap",
    "monitor": "tilt",
    "display": "flap",
    "seat": "flap",
    "pedal": "flap",
    "backrest": "flap",
    "footrest": "flap",
    "drawer": "slide_out",
    "shelf": "slide_out",
    "rack": "slide_out",
    "tray": "slide_out",
    "basket": "slide_out",
    "container": "slide_out",
    "cartridge": "slide_out",
    "turntable": "swivel",
    "plate": "swivel",
    "knob": "spin",
    "dial": "spin",
    "wheel": "spin",
    "roller": "spin",
    "rotor": "spin",
    "fan": "spin",
    "propeller": "spin",
    "lens": "spin",
    "gear": "spin",
    "drum": "spin",
    "hand": "spin",
    "sphere": "spin",
    "globe": "spin",
    "ball": "spin",
    "crown": "spin",
    "caster": "swivel",
    "spout": "swivel",
    "tabletop": "swivel",
    "tap": "lever",
    "faucet": "lever",
    "lever": "lever",
    "crank": "lever",
    "switch": "lever",
    "handle": "swing",
    "bail": "swing",
    "toggle": "toggle",
    "rocker": "toggle",
    "button": "press",
    "key": "press",
    "pad": "press",
    "pump": "press",
    "nozzle": "press",
    "trigger": "press",
    "plunger": "lift",
    "cap": "screw",
    "cork": "lift",
    "stopper": "lift",
    "plug": "lift",
    "slider": "slide_along",
    "bolt": "slide_along",
    "latch": "slide_along",
    "lock": "slide_along",
    "blade": "pivot",
    "tool": "pivot",
    "jaw": "pivot",
    "leg": "temple",
    "temple": "temple",
    "arm": "temple",
    "head": "tilt",
    "bulb": "tilt",
    "shade": "tilt",
    "lamp": "tilt",
    "bracket": "swivel",
    "ring": "swivel",
    "circle": "swivel",
    "neck": "swivel",
    "shaft": "temple",
}
"""Word → mechanism where the category says nothing else."""

CATEGORY_WORDS: dict[str, dict[str, Mechanism]] = {
    "bottle": {"lid": "screw", "cap": "screw", "cover": "screw"},
    "box": {"lid": "flap", "lock": "flap"},
    "bucket": {"handle": "swing", "lid": "lift"},
    "chair": {"seat": "screw", "leg": "fixed", "knob": "spin", "lever": "temple"},
    "clock": {"door": "hinge"},
    "coffeemachine": {"lid": "flap", "lever": "lever", "container": "slide_out"},
    "dishwasher": {"door": "drop"},
    "dispenser": {"lid": "screw", "cap": "screw", "head": "press", "nozzle": "press"},
    "display": {"screen": "tilt", "base": "fixed"},
    "door": {"handle": "lever"},
    "eyeglasses": {"leg": "temple"},
    "fan": {"blade": "spin", "head": "tilt", "frame": "tilt"},
    "faucet": {"switch": "lever", "handle": "lever", "spout": "swivel", "knob": "lever"},
    "foldingchair": {"seat": "flap", "leg": "pivot"},
    "globe": {"bracket": "swivel", "frame": "swivel"},
    "kettle": {"lid": "lift", "handle": "swing"},
    "keyboard": {"leg": "flap"},
    "kitchenpot": {"lid": "lift", "cover": "lift"},
    "knife": {"blade": "pivot", "tool": "pivot"},
    "lamp": {"switch": "toggle"},
    "laptop": {"shaft": "flap"},
    "lighter": {"lid": "flap", "cover": "flap"},
    "microwave": {"tray": "swivel", "plate": "swivel"},
    "mouse": {"wheel": "spin"},
    "oven": {"door": "drop", "tray": "slide_out"},
    "pen": {"lid": "slide_along", "cap": "slide_along", "button": "press"},
    "phone": {"cover": "flap", "screen": "slide_along"},
    "pliers": {"leg": "pivot", "handle": "pivot"},
    "safe": {"switch": "spin", "handle": "spin", "lever": "lever"},
    "scissors": {"leg": "pivot", "blade": "pivot", "handle": "pivot"},
    "stapler": {"body": "temple", "lid": "temple", "top": "temple"},
    "suitcase": {"handle": "lift", "lid": "flap"},
    "switch": {"switch": "toggle", "lever": "toggle", "slider": "slide_along"},
    "table": {"leg": "fixed"},
    "toaster": {"slider": "lift", "lever": "lift", "handle": "lift", "button": "press"},
    "toilet": {"lever": "lever", "handle": "lever", "switch": "lever", "seat": "flap"},
    "trashcan": {"lid": "flap", "pad": "flap", "drawer": "slide_out"},
    "usb": {"lid": "slide_along", "cap": "slide_along", "cover": "pivot", "body": "pivot"},
    "window": {"window": "hinge"},
}
"""Category → words that mean something else there."""

CATEGORY_MOTIONS: dict[str, tuple[Mechanism, ...]] = {
    "bottle": ("screw", "lift"),
    "box": ("flap",),
    "bucket": ("swing",),
    "camera": ("press", "spin"),
    "cart": ("spin", "swivel"),
    "chair": ("spin", "swivel", "screw"),
    "clock": ("spin",),
    "coffeemachine": ("press", "spin", "flap"),
    "dishwasher": ("drop", "slide_out", "press"),
    "dispenser": ("screw", "press"),
    "display": ("tilt", "press"),
    "door": ("hinge", "lever"),
    "eyeglasses": ("temple",),
    "fan": ("spin", "tilt"),
    "faucet": ("lever", "swivel"),
    "foldingchair": ("flap", "pivot"),
    "globe": ("spin", "tilt"),
    "kettle": ("lift", "swing"),
    "keyboard": ("press",),
    "kitchenpot": ("lift",),
    "knife": ("pivot", "slide_along"),
    "lamp": ("temple", "tilt"),
    "laptop": ("flap",),
    "lighter": ("flap", "spin", "press"),
    "microwave": ("hinge", "spin", "press", "swivel"),
    "mouse": ("press", "spin"),
    "oven": ("drop", "spin", "press"),
    "pen": ("slide_along", "press"),
    "phone": ("flap", "slide_along", "press"),
    "pliers": ("pivot",),
    "printer": ("press", "slide_out", "flap"),
    "refrigerator": ("hinge", "slide_out"),
    "remote": ("press",),
    "safe": ("hinge", "spin"),
    "scissors": ("pivot",),
    "stapler": ("temple",),
    "storagefurniture": ("hinge", "slide_out"),
    "suitcase": ("lift", "spin", "swing"),
    "switch": ("toggle", "press"),
    "table": ("slide_out", "hinge", "spin"),
    "toaster": ("lift", "spin", "press"),
    "toilet": ("flap", "press", "lever"),
    "trashcan": ("flap", "spin"),
    "usb": ("pivot", "slide_along"),
    "washingmachine": ("hinge", "spin", "press"),
    "window": ("hinge", "slide_along"),
}
"""Category → what its parts usually do, for parts without a name."""

TURNING: dict[Mechanism, Mechanism] = {
    "slide_out": "swivel",
    "slide_along": "hinge",
    "lift": "flap",
    "press": "toggle",
}
"""Mechanism that slides → its mechanism with the prefix ``rotation_``."""

SLIDING: dict[Mechanism, Mechanism] = {
    "hinge": "slide_along",
    "drop": "slide_along",
    "flap": "lift",
    "screw": "lift",
    "swing": "lift",
    "pivot": "slide_along",
    "temple": "slide_along",
    "tilt": "lift",
    "spin": "press",
    "swivel": "lift",
    "lever": "slide_along",
    "toggle": "slide_along",
}
"""Mechanism that turns → its mechanism with the prefix ``translation_``."""

BASE_WORDS: dict[str, float] = {
    "base": 3.0,
    "stand": 2.6,
    "frame": 2.6,
    "body": 2.5,
    "chassis": 2.5,
    "housing": 2.5,
    "carcass": 2.5,
    "cabinet": 2.5,
    "case": 2.0,
    "main": 2.0,
    "furniture": 2.0,
    "pot": 1.5,
    "leg": 0.5,
}
"""Words for the part that everything hangs on, and how sure they are."""

TURN_PREFIX = {"rotation", "rotating", "rotary", "revolving", "hinged", "swivel", "flip"}
SLIDE_PREFIX = {"translation", "translating", "sliding", "slide", "telescopic", "retractable"}
PRESS_PREFIX = {"press", "pressing", "push"}
SYNONYMS = {
    "castor": "caster",
    "tyre": "wheel",
    "tire": "wheel",
    "flaps": "flap",
    "panel": "door",
    "touchpad": "pad",
    "footpad": "pedal",
    "keycap": "key",
    "pushbutton": "button",
    "turnknob": "knob",
    "headrest": "backrest",
    "back": "backrest",
    "hood": "lid",
    "tub": "container",
    "dropleaf": "flap",
    "visor": "flap",
    "stopcock": "tap",
    "meridian": "bracket",
    "magazine": "body",
    "scanner": "lid",
    "crate": "drawer",
    "box": "drawer",
}

OTHER_CATEGORIES = (
    "camera",
    "cart",
    "laptop",
    "printer",
    "refrigerator",
    "remote",
    "storagefurniture",
    "washingmachine",
)

CATEGORY_ALIASES = {
    "fridge": "refrigerator",
    "cabinet": "storagefurniture",
    "cupboard": "storagefurniture",
    "wardrobe": "storagefurniture",
    "dresser": "storagefurniture",
    "monitor": "display",
    "tv": "display",
    "plier": "pliers",
    "pot": "kitchenpot",
    "glasses": "eyeglasses",
    "notebook": "laptop",
    "stove": "oven",
    "dustbin": "trashcan",
    "bin": "trashcan",
    "desk": "table",
    "tap": "faucet",
    "officechair": "chair",
    "trolley": "cart",
    "jar": "bottle",
}
