"""The elements of MJCF that are read or answered for.

Attributes and whatever else stands in elements that are handed on are MuJoCo's to judge: it refuses
what it doesn't know.
"""

from model.io.xml_schema import XmlSchema

ROOTS = ("mujoco", "mujocoinclude")
KEPT = ("compiler", "default", "asset", "worldbody")
"""Sections that MuJoCo gets."""
WORLD = ("body", "joint", "freejoint", "geom", "inertial", "frame", "replicate")
DEFAULTS = ("default", "joint", "geom", "mesh", "material")
ASSETS = ("mesh", "texture", "material", "hfield")
LOST = {
    "actuator": "actuators", "tendon": "tendons", "composite": "composite bodies",
    "flexcomp": "soft bodies", "deformable": "soft bodies",
}  # fmt: skip
"""Elements that have a remark of their own."""
_WORLD = " ".join((*WORLD, *LOST))

MJCF = XmlSchema.of(
    (
        ("mujoco", " ".join((*KEPT, *LOST, "equality")), "model"),
        ("worldbody", _WORLD, ""),
        ("body", _WORLD, None),
        ("frame", _WORLD, "name childclass pos quat axisangle xyaxes zaxis euler"),
        ("replicate", _WORLD, "count sep offset euler"),
        ("default", " ".join(DEFAULTS), "class"),
        ("asset", " ".join(ASSETS), ""),
        ("compiler", "", None),
        ("joint", "", None),
        ("geom", "", None),
        ("inertial", "", None),
        ("mesh", "", None),
        ("texture", "", None),
        ("hfield", "", None),
        ("material", "layer", None),
    ),
    # Simulation, drawing, and defaults of what isn't read.
    "option size visual statistic custom sensor keyframe contact extension light camera site pair "
    "equality tendon general motor position velocity intvelocity damper cylinder muscle adhesion "
    "lengthrange",
)
