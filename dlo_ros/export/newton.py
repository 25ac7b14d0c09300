# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A Python script that builds the cable in Newton (newton-physics), for its MuJoCo solver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.export.chain import CableChain
from dlo_ros.export.grips import Pose
from dlo_ros.export.mjcf import FIELDS, fluid
from dlo_ros.spline import FloatArray

__all__ = ["FIELDS", "approximations", "newton"]

BODY = '''
import argparse

import newton
import warp as wp


def pose(numbers):
    """A transform of x y z, qx qy qz qw."""
    return wp.transform(wp.vec3(*numbers[:3]), wp.quat(*numbers[3:]))


def build(builder=None):
    """Add the cable to a builder (a new one by default); returns it and the links."""
    builder = builder or newton.ModelBuilder(gravity=GRAVITY)
    shape = newton.ModelBuilder.ShapeConfig(density=0.0)
    links, joints = [], []
    for k, (place, mass, centre, inertia, begin, stop) in enumerate(LINKS):
        link = builder.add_link(
            xform=pose(place), mass=mass, com=wp.vec3(*centre), inertia=wp.mat33(*inertia),
            label=f"link_{k}", lock_inertia=True,
        )
        across = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * wp.pi)
        middle = wp.transform(wp.vec3(0.5 * (begin + stop), 0.0, 0.0), across)
        builder.add_shape_capsule(
            link, xform=middle, radius=RADIUS, half_height=0.5 * (stop - begin), cfg=shape
        )
        links.append(link)
        if k == 0:
            if START:
                hold = builder.add_joint_fixed if START == "clamp" else builder.add_joint_ball
                root = hold(
                    parent=-1, child=link, parent_xform=pose(START_GRIP),
                    child_xform=pose(START_TIP),
                )
            if START == "tip":
                at = builder.joint_q_start[root]
                builder.joint_q[at : at + 4] = ROOT_TURN
            elif not START:
                root = builder.add_joint_free(parent=-1, child=link)
                at = builder.joint_q_start[root]
                builder.joint_q[at : at + 7] = place
            joints.append(root)
            continue
        stiffness, rest, turn = JOINTS[k - 1]
        joint = builder.add_joint_ball(
            parent=links[k - 1], child=link, parent_xform=pose((CELL, 0.0, 0.0, *rest)),
            stiffness=stiffness, damping=RELAXATION_TIME * stiffness, label=f"joint_{k}",
        )
        at = builder.joint_q_start[joint]
        builder.joint_q[at : at + 4] = turn
        joints.append(joint)
    builder.add_articulation(joints, label="cable")
    if END:
        hold = builder.add_joint_fixed if END == "clamp" else builder.add_joint_ball
        hold(parent=-1, child=links[-1], parent_xform=pose(END_GRIP), child_xform=pose(END_TIP))
    return builder, links


def solver(model, **options):
    """The solver whose air drags the cable as it should."""
    return newton.solvers.SolverMuJoCo(
        model, integrator="euler", viscosity=VISCOSITY, density=AIR, disable_contacts=True,
        **options,
    )


def run(seconds, **options):
    """Simulate; returns the poses of the links as an array."""
    builder, _ = build()
    model = builder.finalize()
    before, after = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, before)
    engine, control = solver(model, **options), model.control()
    for _ in range(round(seconds / STEP)):
        before.clear_forces()
        engine.step(before, after, control, None, STEP)
        before, after = after, before
    return before.body_q.numpy()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--cpu", action="store_true", help="MuJoCo itself, without CUDA")
    arguments = parser.parse_args()
    places = run(arguments.seconds, use_mujoco_cpu=arguments.cpu)
    print("last link at", " ".join(f"{x:.4f}" for x in places[-1, :3]), "m")
'''


def approximations(chain: CableChain) -> tuple[str, ...]:
    """Parts of the cable that the format only approximates, one line each."""
    ratio = float(np.mean(chain.twist)) / float(np.mean(chain.bend))
    lines = [
        "twist: a ball joint is as stiff against it as against bending; "
        f"{ratio:.3g} of that would be right",
        "elasticity of ball joints is known to Newton's SolverMuJoCo alone",
    ]
    if chain.grips:
        lines.append("grips stand still: they are joints with the world")
    return tuple(lines)


def newton(chain: CableChain, *, step: float, comment: str) -> str:
    """The cable as a script.

    Args:
        step: time step [s].
        comment: comment at the top of the file.
    """
    viscosity, air = fluid(chain)
    grips = {grip.end: grip for grip in chain.grips}
    links, joints = [], []
    for k, pose in enumerate(chain.poses):
        mass, centre, inertia = chain.loaded(k)
        begin, stop = chain.extent(k)
        links.append(
            f"    ({_tuple(_transform(pose))}, {mass:.9g}, {_tuple(centre)}, "
            f"{_tuple(inertia.ravel())}, {begin:.9g}, {stop:.9g}),"
        )
    for k, (rest, turn) in enumerate(zip(chain.rest, chain.turns, strict=True)):
        joints.append(
            f"    ({chain.bend[k]:.9g}, {_tuple(rest.as_quat())}, {_tuple(turn.as_quat())}),"
        )
    head = ["# " + line if line else "#" for line in comment.splitlines()]
    numbers = [
        '"""A cable for Newton: `build` adds it to a ModelBuilder, `solver` steps it."""',
        "",
        f"GRAVITY = {_tuple(chain.gravity)}  # m/s^2",
        f"CELL = {chain.cell!r}  # m, distance of the joints",
        f"RADIUS = {0.5 * chain.diameter!r}  # m",
        f"RELAXATION_TIME = {chain.relaxation_time!r}  # s",
        f"STEP = {step!r}  # s",
        f"VISCOSITY = {viscosity!r}  # Pa s, of the air",
        f"AIR = {air!r}  # kg/m^3, its density",
    ]
    for name, end in (("START", "start"), ("END", "end")):
        grip = grips.get(end)
        numbers.append(f'{name} = "{grip.kind if grip else ""}"  # clamp, tip, or free where empty')
        if grip is not None:
            link = 0 if end == "start" else chain.joints
            tip = Pose(np.array([chain.extent(link)[link > 0], 0.0, 0.0]), chain.rest[0].identity())
            numbers.append(f"{name}_GRIP = {_tuple(_transform(grip.commanded @ grip.offset))}")
            numbers.append(f"{name}_TIP = {_tuple(_transform(tip))}")
    if "start" in grips and grips["start"].kind == "tip":
        held = (grips["start"].commanded @ grips["start"].offset).rotation
        numbers.append(f"ROOT_TURN = {_tuple((held.inv() * chain.root.rotation).as_quat())}")
    return "\n".join(
        [
            *head, *numbers,
            "# pose (x y z, qx qy qz qw), mass, centre, inertia, begin and end on its x axis",
            "LINKS = (", *links, ")",
            "# stiffness in N m/rad, rotation at rest and now (qx qy qz qw)",
            "JOINTS = (", *joints, ")",
        ]
    ) + BODY  # fmt: skip


def _transform(pose: Pose) -> FloatArray:
    return np.concatenate([pose.position, pose.rotation.as_quat()])


def _tuple(values: Sequence[float] | FloatArray) -> str:
    return f"({', '.join(f'{float(v):.9g}' for v in values)})"
