"""The elements and attributes of URDF that are read."""

from model.io.xml_schema import XmlSchema

URDF = XmlSchema.of(
    (
        ("robot", "link joint material", "name version"),
        ("link", "inertial visual collision", "name type"),
        ("joint", "origin parent child axis limit mimic dynamics", "name type"),
        ("inertial", "origin mass inertia", ""),
        ("visual", "origin geometry material", "name"),
        ("collision", "origin geometry material", "name"),
        ("geometry", None, ""),  # the reader says which shapes it knows
        ("material", "color texture", "name"),
        ("origin", "", "xyz rpy quat_xyzw"),
        ("mass", "", "value"),
        ("inertia", "", "ixx ixy ixz iyy iyz izz"),
        ("mesh", "", "filename scale"),
        ("box", "", "size"),
        ("cylinder", "", "radius length"),
        ("sphere", "", "radius"),
        ("capsule", "", "radius length"),
        ("color", "", "rgba"),
        ("texture", "", "filename"),
        ("parent", "", "link"),
        ("child", "", "link"),
        ("axis", "", "xyz"),
        ("limit", "", "lower upper effort velocity acceleration deceleration jerk"),
        ("mimic", "", "joint multiplier offset"),
        ("dynamics", "", "damping friction"),
    ),
    "gazebo transmission sensor ros2_control mujoco drake safety_controller calibration verbose "
    "contact_coefficients",
    repeated="link joint material visual collision",
    choices="geometry",
)
