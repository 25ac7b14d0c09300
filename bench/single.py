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
from dlo_ros.rod import dynamics, solver, statics
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar import reduce, system_of
from dlo_ros.rod.state import State

PARAMETERS = np.eye(4)  # E, mu, drag and relaxation time
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

    def _settle(self, k: int, state: State) -> State:
        return statics.settle(self.models[k], self.boundary, state, self.imposed, self.stamp).state

    def public(self) -> Any:
        """What a user calls: `settle` and `static_sensitivity`."""
        with in_space(self.spatial):
            self.at = 1 - self.at
            state = self._settle(self.at, self.states[1 - self.at])
            return statics.static_sensitivity(
                self.models[self.at], self.boundary, state, PARAMETERS
            )

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
        state = self._settle(0, self.states[0])
        exact = statics.static_sensitivity(model, self.boundary, state, PARAMETERS).q[0]
        return float(np.abs(exact - difference).max() / np.abs(difference).max())

    def compiled(self) -> Callable[[], Any]:
        """The same through the compiled functions alone, everything around them prepared."""
        flat = not self.spatial
        parts = []
        for k in (0, 1):
            model, start = self.models[k], self.states[1 - k]
            system = system_of(model, self.boundary, flat=flat)
            parts.append((model, system, reduce(start.q, flat), start.reference))
        none = np.zeros_like(parts[0][0].gram)
        count = len(PARAMETERS)
        at = [0]

        def run() -> Any:
            at[0] = 1 - at[0]
            model, system, start, reference = parts[at[0]]
            q = start.copy()
            _, _, reference = solver.equilibrium(
                q, np.zeros(q.size), system.fixed, system.pins, np.zeros(0), system.rule,
                system.stiffness, reference, system.load.ravel(), system.mass, system.spin,
                model.rate2, system.length, statics.TOLERANCE,
            )  # fmt: skip
            band, diagonal, _, grad_s, grad_o = solver.linearise(
                q, system.fixed, system.rule, system.stiffness, reference, none, none, none, none,
                0.0, 0.0,
            )  # fmt: skip
            stretch, other = solver.strains(q, system.rule, reference)
            forces = solver.stress_forces(
                system.rule, grad_s, grad_o,
                np.tile(stretch * system.stiffness.stretch, (count, 1)),
                np.tile(other * system.stiffness.twist.max(), (count, 1, 1)),
            )  # fmt: skip
            solver.back_substitute(band, diagonal, system.fixed, system.pins, forces)
            return forces

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


def cost_of_parameters(*, spatial: bool) -> dict[int, float]:
    """CPU time of T2 with 0 to 4 parameters' sensitivities carried along, over that with none."""
    model, boundary, state, imposed = straight(T2, {"control_points": 13, **DAMPED})
    stamps = [round(T2.duration * NANOSECONDS)]
    sensitive = {}
    sensitive[0] = state
    for count in range(1, 5):
        carried = statics.static_sensitivity(model, boundary, state, PARAMETERS[:count])
        zero = np.zeros_like(carried.q)
        none = replace(
            carried.strains,
            stretch=np.zeros_like(carried.strains.stretch),
            other=np.zeros_like(carried.strains.other),
        )
        # The rod starts in a given shape, which no parameter changes.
        start = replace(
            carried, q=zero, velocity=zero, acceleration=zero, auxiliary=zero, strains=none,
            previous=none,
        )  # fmt: skip
        sensitive[count] = replace(state, sensitivity=start)
    result = {}
    for count, start_state in sensitive.items():
        scales = PARAMETERS[:count] if count else None
        with in_space(spatial):
            result[count] = cpu_time(
                lambda s=start_state, p=scales: dynamics.follow(
                    model, boundary, s, imposed, stamps, p
                ),
                BLOCK,
            )
    return {count: used / result[0] for count, used in result.items()}
