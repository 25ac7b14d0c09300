# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""MuJoCo: a chain of rigid links with elastic joints, tuned as far as we can.

Links of length h; the joints between them have the stiffness E I / h, those at clamps twice that,
since only half a link bends there. The start is a mocap body, a moving end a body that is welded
to another one. The twist stiffness of a ball joint equals its bending stiffness.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from bench.contender import Contender, Failure, Prepared, Setting
from bench.tasks import GRAVITY, Task
from dlo_ros.spline import FloatArray

# A setting that blows up is a result of the search; nobody needs to read of it.
mujoco.set_mju_user_warning(lambda text: None)


def chain_xml(task: Task, setting: Setting) -> str:
    """The model of a task in MuJoCo's own format."""
    rod, n = task.rod, setting["links"]
    h = rod.length / n
    stiffness = rod.bending_stiffness / h
    mass = rod.linear_density * h
    across = mass * (h * h / 12.0 + rod.diameter**2 / 16.0)
    along = mass * rod.diameter**2 / 8.0
    joint_type = 'type="ball"' if setting["joint"] == "ball" else 'type="hinge" axis="0 1 0"'

    def joint(factor: float) -> str:
        k = factor * stiffness
        return f'<joint {joint_type} stiffness="{k!r}" damping="{k * setting["relaxation"]!r}"/>'

    inertia = (
        f'<inertial pos="{0.5 * h!r} 0 0" mass="{mass!r}" diaginertia="{along!r} {across!r} '
        f'{across!r}"/>'
    )
    tail, welds, targets = "", "", ""
    if task.both_ends:
        light = f'<inertial pos="0 0 0" mass="{0.01 * mass!r}" diaginertia="1e-9 1e-9 1e-9"/>'
        tail = f'<body name="end" pos="{h!r} 0 0">{joint(2.0)}{light}</body>'
        targets = f'<body name="target" mocap="true" pos="{rod.length!r} 0 0"/>'
        solref = f"{setting['weld']!r} 1"
        welds = (
            '<equality><weld body1="end" body2="target" relpose="0 0 0 1 0 0 0" '
            f'solref="{solref}" solimp="0.9999 0.9999 0.001"/></equality>'
        )
    body = tail
    for k in reversed(range(n)):
        place = "0 0 0" if k == 0 else f"{h!r} 0 0"
        body = (
            f'<body name="link{k}" pos="{place}">{joint(2.0 if k == 0 else 1.0)}{inertia}'
            f"{body}</body>"
        )
    constraint = "enable" if task.both_ends else "disable"
    return f"""
    <mujoco>
      <compiler autolimits="true" boundmass="0"/>
      <option timestep="{setting["step"]!r}" integrator="{setting["integrator"]}"
        gravity="0 0 {-GRAVITY}" iterations="10"
        tolerance="1e-6" jacobian="dense" solver="{setting["solver"]}">
        <flag contact="disable" constraint="{constraint}"/>
      </option>
      <worldbody>
        <body name="start" mocap="true">{body}</body>
        {targets}
      </worldbody>
      {welds}
    </mujoco>"""


def clamp_path(task: Task, step: float) -> FloatArray:
    """Positions of both mocap bodies at the end of every step, shape (steps, 2, 3)."""
    times = step * np.arange(1, round(task.duration / step) + 1)
    path = np.zeros((len(times), 2, 3))
    path[:, 0, 0] = task.approach * np.minimum(times, 1.0)
    path[:, 1, 0] = task.rod.length - task.approach * np.minimum(times, 1.0)
    return path


class MujocoChain(Contender):
    """The tuned chain.

    Args:
        joint: "ball", or "hinge" for a chain that knows its plane only.
        long_steps: whether settled shapes may be had with steps beyond 40 ms, too long to show
            any motion.
    """

    size = "links"
    stretch = False

    def __init__(self, joint: str = "ball", *, long_steps: bool = False) -> None:
        self.joint, self.long_steps = joint, long_steps
        self.name = f"MuJoCo chain of {joint} joints"
        if long_steps:
            self.name += ", long steps"

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class."""
        if task.moving and self.long_steps:
            return
        if task.moving:
            assert task.relaxation_time is not None
            links = (5, 6, 7, 8, 9, 10, 12, 14, 16, 20, 24)
            steps = (0.04, 0.02, 0.01, 0.008, 0.005, 0.004, 0.0025, 0.002, 0.001)
            kinds = ("discrete", "implicitfast", "implicit", "Euler", "RK4")
            damping, welds = (task.relaxation_time,), (0.0,)
        else:
            links = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 23, 26, 30, 35, 40, 50, 60, 80)
            steps = (0.04, 0.02)
            if self.long_steps:
                steps = (0.1, 0.0625, 0.05, *steps)
            kinds = ("discrete",)
            damping = (0.1, 0.3) if task.both_ends else (0.3, 0.45, 0.6, 0.7, 0.8, 1.0)
            welds = (0.002, 0.02) if task.both_ends else (0.0,)
        solvers = ("PGS", "Newton") if task.both_ends else ("Newton",)
        for kind, step, relaxation, weld, solver in itertools.product(
            kinds, steps, damping, welds, solvers
        ):
            yield [
                {"links": n, "step": step, "relaxation": relaxation, "integrator": kind,
                 "joint": self.joint, "weld": weld, "solver": solver}
                for n in links
            ]  # fmt: skip

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """See the base class."""
        model = mujoco.MjModel.from_xml_string(chain_xml(task, setting))
        data = mujoco.MjData(model)
        step = setting["step"]
        path = list(clamp_path(task, step))
        marks = [round(t / step) for t in task.instants]
        strides = np.diff([0, *marks]).tolist()

        def run() -> list[FloatArray]:
            mujoco.mj_resetData(model, data)
            if not task.both_ends:
                shapes = []
                for stride in strides:
                    mujoco.mj_step(model, data, stride)
                    shapes.append(data.qpos.copy())
                # MuJoCo starts anew by itself where it blew up.
                if data.time < task.duration - 0.5 * step:
                    raise Failure("MuJoCo started anew")
                return shapes
            held = data.mocap_pos
            for clamps in path:
                held[:] = clamps
                mujoco.mj_step(model, data)
            if data.time < task.duration - 0.5 * step:
                raise Failure("MuJoCo started anew")
            return [data.qpos.copy()]

        def curves(shapes: list[FloatArray]) -> FloatArray:
            return chain_curves(task, setting, model, np.array(shapes))

        return Prepared(run, curves)


def chain_curves(
    task: Task, setting: Setting, model: mujoco.MjModel, qpos: FloatArray
) -> FloatArray:
    """Smooth curves through the joints, shape (S, points, 2) [m], of coordinates (S, nq)."""
    n, length = setting["links"], task.rod.length
    data = mujoco.MjData(model)
    first = model.body("link0").id
    nodes = np.linspace(0.0, length, n + 1)
    u, _ = task.quadrature
    result = []
    for row in qpos:
        if task.both_ends:
            data.mocap_pos[:] = clamp_path(task, setting["step"])[-1]
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        last = data.xpos[first + n - 1] + data.xmat[first + n - 1].reshape(3, 3)[:, 0] * length / n
        points = np.vstack([data.xpos[first : first + n], last])
        if not np.all(np.isfinite(points)) or np.abs(points[:, 1]).max() > 0.05 * length:
            raise Failure("the chain left its plane")
        ends = [(1, np.array([1.0, 0.0])), (2, np.zeros(2))]
        if task.both_ends:
            ends[1] = ends[0]
        result.append(CubicSpline(nodes, points[:, [0, 2]], bc_type=ends)(u))
    return np.array(result)
