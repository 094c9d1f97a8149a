"""Arms for tests: a small one made here, and those whose URDF comes with example-robot-data."""

import importlib.util
from pathlib import Path

import numpy as np

HAS_PINOCCHIO = importlib.util.find_spec("pinocchio") is not None
HANGING = np.diag([1.0, -1.0, -1.0])
"""The base of an arm under the ceiling: its hand looks up where that of a standing arm looks down."""

LINK = """
  <link name="{name}"><collision><origin xyz="{x} 0 {middle}"/>
    <geometry><cylinder radius="{radius}" length="{length}"/></geometry></collision></link>"""
JOINT = """
  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0 0 {up}"/><axis xyz="{axis}"/>
    <limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>"""
JOINTS = (  # name, kind, axis, how far up its parent, limit, length of its link
    ("rail", "prismatic", "1 0 0", 0.1, 0.3, 0.05),
    ("pan", "revolute", "0 0 1", 0.07, 3.0, 0.1),
    ("lift", "revolute", "0 1 0", 0.12, 2.0, 0.36),
    ("elbow", "revolute", "0 1 0", 0.4, 2.6, 0.16),
    ("roll", "revolute", "0 0 1", 0.2, 3.0, 0.16),
    ("tilt", "revolute", "0 1 0", 0.2, 2.2, 0.05),
    ("flange", "continuous", "0 0 1", 0.08, 0.0, 0.03),
)


def small_arm(folder: Path) -> str:
    """Write an arm on a rail with an endless last joint and a finger beside the hand."""
    text = '<robot name="small">' + LINK.format(
        name="base", x=0, middle=0.0, radius=0.05, length=0.1
    )
    parent = "base"
    for name, kind, axis, up, limit, length in JOINTS:
        child = f"{name}_link"
        text += JOINT.format(
            name=name,
            kind=kind,
            parent=parent,
            child=child,
            up=up,
            axis=axis,
            low=-limit,
            high=limit,
        )
        text += LINK.format(name=child, x=0, middle=length / 2, radius=0.03, length=length)
        parent = child
    text += JOINT.format(
        name="finger", kind="prismatic", parent=parent, child="finger_link", up=0.02,
        axis="1 0 0", low=0.0, high=0.02,
    )  # fmt: skip
    text += LINK.format(name="finger_link", x=0.02, middle=0.01, radius=0.004, length=0.02)
    text += '<link name="hand"/><joint name="fixed" type="fixed"><parent link="flange_link"/>'
    text += '<child link="hand"/><origin xyz="0 0 0.05"/></joint></robot>'
    path = folder / "small.urdf"
    path.write_text(text)
    return str(path)


def example_arm(name: str) -> str | None:
    """Return the path of a URDF of example-robot-data; None where it is not installed."""
    if not HAS_PINOCCHIO:
        return None
    import pinocchio

    for folder in Path(pinocchio.__file__).parents:
        path = folder / "share" / "example-robot-data" / "robots" / name
        if path.is_file():
            return str(path)
    return None
