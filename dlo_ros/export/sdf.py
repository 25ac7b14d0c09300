# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""SDF, the format of Gazebo: links with universal joints, whose axes have springs and dampers.

A ball joint of SDF has no spring. A universal joint bends about two axes and does not twist. A
joint's angle is 0 in the poses that are written, those when the motion begins; the springs'
references lead to the shape at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dlo_ros.export.chain import CableChain, part_lines
from dlo_ros.export.format_support import CHAIN
from dlo_ros.export.grips import Grip, Pose
from dlo_ros.spline import FloatArray

FIELDS = CHAIN
"""Fields of the rod that the format can express."""
VERSION = "1.9"
FURTHEST = 2.0  # [rad] that a joint may turn to either side


def approximations(chain: CableChain) -> tuple[str, ...]:
    """Parts of the cable that the format only approximates, one line each."""
    lines = ["twist: a universal joint does not twist at all"]
    if chain.grips:
        lines.append("grips stand still: they are joints with the world")
    return tuple(lines)


def sdf(chain: CableChain, *, step: float, comment: str) -> str:
    """The cable as the one model of a world.

    Args:
        step: time step [s].
        comment: comment at the top of the file.
    """
    lines = [
        '<?xml version="1.0"?>',
        "<!--",
        *(f"  {line.replace('--', '- -')}".rstrip() for line in comment.splitlines()),
        "-->",
        f'<sdf version="{VERSION}">',
        '  <world name="cable">',
        f"    <gravity>{_text(chain.gravity)}</gravity>",
        f'    <physics name="step" type="dart"><max_step_size>{step:g}</max_step_size></physics>',
        '    <model name="cable">',
        "      <self_collide>false</self_collide>",
    ]
    lines += [f"      {line}" for line in part_lines(chain, _link, _joint, _grip)]
    return "\n".join([*lines, "    </model>", "  </world>", "</sdf>", ""])


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)


def _pose(pose: Pose) -> str:
    """A position and roll, pitch, yaw about the fixed axes."""
    matrix = pose.rotation.as_matrix()
    pitch = math.asin(min(max(-matrix[2, 0], -1.0), 1.0))
    if abs(matrix[2, 0]) < 1.0 - 1e-9:
        roll = math.atan2(matrix[2, 1], matrix[2, 2])
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
    else:  # straight up or down, where roll and yaw are one
        roll, yaw = 0.0, math.atan2(-matrix[0, 1], matrix[1, 1])
    return f"<pose>{_text([*pose.position, roll, pitch, yaw])}</pose>"


def _link(chain: CableChain, k: int, pose: Pose) -> list[str]:
    mass, centre, inertia = chain.loaded(k)
    begin, stop = chain.extent(k)
    place = f"<pose>{0.5 * (begin + stop):.9g} 0 0 0 {0.5 * math.pi:.9g} 0</pose>"
    shape = (
        f"<geometry><cylinder><radius>{0.5 * chain.diameter:.9g}</radius>"
        f"<length>{stop - begin:.9g}</length></cylinder></geometry>"
    )
    return [
        f'<link name="link_{k}">',
        f"  {_pose(pose)}",
        f"  <inertial><pose>{_text([*centre, 0.0, 0.0, 0.0])}</pose><mass>{mass:.9g}</mass>",
        f"    <inertia><ixx>{inertia[0, 0]:.9g}</ixx><iyy>{inertia[1, 1]:.9g}</iyy>"
        f"<izz>{inertia[2, 2]:.9g}</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>",
        f'  <visual name="shape">{place}{shape}</visual>',
        f'  <collision name="touch">{place}{shape}</collision>',
        "</link>",
    ]


def _joint(chain: CableChain, k: int) -> list[str]:
    stiffness = float(chain.bend[k - 1])
    turn = chain.turns[k - 1].as_rotvec()
    lines = [
        f'<joint name="joint_{k}" type="universal">',
        f"  <parent>link_{k - 1}</parent><child>link_{k}</child>",
    ]
    for tag, axis, angle in (("axis", "0 1 0", turn[1]), ("axis2", "0 0 1", turn[2])):
        lines += [
            f"  <{tag}><xyz>{axis}</xyz>",
            f"    <limit><lower>{-FURTHEST:g}</lower><upper>{FURTHEST:g}</upper></limit>",
            f"    <dynamics><damping>{chain.relaxation_time * stiffness:.9g}</damping>"
            f"<spring_reference>{-angle:.9g}</spring_reference>"
            f"<spring_stiffness>{stiffness:.9g}</spring_stiffness></dynamics></{tag}>",
        ]
    return [*lines, "</joint>"]


def _grip(chain: CableChain, grip: Grip) -> list[str]:
    link = 0 if grip.end == "start" else chain.joints
    kind = "fixed" if grip.kind == "clamp" else "ball"
    at = chain.extent(link)[link > 0]
    return [
        f'<joint name="{grip.end}" type="{kind}">',
        f"  <pose>{_text([at, *np.zeros(5)])}</pose>",
        f"  <parent>world</parent><child>link_{link}</child>",
        "</joint>",
    ]
