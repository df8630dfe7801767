"""Every message of validation as a template, in one place to be read and translated together.

Fields are text already: display names of parts, lengths, joint values, ranges.
"""

from __future__ import annotations

from model.core.joint import Joint, value_text

# Findings
MOVES_FREELY = "Moves freely over its range."
LOW_CONFIDENCE = "Low confidence ({percent} %)."
PART_NAME = "The name “{name}” isn't in the project's labels."
CATEGORY_NAME = "The category “{name}” isn't in the project's labels."
NO_GEOMETRY = "The part has no face and no point."
SINGLE_POINT = "The part is a single point."
OF_PART = "{part}: {message}"
FLOATING = "Not attached to another part."
FLOATING_NEAR = "Not attached: {gap} gap to {nearest}."
EMPTY_RANGE = "The range is empty ({range})."
POSE_OUTSIDE = "The scanned pose is outside the range ({range})."
BOTH_WAYS = "Opens both ways from the scanned pose ({range}); a closed door opens one way."
MANY_TURNS = "Turns {turns} times ({range}); a continuous joint has no limits."
LONG_TRAVEL = "Travels {ratio} times the object's size ({range})."
BLOCKED_AT_REST = "Blocked at rest by {other}."
PENETRATION = "Penetrates {other} by {depth} at {at}; free from {free}."
SHRUNK_SHAPES = "Penetrates {other} by {depth}; its collision shapes are shrunk for it."
FREE_AFTER = "Free once {other} is out of the way."
COMBINATION = "{first} and {second} collide when both move, by up to {depth}."
COMES_OFF = "Comes off {support}: {gap} gap at {at}."
LIFTS_OFF = "Lifts off {support}: {gap} gap at {at}."
SLIDES_OUT = "Slides out of {support}: {gap} gap at {at}."
SLIDES_OFF = "Slides off {support}: {gap} gap at {at}."
MOVES_ACROSS = "Moves across {other}, which has the same shape."
MOVES_AGAINST = "Moves the other way than {other}, which has the same shape."
MOVES_OTHERWISE = "Moves otherwise than {other}, which has the same shape."
UNNAMED_PART = "another part"

# Simulation
NOT_INSTALLED = "{engine} is not installed: {command}"
NOT_LOADED = "{engine} can't load the model: {error}"
EXPLODED = "{engine}: {how}."
UNSTABLE = "becomes unstable (values that are no finite numbers)"
LEAVES_LIMITS = "leaves its limits{by} while {driven} driven{cause}"
BY = " by {value}"
DRIVEN_ITSELF = "it is"
DRIVEN_ONE = "{first} is"
DRIVEN_TWO = "{first} and {second} are"
DRIVEN_MANY = "{first} and {second} and others are"
CAUSE_MIMIC = ", taken there by the joint that it mimics"
CAUSE_SHAPES = ", pushed by the collision shapes of {other}"
DRIFTS = "{engine}: drifts by {percent} % of its range while other joints move."
STOPS_SHORT = "{engine}: stops {percent} % of its range short of its limit{cause}."
CAUSE_BLOCKED = ", at {at}, blocked by the collision shapes of {other}"

# Fixes
FIX_FLIP = "Flip the direction: the other way is free."
FIX_AXIS = "Shift the axis to the contact line."
FIX_AXIS_AND_FLIP = "Shift the axis to the contact line and flip the direction."
FIX_RANGE = "Set the range to {range}."
AXIS_SHIFTED = "Axis shifted slightly to where the checks accept it"
RANGE_CUT = "Cut to what the checks accept"
RANGE_REFUSED = "The checks object to this range"
FIX_LIKE = "Give it the joint of {other}, at its own place."
FIX_SIZE = "Resize it to {height} m; parts and joints stay."
FIX_SHRINK = "Shrink the blocking collision shapes; the visible geometry stays."

# Progress
SWEEPING = "Sweeping {part}"
COMBINING = "Moving joints together"
SIMULATING = "Running {engine}"
SEARCHING_FIXES = "Searching for fixes"


def sentence(template: str, **fields: str) -> str:
    """Fill a template and begin it with a capital letter."""
    text = template.format(**fields)
    return text[:1].upper() + text[1:]


def length(metres: float) -> str:
    """Millimetres, with one decimal below 10 mm."""
    return f"{1000 * metres:.1f} mm" if metres < 0.01 else f"{1000 * metres:.0f} mm"


def value(joint: Joint, q: float) -> str:
    """Degrees or millimetres."""
    return value_text(q, joint.rotates)


def interval(joint: Joint, lower: float, upper: float) -> str:
    """ "0° to 90°"."""
    return f"{value(joint, lower)} to {value(joint, upper)}"
