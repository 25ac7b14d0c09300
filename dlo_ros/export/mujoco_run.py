# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulation of an exported cable in MuJoCo, where that is installed."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import SimulationError
from dlo_ros.export.chain import CableChain
from dlo_ros.export.grips import Pose
from dlo_ros.export.mjcf import REST, coordinates, viscosity
from dlo_ros.export.scenes import INSTANT
from dlo_ros.spline import FloatArray, SplineBasis

PROBE = """<mujoco><extension><plugin plugin="{}"/></extension></mujoco>"""
REST_MOTION = 2e-5  # of the length, within the time of the slowest motion, of a cable at rest
LONGEST = 100  # such times in which a cable comes to rest
SAMPLES = 8  # points of the curve to a cell


def installed() -> Any | None:
    """The module mujoco; None where it is not installed."""
    try:
        found = importlib.import_module("mujoco")
    except ImportError:
        return None
    found.set_mju_user_warning(lambda text: None)  # a blow-up is reported by its error
    return found


def has_plugin(mujoco: Any, name: str) -> bool:
    """Whether this MuJoCo has a plugin."""
    try:
        mujoco.MjModel.from_xml_string(PROBE.format(name))
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class Followed:
    """A motion in MuJoCo.

    Args:
        shapes: control points at each stamp, shape (F, n, 3).
        seconds: processor time for each second of the motion [s].
    """

    shapes: FloatArray
    seconds: float


class MujocoCable:
    """An exported cable in MuJoCo.

    Args:
        mujoco: the module.
        text: MJCF.
        chain: the chain that the text was made from.

    Raises:
        SimulationError: MuJoCo does not take the text.
    """

    def __init__(self, mujoco: Any, text: str, chain: CableChain) -> None:
        self._mujoco, self._chain = mujoco, chain
        try:
            self._model = mujoco.MjModel.from_xml_string(text)
        except ValueError as err:
            raise SimulationError(f"MuJoCo refuses the exported cable: {err}") from err
        self._data = mujoco.MjData(self._model)
        self._links = [self._model.body(f"link_{k}").id for k in range(chain.joints + 1)]
        self._held = {grip.end: int(self._model.body(grip.end).mocapid[0]) for grip in chain.grips}
        mujoco.mj_resetDataKeyframe(self._model, self._data, self._model.key(REST).id)
        mujoco.mj_forward(self._model, self._data)

    @property
    def step(self) -> float:
        """Time step [s]."""
        return float(self._model.opt.timestep)

    def throw(self, soon: CableChain) -> None:
        """Give it the velocity that leads to another shape within a millisecond."""
        self._mujoco.mj_differentiatePos(
            self._model, self._data.qvel, INSTANT / NANOSECONDS, self.coordinates(),
            coordinates(soon),
        )  # fmt: skip

    def settle(self) -> None:
        """Come to rest, in air so thick that the slowest motion is damped critically.

        Raises:
            SimulationError: it blows up or does not come to rest.
        """
        model, data = self._model, self._data
        own = (float(model.opt.viscosity), float(model.opt.density))
        rate = self._chain.rate
        model.opt.density = 0.0
        model.opt.viscosity = viscosity(self._chain, 2.0 * rate * self._chain.line_density)
        watched = max(round(1.0 / rate / self.step), 1)
        before = self._places()
        for k in range(1, LONGEST + 1):
            self._mujoco.mj_step(model, data, watched)
            self._check(k * watched * self.step)
            now = self._places()
            if np.abs(now - before).max() < REST_MOTION * self._chain.length:
                break
            before = now
        else:
            raise SimulationError("MuJoCo's cable does not come to rest")
        model.opt.viscosity, model.opt.density = own
        data.qvel[:] = 0.0
        data.time = 0.0

    def follow(
        self, poses: Callable[[str, int], Pose], begin: int, stamps: Sequence[int],
        basis: SplineBasis,
    ) -> Followed:  # fmt: skip
        """Simulate from the present shape, grips moving.

        Args:
            poses: pose of a grip ("start", "end") at a stamp [ns].
            begin: stamp of the present shape [ns].
            stamps: stamps at which shapes are wanted [ns], growing, not before `begin`.
            basis: spline basis of the shapes that are returned.

        Raises:
            SimulationError: it blows up.
        """
        model, data, mujoco = self._model, self._data, self._mujoco
        marks = [round((stamp - begin) / NANOSECONDS / self.step) for stamp in stamps]
        path = {
            end: self._path([poses(end, begin + round(k * self.step * NANOSECONDS))
                             for k in range(1, marks[-1] + 1)])
            for end in self._held
        }  # fmt: skip
        shapes, used, done = [], 0.0, 0
        for mark in marks:
            began = time.process_time()
            for k in range(done, mark):
                for end, body in self._held.items():
                    data.mocap_pos[body], data.mocap_quat[body] = path[end][k]
                mujoco.mj_step(model, data)
            used += time.process_time() - began
            done = max(mark, done)
            self._check(done * self.step)
            shapes.append(self.shape(basis))
        return Followed(np.array(shapes), used / max(done * self.step, self.step))

    @staticmethod
    def _path(poses: Sequence[Pose]) -> list[tuple[FloatArray, FloatArray]]:
        return [(pose.position, pose.quaternion) for pose in poses]

    def shape(self, basis: SplineBasis) -> FloatArray:
        """The present shape as control points, shape (n, 3) [m]."""
        chain, data = self._chain, self._data
        self._mujoco.mj_kinematics(self._model, data)
        along = np.array([data.xmat[b].reshape(3, 3)[:, 0] for b in self._links])
        middle = np.full((len(self._links), 1), 0.5 * chain.cell)
        points = self._places() + middle * along
        u = np.linspace(0.0, basis.length, chain.joints + 1)
        slope = along * chain.length / basis.length
        dense = np.linspace(0.0, basis.length, SAMPLES * max(chain.joints, basis.spans) + 1)
        curve = CubicHermiteSpline(u, points, slope)(dense)
        return basis.fit(dense, np.asarray(curve))

    def coordinates(self) -> FloatArray:
        """Coordinates (qpos) now."""
        return np.array(self._data.qpos)

    def _places(self) -> FloatArray:
        return np.array(self._data.xpos[self._links])

    def _check(self, expected: float) -> None:
        # MuJoCo starts anew by itself where it blew up.
        if not np.all(np.isfinite(self._data.qpos)) or self._data.time < expected - 1.5 * self.step:
            raise SimulationError("MuJoCo's cable blows up; its time step is too long")
