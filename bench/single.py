# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measurements of the rod alone: statics with gradient, cost over size, further parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bench.contender import cpu_time
from bench.ours import in_space, straight
from bench.tasks import T1, T2, Task
from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.rod import dynamics, statics
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.compiled_rod import compiled
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import nothing_varies, rest_state_of, unchanged
from dlo_ros.rod.sensitivity import sensitive_equilibrium
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod.state import State

PARAMETERS = MATERIAL
BLOCK = 0.05  # [s] CPU time that one measurement fills
CHANGE = 1.05  # of E between two equilibria, for a warm start
SIZES = (10, 20, 40, 80, 160)
DAMPED = {"tolerance": 0.02, "drag": 0.3, "relaxation": 0.05}


def settled(task: Task, control_points: int) -> tuple[RodModel, Boundary, State, Command]:
    """The rod at rest under the end of a task, led there from straight."""
    setting = {"control_points": control_points, **DAMPED}
    model, boundary, state, imposed = straight(task, setting)
    for stamp in np.linspace(0, task.duration * NANOSECONDS, 21).astype(np.int64).tolist():
        state = statics.settle(model, boundary, state, imposed, stamp).state
    return model, boundary, state, imposed


def _other(model: RodModel) -> RodModel:
    rod = model.settings.rod
    return model.with_settings(
        model.settings.with_material(CHANGE * rod.young_modulus, rod.density)
    )


class Statics:
    """One equilibrium of T2 with its gradient, n = 10, from that with 5 % less or more E.

    Args:
        spatial: whether the planar form is left out.
    """

    def __init__(self, *, spatial: bool) -> None:
        self.spatial = spatial
        model, self.boundary, state, self.imposed = settled(T2, 10)
        self.models = [model, _other(model)]
        self.stamp = state.stamp
        self.states = [state, state]
        with in_space(spatial):
            self.states[1] = self._settle(1, state)
        self.at = 0

    def _settle(self, k: int, state: State, parameters: tuple[str, ...] = ()) -> State:
        return statics.settle(
            self.models[k], self.boundary, state, self.imposed, self.stamp, parameters=parameters
        ).state

    def public(self) -> Any:
        """Settle as a user does: `settle` with the parameters that matter."""
        with in_space(self.spatial):
            self.at = 1 - self.at
            return self._settle(self.at, self.states[1 - self.at], PARAMETERS)

    def gradient_error(self) -> float:
        """Largest difference of the gradient by E to central differences, over its size."""
        model, rod = self.models[0], self.models[0].settings.rod
        change = 1e-4
        ends = []
        for sign in (1.0, -1.0):
            settings = model.settings.with_material(
                rod.young_modulus * np.exp(sign * change), rod.density
            )
            self.models.append(model.with_settings(settings))
            ends.append(self._settle(len(self.models) - 1, self.states[0]).q)
            self.models.pop()
        difference = (ends[0] - ends[1]) / (2.0 * change)
        sensitivity = self._settle(0, self.states[0], PARAMETERS).sensitivity
        assert sensitivity is not None
        exact = sensitivity.q[0]
        return float(np.abs(exact - difference).max() / np.abs(difference).max())

    def compiled(self) -> Callable[[], Any]:
        """A function that settles by compiled code, around it no more than copies of the state."""
        flat, count = not self.spatial, len(PARAMETERS)
        calls = []
        for model, start in zip(self.models, reversed(self.states), strict=True):
            rod = compiled(model, self.boundary, self.imposed, PARAMETERS, flat=flat)
            time = (self.stamp - self.imposed.stamp) / NANOSECONDS
            calls.append((start, rod.prepared, flat, time, model.rate2, statics.TOLERANCE, False))
        at = [0]

        def run() -> Any:
            at[0] = 1 - at[0]
            start, *others = calls[at[0]]
            change = unchanged(start, count)
            sensitive_equilibrium.settle(*others, rest_state_of(start), change)
            return change

        return run


def cost_of_sizes(*, spatial: bool) -> dict[int, float]:
    """CPU time of one time step of T1 by number of control points [us]."""
    stamps = [round(T1.duration * NANOSECONDS)]
    result = {}
    for n in SIZES:
        rod = straight(T1, {"control_points": n, **DAMPED})
        with in_space(spatial):
            steps = dynamics.follow(*rod, stamps).steps
            used = cpu_time(lambda rod=rod: dynamics.follow(*rod, stamps), BLOCK)
        result[n] = 1e6 * used / steps
    return result


def _followed(*arguments: Any, spatial: bool) -> Any:
    """A motion as `dynamics.follow` gives it, in space where that is forced."""
    with in_space(spatial):
        return dynamics.follow(*arguments)


def cost_of_parameters(*, spatial: bool) -> dict[int, float]:
    """CPU time of T2 with 0 to 4 parameters' sensitivities carried along, over that with none.

    All by `dynamics.follow`, as a user calls it.
    """
    model, boundary, state, imposed = straight(T2, {"control_points": 13, **DAMPED})
    stamps = [round(T2.duration * NANOSECONDS)]
    result = {}
    for count in range(len(PARAMETERS) + 1):
        # The rod starts in a given shape, which no parameter changes.
        start = replace(state, sensitivity=nothing_varies(state, count)) if count else state
        result[count] = cpu_time(
            lambda s=start, p=PARAMETERS[:count]: _followed(
                model, boundary, s, imposed, stamps, p, spatial=spatial
            ),
            BLOCK,
        )
    return {count: used / result[0] for count, used in result.items()}
