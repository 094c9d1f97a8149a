"""The formats of exports, and which options mean something in which.

Each has a template, but for `poses`, a CSV. Nothing heavy is imported here.
"""

PROGRAMS = {"krl": "kuka", "rapid": "abb", "tp": "fanuc", "urscript": "ur"}
"""Languages of robot programs that drive to stations, with the convention in which each has poses."""
IN_JOINTS = ("krl", "rapid", "urscript")
"""Languages that move in the joints where these are known. FANUC counts J3 from the horizon, which no
URDF does, so that its programs always have lines."""
COLON = {"krl": ":", "rapid": ":", "urscript": ":", "tp": " "}
"""What stands for the colon of a label, `sphere:ball`, in a comment. Comments end with their line, and
remarks of FANUC have letters, digits and few signs."""


LINKED = ("urdf", "xacro", "ros2-static", "ros2-yaml")
"""Formats that hang frames on a link."""
TOOLS = ("kuka", "abb", "fanuc", "ur")
BEAMS = (*LINKED, *TOOLS, "c", "python", "st")
"""Formats of the beams of a calibration."""
STATIONS = (*PROGRAMS, "poses")
FORMATS = (*BEAMS, *STATIONS)
TAKEN = {
    "beams": BEAMS,
    "link": LINKED,
    "axis": TOOLS,
    "at_reading": TOOLS,
    "tool": ("fanuc",),
    "into": ("urdf",),
    "signal": tuple(PROGRAMS),
    "pause": tuple(PROGRAMS),
    "pose_format": ("poses",),
}
"""Formats in which an option means something."""
NEEDED = {
    "pose_format": "the convention of the poses, such as kuka (--pose-format kuka; docs/logs.md)",
    "link": "the link whose frame is the hand, such as tool0 (--link tool0)",
    "tool": "the number of the first UTOOL that may be replaced",
}
"""Options without which the formats that take them mean nothing, and what they are."""
LAST_TOOL = 99
"""Largest number of a tool; how many a controller really has depends on its configuration."""
