# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""MuJoCo's own rod: a one-dimensional flex, as its documentation describes it.

Inextensible edges (equality constraints), the `discrete` integrator. The clamp lies in the middle
of the first edge; both points of a clamped edge are tied to mocap bodies.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from bench.contender import Contender, Failure, Prepared, Setting
from bench.mujoco_chain import clamp_path
from bench.tasks import GRAVITY, Task
from dlo_ros.spline import FloatArray


def flex_nodes(task: Task, edges: int) -> FloatArray:
    """Material coordinates of the points [m]."""
    h = task.rod.length / (edges - (1.0 if task.both_ends else 0.5))
    nodes: FloatArray = h * (np.arange(edges + 1) - 0.5)
    return nodes


def flex_xml(task: Task, setting: Setting) -> str:
    """The model of a task in MuJoCo's own format."""
    rod, n = task.rod, setting["edges"]
    nodes = flex_nodes(task, n)
    h = nodes[1] - nodes[0]
    held = [0, 1, n - 1, n] if task.both_ends else []
    mocaps = "".join(f'<body name="m{k}" mocap="true" pos="{nodes[k]} 0 0"/>' for k in held)
    ties = "".join(
        f'<connect body1="F_{k}" body2="m{k}" anchor="0 0 0" solref="{setting["tie"]} 1" '
        'solimp="0.9999 0.9999 0.001"/>'
        for k in held
    )
    pin = "" if held else '<pin id="0 1"/>'
    return f"""
    <mujoco>
      <option timestep="{setting["step"]}" integrator="discrete" solver="Newton"
        gravity="0 0 {-GRAVITY}" iterations="50" tolerance="1e-6">
        <flag contact="disable"/>
      </option>
      <worldbody>
        {mocaps}
        <flexcomp name="F" type="grid" dim="1" count="{n + 1} 1 1" spacing="{h} {h} {h}"
          pos="{0.5 * (nodes[0] + nodes[-1])} 0 0" radius="{0.5 * rod.diameter}"
          mass="{rod.linear_density * h * (n + 1)}">
          {pin}
          <edge equality="true" solref="{setting["tie"]} 1" solimp="0.9999 0.9999 0.001"/>
          <elasticity young="{rod.young_modulus}" poisson="{rod.poisson_ratio}" section="circle"
            damping="{setting["relaxation"]}"/>
          <contact contype="0" conaffinity="0" selfcollide="none"/>
        </flexcomp>
      </worldbody>
      <equality>{ties}</equality>
    </mujoco>"""


class MujocoFlex(Contender):
    """The one-dimensional flex; settled shapes only."""

    size = "edges"
    stretch = False

    def __init__(self) -> None:
        self.name = "MuJoCo flex"

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class."""
        if task.moving:
            return
        damping = (0.2,) if task.both_ends else (0.7, 1.0)
        for step, relaxation, tie in itertools.product((0.04, 0.02), damping, (0.002, 0.02)):
            yield [
                {"edges": n, "step": step, "relaxation": relaxation, "tie": tie}
                for n in (10, 13, 16, 20, 26, 34, 44, 60)
            ]  # fmt: skip

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """See the base class."""
        model = mujoco.MjModel.from_xml_string(flex_xml(task, setting))
        if not task.both_ends:
            # Every point got the same mass; the free end has half an edge only.
            model.body_mass[model.body(f"F_{setting['edges']}").id] *= 0.5
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        nodes = flex_nodes(task, setting["edges"])
        h = nodes[1] - nodes[0]
        step = setting["step"]
        ends = clamp_path(task, step)
        path = list(np.repeat(ends, 2, axis=1) + h * np.array([-0.5, 0.5, -0.5, 0.5])[:, None]
                    * np.array([1.0, 0.0, 0.0]))  # fmt: skip

        def run() -> FloatArray:
            mujoco.mj_resetData(model, data)
            if task.both_ends:
                held = data.mocap_pos
                for places in path:
                    held[:] = places
                    mujoco.mj_step(model, data)
            else:
                mujoco.mj_step(model, data, len(path))
            if data.time < task.duration - 0.5 * step:
                raise Failure("MuJoCo started anew")
            return data.qpos

        def curves(qpos: FloatArray) -> FloatArray:
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            x = data.flexvert_xpos.reshape(-1, 3)
            if not np.all(np.isfinite(x)) or np.abs(x[:, 1]).max() > 0.05 * task.rod.length:
                raise Failure("the flex left its plane")
            return CubicSpline(nodes, x[:, [0, 2]])(task.quadrature[0])[None]

        return Prepared(run, curves)
