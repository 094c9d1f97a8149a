"""Languages of robot programs. Nothing is imported here."""

PROGRAMS = {"krl": "kuka", "rapid": "abb", "tp": "fanuc", "urscript": "ur"}
"""Languages of robot programs that drive to stations, with the convention in which each has poses."""
IN_JOINTS = ("krl", "rapid", "urscript")
"""Languages that move in the joints where these are known. FANUC counts J3 from the horizon, which no
URDF does, so that its programs always have lines."""
COLON = {"krl": ":", "rapid": ":", "urscript": ":", "tp": " "}
"""What stands for the colon of a label, `sphere:ball`, in a comment. Comments end with their line, and
remarks of FANUC have letters, digits and few signs."""
