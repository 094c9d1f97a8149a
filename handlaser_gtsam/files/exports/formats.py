"""The formats of exports, and which option means something in which; nothing heavy is imported here."""

LINKED = ("urdf", "xacro", "ros2-static", "ros2-yaml")
"""Formats that hang frames on a link."""
TOOLS = ("kuka", "abb", "fanuc", "ur")
BINARY = ("matlab", "numpy")
FORMATS = (*LINKED, *TOOLS, *BINARY, "c", "python", "st")
TAKEN = {
    "link": LINKED,
    "axis": TOOLS,
    "along": TOOLS,
    "tool": ("fanuc",),
    "into": ("urdf",),
}
"""Formats in which an option means something."""
NEEDED = {
    "link": "the link whose frame is the hand, such as tool0",
    "tool": "the number of the first UTOOL that may be replaced",
}
"""Options without which the formats that take them mean nothing, and what they are."""
