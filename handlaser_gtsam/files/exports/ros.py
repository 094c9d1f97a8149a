"""Beams as static transforms of ROS 2: a command line for each, or one message for all, as YAML."""

import shlex
from collections.abc import Sequence

from .beams import ROLL, ExportedBeam, number, origin_line
from .frames import quaternion
from .names import literal


def static_publisher_lines(beams: Sequence[ExportedBeam], link: str) -> str:
    """Return a shell script that publishes each beam as a frame, with the beam along its +x."""
    lines = ["#!/bin/sh", *_comments()]
    for beam in beams:
        x, y, z, *turn = map(number, _numbers(beam))
        qx, qy, qz, qw = turn
        lines += [
            f"# {beam.comment}",
            f"ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} "
            f"--qx {qx} --qy {qy} --qz {qz} --qw {qw} "
            f"--frame-id {shlex.quote(link)} --child-frame-id {beam.identifier} &",
        ]
    return "\n".join([*lines, "wait", ""])


def transforms_yaml(beams: Sequence[ExportedBeam], link: str) -> str:
    """Return the message `tf2_msgs/TFMessage` of all beams, each along +x of its frame."""
    lines = [*_comments(), "transforms:"]
    for beam in beams:
        x, y, z, qx, qy, qz, qw = map(number, _numbers(beam))
        lines += [
            f"  # {beam.comment}",
            "  - header:",
            f"      frame_id: {literal(link)}",
            f"    child_frame_id: {literal(beam.identifier)}",
            "    transform:",
            f"      translation: {{x: {x}, y: {y}, z: {z}}}",
            f"      rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}",
        ]
    return "\n".join([*lines, ""])


def _comments() -> list[str]:
    return [
        f"# {origin_line()}",
        "# x of each frame lies along its beam, from where the true range is zero. Units: m.",
        f"# {ROLL}",
    ]


def _numbers(beam: ExportedBeam) -> list[float]:
    """Return x, y, z [m] and the quaternion x, y, z, w."""
    frame = beam.frame("x")
    return [*frame.t.tolist(), *quaternion(frame.R)]
