# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The motion of one rod through a series of instants, with sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, SimulationError
from dlo_ros.rod import adaptive_integration
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary
from dlo_ros.rod.compiled_rod import compiled
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import moving_of, nothing_varies, state_of, true_command, varying_of
from dlo_ros.rod.planar_model import expand
from dlo_ros.rod.solve.generalised_alpha import DONE, NO_DIRECTION, SMALLEST_STEP
from dlo_ros.rod.solve.integrator_state import TIME
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

# Newton's method ends with a correction below this share of the error that a step may add; what is
# left is quadratically smaller.
NEWTON_SHARE = 0.05
ROUNDING = 1e-11  # of L: smaller corrections are not asked for
# Error that one step may add, as a share of simulation.tolerance: measured on a falling cantilever.
STEP_SHARE = 0.03


def accuracy(models: Sequence[RodModel]) -> tuple[float, float]:
    """Error that one step of rods may add, and convergence of Newton's method, both in m."""
    length = models[0].basis.length
    step = STEP_SHARE * min(m.settings.simulation.tolerance for m in models) * length
    newton = NEWTON_SHARE * step * min(m.correction_share for m in models)
    return step, max(newton, ROUNDING * length)


def corners_of(models: Sequence[RodModel], command: Command) -> FloatArray:
    """Times [s] at which a command, with all effects applied, ends a step of rods (T,)."""
    length = models[0].basis.length
    size = min(m.settings.simulation.tolerance for m in models) * length
    return command.corners(size, length, max(m.spreading for m in models))


@dataclass(frozen=True)
class Track:
    """A simulated motion.

    Args:
        state: state at the last stamp.
        shapes: control points of the simulation's basis at every stamp, shape (S, n, 4).
        speeds: velocities of the control points; zero where neither these nor sensitivities were
            requested.
        twists: twist strain [rad/m] at the nb bending points, shape (S, nb); (0, 0) in the plane.
        derivatives: derivatives with respect to the logarithms of the P parameters, shape (S, P, n,
            4).
        steps: number of steps, rejected ones included.
    """

    state: State
    shapes: FloatArray
    speeds: FloatArray
    twists: FloatArray
    derivatives: FloatArray
    steps: int


def integrate(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamps: Sequence[int],
    parameters: Sequence[str] = (),
    *,
    flat: bool,
    stepwise: bool = False,
) -> Track:
    """Integration of one rod through instants, see `dynamics.follow`.

    Args:
        flat: whether everything lies in the plane y = 0.
        stepwise: whether every stamp ends a step.
    """
    true = true_command(model, command)
    rod = compiled(model, boundary, command, parameters, flat=flat)
    moving = moving_of(state, true, flat=flat)
    if parameters:
        varying = rod.mark(varying_of(state, flat=flat))
    else:
        varying = nothing_varies(state, 0, flat=flat)
    times = (np.asarray(stamps, dtype=np.int64) - true.stamp) / NANOSECONDS
    shapes, speeds = (np.empty((len(times), *moving.q.shape)) for _ in range(2))
    twists = np.empty((0, 0) if flat else (len(times), len(moving.stretch)))
    derivatives = np.empty((len(times), len(parameters), *moving.q.shape))
    length = model.basis.length
    tolerance, newton = accuracy([model])
    corners = corners_of([model], true)
    if stepwise:
        corners = np.union1d(corners, times)
    status, steps = adaptive_integration.march(
        rod.prepared, moving, corners, times, tolerance, newton / length, varying, shapes, speeds,
        twists, derivatives,
    )  # fmt: skip
    if status == NO_DIRECTION:
        raise CommandError(NO_DIRECTION_TEXT)
    if status != DONE:
        raise SimulationError(
            f"the simulation does not converge at {moving.clock[TIME]:.3f} s of the command even "
            f"with steps of {SMALLEST_STEP:g} s; the imposed motion may jump or stretch the DLO"
        )
    last = int(stamps[-1]) if len(stamps) else state.stamp
    new = state_of(model, state, moving, last, varying if parameters else None)
    shapes, speeds, derivatives = (expand(x, state.q) for x in (shapes, speeds, derivatives))
    return Track(new, shapes, speeds, twists, derivatives, steps)
