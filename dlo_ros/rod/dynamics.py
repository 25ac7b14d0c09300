"""Motion of the rod: generalised-alpha steps with Kelvin-Voigt damping and error control.

The equations M q'' + C q' + elastic forces = loads (paper, eq. (9)) hold exactly at the end of
every step; the generalised-alpha method relates q'' to an auxiliary acceleration. The strain rate
is a second-order backward difference, so a step minimises an incremental potential: the elastic
energy with another stiffness and other rest strains. The compiled steps are in `engine`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, SimulationError
from dlo_ros.rod import engine
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.moving import TIME
from dlo_ros.rod.packing import moving_of, nothing_varies, state_of, true_command, varying_of
from dlo_ros.rod.planar import expand, in_plane
from dlo_ros.rod.state import State
from dlo_ros.rod.statics import NO_DIRECTION_TEXT
from dlo_ros.rod.stepping import DONE, NO_DIRECTION, SMALLEST_STEP, starting_acceleration
from dlo_ros.rod.tangents import both_sides, compiled, tangent
from dlo_ros.spline import FloatArray

# Newton's method may leave this share of the error that a step may add, and no more than this of L.
NEWTON_SHARE, NEWTON_LARGEST = 0.01, 1e-5
# Error that one step may add, as a share of simulation.tolerance: measured on a falling cantilever.
STEP_SHARE = 0.03


@dataclass(frozen=True)
class Track:
    """A simulated motion.

    Args:
        state: at the last stamp.
        shapes, speeds: control points of the simulation's basis at every stamp and their
            velocities, shape (S, n, 4).
        derivatives: with respect to the logarithms of the P parameters, shape (S, P, n, 4).
        steps: taken, rejected ones included.
    """

    state: State
    shapes: FloatArray
    speeds: FloatArray
    derivatives: FloatArray
    steps: int


def advance(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    parameters: Sequence[str] = (),
) -> State:
    """Integrate to one stamp [ns]; see `follow`."""
    return follow(model, boundary, state, command, [stamp], parameters).state


def follow(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamps: Sequence[int],
    parameters: Sequence[str] = (),
) -> Track:
    """Integrate through stamps with steps that keep the error within simulation.tolerance.

    Args:
        stamps: [ns], growing, none before the state's.
        command: as it was commanded; the model's effects are applied to it.
        parameters: by which sensitivities are wanted, see `tangents`; those of the state are
            carried along.

    Raises:
        SimulationError: a step does not converge however small it is.
        CommandError: the command gives an end no direction.
    """
    true = true_command(model, command)
    flat = in_plane(model, state, true)
    rod = compiled(model, boundary, command, parameters, flat=flat)
    moving = moving_of(state, true, flat=flat)
    if parameters:
        varying = varying_of(state, rod.mark(nothing_varies(state, 0)), flat=flat)
    else:
        varying = nothing_varies(state, 0, flat=flat)
    times = (np.asarray(stamps, dtype=np.int64) - true.stamp) / NANOSECONDS
    shapes, speeds = (np.empty((len(times), *moving.q.shape)) for _ in range(2))
    derivatives = np.empty((len(times), len(parameters), *moving.q.shape))
    tolerance = STEP_SHARE * model.settings.simulation.tolerance * model.basis.length
    newton = min(NEWTON_SHARE * tolerance / model.basis.length, NEWTON_LARGEST)
    status, steps = engine.march(
        rod.system, rod.imposed, moving, times, tolerance, newton, varying, shapes, speeds,
        derivatives,
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
    return Track(new, shapes, speeds, derivatives, steps)


def with_consistent_acceleration(
    model: RodModel, boundary: Boundary, state: State, command: Command,
    parameters: Sequence[str] = (),
) -> State:  # fmt: skip
    """The state with the acceleration that its forces cause, imposed points not accelerated.

    Args:
        parameters: see `follow`.
    """
    true = true_command(model, command)
    flat = in_plane(model, state, true)
    moving = moving_of(state, true, flat=flat)

    def acceleration(changed: RodModel, asked: Command) -> FloatArray:
        rod = compiled(changed, boundary, asked, (), flat=flat)
        return np.asarray(starting_acceleration(rod.system, rod.imposed, moving))

    start = acceleration(model, command)
    moving = moving._replace(acceleration=start, auxiliary=start)
    new = state_of(model, state, moving, state.stamp, state.sensitivity)
    if not parameters or state.sensitivity is None:
        return new
    changes = []
    for name in parameters:
        chosen = tangent(model.settings, name)
        above, below = (acceleration(*pair) for pair in both_sides(model, command, chosen))
        changes.append(expand((above - below) / (2.0 * chosen.step), state.q))
    change = np.array(changes)
    return replace(
        new, sensitivity=state.sensitivity._replace(acceleration=change, auxiliary=change)
    )
