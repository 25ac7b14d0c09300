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
from dlo_ros.rod import engine, solver
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar import expand, flat_reference, in_plane, reduce, system_of
from dlo_ros.rod.state import Sensitivity, State, Strains
from dlo_ros.rod.statics import stresses
from dlo_ros.rod.tables import DOF
from dlo_ros.spline import FloatArray

NEWTON_TOLERANCE = 1e-8  # of L
# Error that one step may add, as a share of simulation.tolerance: measured on a falling cantilever.
STEP_SHARE = 0.03


@dataclass(frozen=True)
class Track:
    """A simulated motion.

    Args:
        state: at the last stamp.
        shapes: control points of the simulation's basis at every stamp, shape (S, n, 4).
        derivatives: with respect to the logarithms of the P parameters, shape (S, P, n, 4).
        steps: taken, rejected ones included.
    """

    state: State
    shapes: FloatArray
    derivatives: FloatArray
    steps: int


def advance(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    scales: FloatArray | None = None,
) -> State:
    """Integrate to one stamp [ns]; see `follow`."""
    return follow(model, boundary, state, command, [stamp], scales).state


def follow(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamps: Sequence[int],
    scales: FloatArray | None = None,
) -> Track:
    """Integrate through stamps with steps that keep the error within simulation.tolerance.

    Args:
        stamps: [ns], growing, none before the state's.
        scales: see `static_sensitivity`; given, the state's sensitivities are carried along.

    Raises:
        SimulationError: a step does not converge however small it is.
        CommandError: the command gives an end no direction.
    """
    flat = in_plane(model, state, command)
    system = system_of(model, boundary, flat=flat)
    wanted = scales if scales is not None and state.sensitivity is not None else np.zeros((0, 4))
    moving = _moving(state, command, flat, len(wanted))
    times = (np.asarray(stamps, dtype=np.int64) - command.stamp) / NANOSECONDS
    shapes = np.empty((len(times), *moving.q.shape))
    derivatives = np.empty((len(times), len(wanted), *moving.q.shape))
    tolerance = STEP_SHARE * model.settings.simulation.tolerance * model.basis.length
    status, moving, steps = engine.march(
        system, boundary.imposed(command), moving, times, tolerance, NEWTON_TOLERANCE, wanted,
        shapes, derivatives,
    )  # fmt: skip
    if status == engine.NO_DIRECTION:
        raise CommandError(
            "dlo/command: two control points that give the direction of an end coincide"
        )
    if status != engine.DONE:
        raise SimulationError(
            f"the simulation does not converge at {moving.time:.3f} s of the command even with "
            f"steps of {engine.SMALLEST_STEP:g} s; the imposed motion may jump or stretch the DLO"
        )
    last = int(stamps[-1]) if len(stamps) else state.stamp
    new = _state(model, state, moving, last, flat, len(wanted))
    return Track(new, expand(shapes, state.q), expand(derivatives, state.q), steps)


def _moving(state: State, command: Command, flat: bool, count: int) -> engine.Moving:
    """A state for compiled code."""
    n, nb = len(state.q), len(state.strains.other)
    none = np.zeros((0, n, DOF))
    empty = Strains(np.zeros((0, len(state.strains.stretch))), np.zeros((0, nb, 3)))
    s = Sensitivity(none, none, none, none, empty, empty)
    if count:
        assert state.sensitivity is not None
        s = state.sensitivity
    return engine.Moving(
        (state.stamp - command.stamp) / NANOSECONDS,
        state.last_step,
        state.next_step,
        reduce(state.q, flat),
        reduce(state.velocity, flat),
        reduce(state.acceleration, flat),
        reduce(state.auxiliary, flat),
        state.reference,
        state.frames.copy(),
        state.strains.stretch,
        state.previous.stretch,
        state.strains.other,
        state.previous.other,
        reduce(s.q, flat),
        reduce(s.velocity, flat),
        reduce(s.acceleration, flat),
        reduce(s.auxiliary, flat),
        s.strains.stretch,
        s.previous.stretch,
        s.strains.other,
        s.previous.other,
    )


def _state(
    model: RodModel, before: State, m: engine.Moving, stamp: int, flat: bool, count: int
) -> State:
    """What compiled code left, as a state in space."""
    q = expand(m.q, before.q)
    sensitivity = None
    if count:
        sensitivity = Sensitivity(
            expand(m.d_q, before.q),
            expand(m.d_velocity, before.q),
            expand(m.d_acceleration, before.q),
            expand(m.d_auxiliary, before.q),
            Strains(m.d_stretch, m.d_other),
            Strains(m.d_stretch_before, m.d_other_before),
        )
    return State(
        stamp,
        q,
        expand(m.velocity, before.q),
        expand(m.acceleration, before.q),
        expand(m.auxiliary, before.q),
        flat_reference(model, q, before.reference) if flat else m.reference,
        m.frames,
        Strains(m.stretch, m.other),
        Strains(m.stretch_before, m.other_before),
        m.last_step,
        m.next_step,
        sensitivity,
    )


def with_consistent_acceleration(model: RodModel, boundary: Boundary, state: State) -> State:
    """The state with the acceleration that its forces cause, imposed points not accelerated."""
    rule, stiff = model.rule, model.stiffness
    mass, spin, drag = model.mass, model.spin, model.drag
    still = np.zeros_like(drag)
    # The elastic force of the state: stresses through the strains' derivatives.
    _, _, _, grad_s, grad_o = solver.linearise(
        state.q, boundary.fixed, rule, stiff, state.reference, mass, spin, drag, still, 1.0, 0.0
    )
    stress = stresses(model, state.strains)
    elastic = solver.stress_forces(rule, grad_s, grad_o, stress.stretch[None], stress.other[None])
    viscous = np.empty_like(state.q)
    solver.multiply_scalar(drag, still, state.velocity, viscous)
    right = (model.load.ravel() - elastic[0] - viscous.ravel())[None]
    band, diagonal = solver.factorised_mass(mass, spin, boundary.fixed)
    solver.back_substitute(band, diagonal, boundary.fixed, boundary.pins, right)
    acceleration = right[0].reshape(state.q.shape)
    return replace(state, acceleration=acceleration, auxiliary=acceleration)
