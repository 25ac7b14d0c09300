# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""USD text (USDA) with physics, for Isaac Sim: rigid links and joints with drives as springs.

A joint (`PhysicsJoint` with locked translations) has a drive about each axis, of twist and of
bending, towards the shape at rest. Angles of USD are in degrees. A grip is a kinematic body, to
which a fixed joint (a spherical one where the direction is free) holds the cable. Air drag is
PhysX's linear damping, force over mass and velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.export.chain import CableChain, part_lines
from dlo_ros.export.format_support import CHAIN, body_fields
from dlo_ros.export.grips import Grip, Pose
from dlo_ros.spline import FloatArray

FIELDS = CHAIN | body_fields("air_drag twist_rest twisting_ratio")
"""Fields of the rod that the format can express."""
DEGREE = math.pi / 180.0
LOCKED = ("transX", "transY", "transZ")
DRIVEN = ("rotX", "rotY", "rotZ")


def approximations(chain: CableChain) -> tuple[str, ...]:
    """Parts of the cable that the format only approximates, one line each."""
    return ("springs are drives about three axes, right for small angles of a joint",)


def usd(chain: CableChain, *, step: float, comment: str) -> str:
    """The cable as a stage.

    Args:
        step: time step [s].
        comment: comment at the top of the file.
    """
    size = float(np.linalg.norm(chain.gravity))
    down = chain.gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    lines = [
        "#usda 1.0",
        *(f"# {line}" if line else "#" for line in comment.splitlines()),
        "(",
        '    defaultPrim = "Cable"',
        "    metersPerUnit = 1",
        "    kilogramsPerUnit = 1",
        '    upAxis = "Z"',
        ")",
        "",
        'def PhysicsScene "Scene" (',
        '    prepend apiSchemas = ["PhysxSceneAPI"]',
        ")",
        "{",
        f"    vector3f physics:gravityDirection = {_tuple(down)}",
        f"    float physics:gravityMagnitude = {size:.9g}",
        f"    uint physxScene:timeStepsPerSecond = {round(1.0 / step)}",
        "}",
        "",
        'def Xform "Cable"',
        "{",
    ]
    lines += [f"    {line}" for line in part_lines(chain, _link, _joint, _grip)]
    lines += [f"    {line}" for line in _apart()]
    return "\n".join([*lines, "}", ""])


def _tuple(values: Sequence[float] | FloatArray) -> str:
    return f"({', '.join(f'{float(v):.9g}' for v in values)})"


def _placed(pose: Pose) -> list[str]:
    return [
        f"    double3 xformOp:translate = {_tuple(pose.position)}",
        f"    quatd xformOp:orient = {_tuple(pose.quaternion)}",
        '    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]',
    ]


def _schemas(*names: str) -> str:
    quoted = ", ".join(f'"{name}"' for name in names)
    return f"    prepend apiSchemas = [{quoted}]"


def _link(chain: CableChain, k: int, pose: Pose) -> list[str]:
    mass, centre, inertia = chain.loaded(k)
    begin, stop = chain.extent(k)
    drag = chain.air_drag * (stop - begin) / mass
    return [
        f'def Xform "link_{k}" (',
        _schemas("PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysxRigidBodyAPI"),
        ")",
        "{",
        *_placed(pose),
        f"    float physics:mass = {mass:.9g}",
        f"    point3f physics:centerOfMass = {_tuple(centre)}",
        f"    float3 physics:diagonalInertia = {_tuple(np.diag(inertia))}",
        "    quatf physics:principalAxes = (1, 0, 0, 0)",
        f"    float physxRigidBody:linearDamping = {drag:.9g}",
        "    float physxRigidBody:angularDamping = 0",
        '    def Capsule "shape" (',
        "    " + _schemas("PhysicsCollisionAPI"),
        "    )",
        "    {",
        '        uniform token axis = "X"',
        f"        double height = {stop - begin:.9g}",
        f"        double radius = {0.5 * chain.diameter:.9g}",
        f"        double3 xformOp:translate = {_tuple([0.5 * (begin + stop), 0.0, 0.0])}",
        '        uniform token[] xformOpOrder = ["xformOp:translate"]',
        "    }",
        "}",
    ]


def _joint(chain: CableChain, k: int) -> list[str]:
    apis = [f"PhysicsLimitAPI:{axis}" for axis in LOCKED]
    apis += [f"PhysicsDriveAPI:{axis}" for axis in DRIVEN]
    lines = [
        f'def PhysicsJoint "joint_{k}" (',
        _schemas(*apis),
        ")",
        "{",
        *_bodies(f"link_{k - 1}", f"link_{k}"),
        *_frames(
            Pose(np.array([chain.cell, 0.0, 0.0]), chain.rest[k - 1]),
            Pose(np.zeros(3), Rotation.identity()),
        ),
    ]
    for axis in LOCKED:  # where the lower limit is above the upper one
        lines.append(f"    float limit:{axis}:physics:low = 1")
        lines.append(f"    float limit:{axis}:physics:high = -1")
    bend, twist = float(chain.bend[k - 1]), float(chain.twist[k - 1])
    for axis, stiffness in zip(DRIVEN, (twist, bend, bend), strict=True):
        name = f"drive:{axis}:physics"
        lines += [
            f'    uniform token {name}:type = "force"',
            f"    float {name}:stiffness = {DEGREE * stiffness:.9g}",
            f"    float {name}:damping = {DEGREE * chain.relaxation_time * stiffness:.9g}",
            f"    float {name}:targetPosition = 0",
        ]
    return [*lines, "}"]


def _bodies(first: str, second: str) -> list[str]:
    return [
        f"    rel physics:body0 = </Cable/{first}>",
        f"    rel physics:body1 = </Cable/{second}>",
    ]


def _frames(first: Pose, second: Pose) -> list[str]:
    lines = []
    for number, pose in enumerate((first, second)):
        lines.append(f"    point3f physics:localPos{number} = {_tuple(pose.position)}")
        lines.append(f"    quatf physics:localRot{number} = {_tuple(pose.quaternion)}")
    return lines


def _grip(chain: CableChain, grip: Grip) -> list[str]:
    link = 0 if grip.end == "start" else chain.joints
    at = np.array([chain.extent(link)[link > 0], 0.0, 0.0])
    kind = "PhysicsFixedJoint" if grip.kind == "clamp" else "PhysicsSphericalJoint"
    return [
        f'def Xform "{grip.end}" (',
        _schemas("PhysicsRigidBodyAPI"),
        ")",
        "{",
        *_placed(grip.commanded),
        "    bool physics:kinematicEnabled = 1",
        "}",
        f'def {kind} "hold_{grip.end}"',
        "{",
        *_bodies(grip.end, f"link_{link}"),
        *_frames(grip.offset, Pose(at, Rotation.identity())),
        "}",
    ]


def _apart() -> list[str]:
    """The cable's links do not touch each other."""
    return [
        'def PhysicsCollisionGroup "links" (',
        _schemas("CollectionAPI:colliders"),
        ")",
        "{",
        "    rel collection:colliders:includes = </Cable>",
        "    rel physics:filteredGroups = </Cable/links>",
        "}",
    ]
