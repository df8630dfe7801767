"""Short sentences that explain a predicted joint on screen."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class Reason(StrEnum):
    """Why a joint was placed where it is."""

    AJAR = "panel ajar"
    BACK = "at the back"
    BARRELS = "at visible barrels"
    BLADES = "axis of its equal blades"
    BOTH_ENDS = "held at both ends"
    BOTTOM_EDGE = "at the bottom edge"
    CENTER = "through its centre, barely round"
    CHAIN_PLANE = "normal to the plane of its chain"
    CONTACT = "at the contact"
    CROSSED_FRAMES = "where the frames cross"
    CROSSED_PARTS = "where the parts cross"
    HANDLE = "opposite the handle"
    INTO_SURFACE = "into its surface"
    MIDDLE = "about its middle"
    MOUNT = "about its mount"
    NO_PROPOSAL = "no other proposal fits"
    ONE_END = "held at one end"
    ONLY_CONTACT = "at the only edge in contact"
    OPEN_SIDE = "towards the open side"
    OUTER_EDGE = "at the outer edge of two panels"
    OWN_PLANE = "within its own plane"
    POLES = "between its two supports"
    RAISED_BACK = "at the raised back"
    STEM = "about its stem"
    SUPPORT = "vertical through its support"
    SYMMETRY = "about its symmetry axis"
    UPRIGHT = "vertical"


COLLISION_FREE = "Range: collision-free"
FREE_AXIS = "Axis: from the network alone"
LOCKED = "Locked joint"


def as_on(objects: int) -> str:
    """Remark that joints of accepted objects were compared."""
    return f"Compared with {objects} accepted object{'s' * (objects != 1)}"


def explain(title: str, reasons: Iterable[str] = (), *more: str) -> str:
    """As in "Hinge: opposite the handle, at visible barrels. Range: collision-free".

    Args:
        title: of the motion. reasons: for its place. more: further sentences, "" for none.
    """
    because = ", ".join(reasons)
    first = f"{title}: {because}" if because else title
    return ". ".join(filter(None, (first, *more)))
