"""Static equilibrium under imposed motion, and its sensitivities."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod import engine, grips, solver
from dlo_ros.rod.boundary import Boundary, Held
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar import expand, flat_reference, in_plane, reduce, system_of
from dlo_ros.rod.state import Sensitivity, State, Strains, rest_state, strains_of
from dlo_ros.rod.tables import DOF, Reference
from dlo_ros.spline import FloatArray

TOLERANCE = 1e-9
MOVE_LIMIT = 0.05  # imposed motion per increment, of L
TURN_LIMIT = 0.15  # imposed rotation per increment [rad]


@dataclass(frozen=True)
class Equilibrium:
    """A rod at rest.

    Args:
        state: the state, without velocity.
        stable: whether it is a minimum of the energy; pinned rods are not judged (True).
        iterations: Newton iterations that it took.
    """

    state: State
    stable: bool
    iterations: int


def hold(state: State, boundary: Boundary, command: Command, stamp: int) -> Held:
    """What the command holds at a stamp, for a rod in a given state."""
    return boundary.held(command, stamp, state.q[[0, -1], 3], state.frames)


def settle(
    model: RodModel, boundary: Boundary, state: State, command: Command, stamp: int
) -> Equilibrium:
    """Static equilibrium at a stamp, on the branch that leads there from the given state.

    Raises:
        SimulationError: no equilibrium was found, for example because the imposed ends are
            further apart than the DLO is long.
    """
    held = hold(state, boundary, command, stamp)
    reachable(model, held, boundary)
    fixed = boundary.fixed.reshape(-1, DOF)
    pin_now = boundary.basis.matrix(boundary.pin_abscissae) @ state.q[:, :3]
    count = _increments(model, state, held, fixed, held.pins - pin_now)
    flat = in_plane(model, state, command)
    system = system_of(model, boundary, flat=flat)
    q, reference = reduce(state.q, flat), state.reference
    total, negative = 0, 0
    for k in range(1, count + 1):
        share = k / count
        wanted = np.where(fixed, state.q + share * (held.target - state.q), 0.0)
        increment = np.where(system.fixed, (reduce(wanted, flat) - q).ravel(), 0.0)
        pins = pin_now + share * (held.pins - pin_now)
        gap = engine.pin_gap(system, reduce(wanted, flat), pins) - system.pins @ q.ravel()
        iterations, negative, reference = solver.equilibrium(
            q, increment, system.fixed, system.pins, gap, system.rule, system.stiffness, reference,
            system.load.ravel(), system.mass, system.spin, model.rate2, system.length, TOLERANCE,
        )  # fmt: skip
        total += abs(iterations)
        if iterations < 0 or not np.all(np.isfinite(q)):
            raise SimulationError(
                f"no static equilibrium found after {total} iterations; check that the imposed "
                "ends can be reached and that stiffness and density are of a sensible size"
            )
    q = expand(q, state.q)
    if flat:
        reference = flat_reference(model, q, reference)
        negative = max(negative, _unstable_directions(model, boundary, q, reference))
    zero = np.zeros_like(q)
    now = strains_of(q, model, reference)
    rest = State(stamp, q, zero, zero, zero, reference, held.frames, now, now)
    return Equilibrium(rest, negative <= 0, total)


def _increments(
    model: RodModel, state: State, held: Held, fixed: FloatArray, pin_move: FloatArray
) -> int:
    """In how many steps the imposed motion is made, so that the branch is not lost."""
    change = np.where(fixed, held.target - state.q, 0.0)
    move = max(float(np.abs(change[:, :3]).max()), float(np.abs(pin_move).max(initial=0.0)))
    before, after = (f[:, grips.TANGENT : grips.DIRECTOR] for f in (state.frames, held.frames))
    turned = np.arccos(np.clip(np.sum(before * after, axis=1), -1.0, 1.0))
    turn = max(float(np.abs(change[:, 3]).max()), float(turned.max()))
    return max(1, int(np.ceil(max(move / model.basis.length / MOVE_LIMIT, turn / TURN_LIMIT))))


def _unstable_directions(
    model: RodModel, boundary: Boundary, q: FloatArray, reference: Reference
) -> int:
    """Negative eigenvalues of the stiffness in space; pinned rods are not judged."""
    if len(boundary.pins):
        return 0
    none = np.zeros_like(model.gram)
    _, _, negative, _, _ = solver.linearise(
        q, boundary.fixed, model.rule, model.stiffness, reference, none, none, none, none, 0.0, 0.0
    )
    return int(negative)


def reachable(model: RodModel, held: Held, boundary: Boundary) -> None:
    """Refuse ends that are further apart than the DLO can span.

    Raises:
        SimulationError: with both distances.
    """
    fixed = boundary.fixed.reshape(-1, DOF)
    points = [(model.basis.greville[k], held.target[k, :3]) for k in (0, -1) if fixed[k, 0]]
    points += list(zip(boundary.pin_abscissae, held.pins, strict=True))
    points.sort(key=lambda p: float(p[0]))
    for (u0, r0), (u1, r1) in pairwise(points):
        apart, length = float(np.linalg.norm(r1 - r0)), float(u1 - u0)
        if apart > 1.02 * length:
            raise SimulationError(
                f"the command holds two points {apart:.4g} m apart, but the DLO between them is "
                f"only {length:.4g} m long"
            )


def relax_stretch(model: RodModel, boundary: Boundary, held: Held, q: FloatArray) -> FloatArray:
    """The nearest shape that is held as commanded and not stretched.

    An observed spline has noise along its axis, which stiff stretch would turn into violent
    vibration. Minimises the stretch energy plus a weak pull to the given shape q (n, 4).
    """
    stiff = model.stiffness
    soft = stiff._replace(bend=0.0 * stiff.bend, twist=0.0 * stiff.twist + 1.0)
    state = rest_state(0, q, model)
    unit, none = model.gram, np.zeros_like(model.gram)
    stiffest = float(stiff.stretch.mean()) / model.basis.length**2
    given = np.empty_like(state.q)
    solver.multiply_scalar(unit, unit, state.q, given)
    best = None
    q = state.q.copy()
    # From a strong pull to a weak one: without bending stiffness a compressed shape buckles.
    for pull in stiffest * np.logspace(0, -4, 5):
        iterations, _ = solver.implicit_step(
            q, held.target, boundary.fixed, boundary.pins, boundary.pin_values(held),
            model.rule, soft, state.reference, unit, unit, none, none, pull, 0.0, pull * given,
            model.basis.length, 1e-8, 50,
        )  # fmt: skip
        if iterations < 0:
            break
        best = q.copy()
    if best is None:
        raise SimulationError(
            "the first observed shape cannot be held as commanded; check rod.length, the command "
            "and the observed spline"
        )
    return best


def static_sensitivity(
    model: RodModel, boundary: Boundary, state: State, scales: FloatArray
) -> Sensitivity:
    """Derivatives of an equilibrium with respect to the logarithms of P parameters.

    Args:
        scales: shape (P, 4): how each parameter scales stiffness, inertia with load, drag and
            relaxation time (of which the last two do not act at rest).

    Returns:
        Sensitivities of shape (P, n, 4); velocities and accelerations are zero.
    """
    rule, stiff = model.rule, model.stiffness
    none = np.zeros_like(model.gram)
    band, diagonal, _, grad_s, grad_o = solver.linearise(
        state.q, boundary.fixed, rule, stiff, state.reference, none, none, none, none, 0.0, 0.0
    )
    stress = stresses(model, state.strains)
    count = len(scales)
    forces = solver.stress_forces(
        rule, grad_s, grad_o,
        scales[:, 0, None] * stress.stretch, scales[:, 0, None, None] * stress.other,
    )  # fmt: skip
    rhs = scales[:, 1, None] * model.weight.ravel() - forces
    solver.back_substitute(band, diagonal, boundary.fixed, boundary.pins, rhs)
    dq = rhs.reshape(count, -1, DOF)
    zero = np.zeros_like(dq)
    change = Strains(*solver.strain_sensitivities(rule, grad_s, grad_o, dq))
    return Sensitivity(dq, zero, zero, zero, change, change)


def stresses(model: RodModel, strain: Strains) -> Strains:
    """Elastic stress resultants of strains (of which the rest strains are subtracted)."""
    stiff = model.stiffness
    other = np.empty_like(strain.other)
    other[..., :2] = stiff.bend * (strain.other[..., :2] - stiff.bend_rest)
    other[..., 2] = stiff.twist * (strain.other[..., 2] - stiff.twist_rest)
    return Strains(stiff.stretch * (strain.stretch - stiff.stretch_rest), other)
