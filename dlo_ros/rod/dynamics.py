"""Motion of the rod: generalised-alpha steps with Kelvin-Voigt damping and error control.

The equations M q'' + C q' + elastic forces = loads (paper, eq. (9)) hold exactly at the end of
every step; the generalised-alpha method relates q'' to an auxiliary acceleration. The strain rate
is a second-order backward difference, so a step minimises an incremental potential: the elastic
energy with another stiffness and other rest strains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod import solver
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.kernels import DOF, Stiffness, transport
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import Sensitivity, State, Strains, strains_of
from dlo_ros.rod.statics import impose, stresses
from dlo_ros.spline import FloatArray

RHO = 0.6  # spectral radius at infinity; above 0.8 the stiff stretch blows up (numerics.md)
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2
SMALLEST_STEP = 1e-6  # [s]
FIRST_STEP = 1e-3  # [s]
NEWTON_TOLERANCE = 1e-8  # of L
MAX_NEWTON = 12
# Error that one step may add, as a share of simulation.tolerance: measured on a falling cantilever.
STEP_SHARE = 0.03


def advance(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    scales: FloatArray | None = None,
) -> State:
    """Integrate to a stamp with steps that keep the error within simulation.tolerance.

    Args:
        stamp: [ns], not before the state's.
        scales: see `static_sensitivity`; given, the state's sensitivities are carried along.

    Raises:
        SimulationError: a step does not converge however small it is.
    """
    tolerance = STEP_SHARE * model.settings.simulation.tolerance * model.basis.length
    while state.stamp < stamp:
        limit = _next_stop(command, state.stamp, stamp)
        remaining = (limit - state.stamp) / NANOSECONDS
        proposal = state.next_step if state.next_step > 0.0 else FIRST_STEP
        pieces = max(1, int(np.ceil(remaining / proposal * 0.999)))
        h = remaining if pieces == 1 else remaining / pieces
        while True:
            reached = limit if h >= remaining else state.stamp + round(h * NANOSECONDS)
            reached = max(reached, state.stamp + 1)
            new, error = _step(model, boundary, state, command, reached, scales)
            if new is not None and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                break
            h = h / 4.0 if new is None else h * max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0))
            if h < SMALLEST_STEP:
                raise SimulationError(
                    f"the simulation does not converge at {state.stamp / NANOSECONDS:.3f} s even "
                    f"with steps of {SMALLEST_STEP:g} s; the imposed motion may jump or stretch "
                    "the DLO"
                )
        growth = 2.0 if error <= 0.0 else min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
        # A step cut short by a stop says nothing against a longer one.
        used = (new.stamp - state.stamp) / NANOSECONDS
        state = replace(new, next_step=max(used * growth, min(proposal, used * 10.0) * 0.2))
    return state


def _next_stop(command: Command, now: int, stamp: int) -> int:
    """The next instant at which the imposed motion has a corner, or the stamp itself."""
    elapsed = (now - command.stamp) / NANOSECONDS
    after = int(np.searchsorted(command.times, elapsed + 1e-9, side="right"))
    if after < len(command.times):
        corner = command.stamp + round(float(command.times[after]) * NANOSECONDS)
        if now < corner < stamp:
            return corner
    return stamp


def strain_rate_weights(h: float, last: float) -> tuple[float, float, float]:
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))


def _damped(model: RodModel, state: State, weights: tuple[float, float, float]) -> Stiffness:
    """Stiffness and rest strains of the incremental potential of one step."""
    stiff, t_r = model.stiffness, model.settings.damping.relaxation_time
    factor = 1.0 + t_r * weights[0]
    past = state.strains.combined(weights[1], state.previous, weights[2])
    return Stiffness(
        stretch=stiff.stretch * factor,
        stretch_rest=(stiff.stretch_rest - t_r * past.stretch) / factor,
        bend=stiff.bend * factor,
        bend_rest=(stiff.bend_rest - t_r * past.other[:, :2]) / factor,
        twist=stiff.twist * factor,
        twist_rest=(stiff.twist_rest - t_r * past.other[:, 2]) / factor,
    )


def _step(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    scales: FloatArray | None,
) -> tuple[State | None, float]:
    """One step; None where it did not converge. Also the estimated error of the step [m]."""
    h = (stamp - state.stamp) / NANOSECONDS
    weights = strain_rate_weights(h, state.last_step)
    stiff = _damped(model, state, weights)
    held = boundary.held(command, stamp)
    target, start, end = impose(state, boundary, held)
    q_star = state.q + h * state.velocity + h * h * (0.5 - BETA) * state.auxiliary
    v_star = state.velocity + h * (1.0 - GAMMA) * state.auxiliary
    lag = (ALPHA_F * state.acceleration - ALPHA_M * state.auxiliary) / (1.0 - ALPHA_F)
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    mass, spin, drag = model.mass, model.spin, model.drag
    still = np.zeros_like(drag)
    rhs = (
        model.load + _times(mass, spin, c_mass * q_star + lag)
        + _times(drag, still, c_drag * q_star - v_star)
    )  # fmt: skip
    q = q_star + h * h * BETA * state.auxiliary
    gap = boundary.pin_values(held, target)
    iterations, negative = solver.implicit_step(
        q, target, boundary.fixed, boundary.pins, gap, model.rule, stiff, state.reference, mass,
        spin, drag, still, c_mass, c_drag, rhs, model.basis.length, NEWTON_TOLERANCE, MAX_NEWTON,
    )  # fmt: skip
    # A negative pivot: the step has left the branch that a smaller one would follow.
    if iterations < 0 or (negative > 0 and not len(gap) and h > 10.0 * SMALLEST_STEP):
        return None, np.inf
    auxiliary = (q - q_star) / (BETA * h * h)
    acceleration = c_mass * (q - q_star) - lag
    velocity = v_star + c_drag * (q - q_star)
    free = ~boundary.fixed.reshape(-1, DOF)[:, :3].any(axis=1)
    jump = (auxiliary - state.auxiliary)[free, :3]
    error = abs(BETA - 1.0 / 6.0) * h * h * float(np.linalg.norm(jump, axis=1).mean())
    now = strains_of(q, model, state.reference)
    new = State(
        stamp, q, velocity, acceleration, auxiliary, transport(q, model.rule, state.reference),
        start, end, now, state.strains, h,
    )  # fmt: skip
    if scales is not None and state.sensitivity is not None:
        sensitivity = _sensitivity_step(
            model, boundary, state, new, stiff, weights, c_mass, c_drag, scales
        )
        new = replace(new, sensitivity=sensitivity)
    return new, error


def _sensitivity_step(
    model: RodModel,
    boundary: Boundary,
    state: State,
    new: State,
    stiff: Stiffness,
    weights: tuple[float, float, float],
    c_mass: float,
    c_drag: float,
    scales: FloatArray,
) -> Sensitivity:
    """Derivative of one converged step with respect to the logarithms of P parameters."""
    old = state.sensitivity
    assert old is not None
    h, t_r = new.last_step, model.settings.damping.relaxation_time
    mass, spin, drag = model.mass, model.spin, model.drag
    still = np.zeros_like(drag)
    band, diagonal, _, grad_s, grad_o = solver.linearise(
        new.q, boundary.fixed, model.rule, stiff, state.reference, mass, spin, drag, still,
        c_mass, c_drag,
    )  # fmt: skip
    q_star = old.q + h * old.velocity + h * h * (0.5 - BETA) * old.auxiliary
    v_star = old.velocity + h * (1.0 - GAMMA) * old.auxiliary
    lag = (ALPHA_F * old.acceleration - ALPHA_M * old.auxiliary) / (1.0 - ALPHA_F)

    rate = new.strains.combined(weights[0], state.strains, weights[1]).combined(
        1.0, state.previous, weights[2]
    )
    past = old.strains.combined(t_r * weights[1], old.previous, t_r * weights[2])
    a_stiff, a_mass, a_drag, a_time = scales.T
    base = model.stiffness
    modulus = np.concatenate([base.bend, base.twist[:, None]], axis=1)
    rest = np.concatenate([base.bend_rest, base.twist_rest[:, None]], axis=1)
    strain_s = new.strains.stretch - base.stretch_rest + t_r * rate.stretch
    strain_o = new.strains.other - rest + t_r * rate.other
    stress_s = base.stretch * (
        a_stiff[:, None] * strain_s + a_time[:, None] * t_r * rate.stretch + past.stretch
    )
    stress_o = modulus * (
        a_stiff[:, None, None] * strain_o + a_time[:, None, None] * t_r * rate.other + past.other
    )
    residual = solver.stress_forces(model.rule, grad_s, grad_o, stress_s, stress_o)
    inertia = _times(mass, spin, new.acceleration) - model.weight
    viscous = _times(drag, still, new.velocity)
    for a in range(len(scales)):
        residual[a] += (
            a_mass[a] * inertia
            + a_drag[a] * viscous
            - _times(mass, spin, c_mass * q_star[a] + lag[a])
            - _times(drag, still, c_drag * q_star[a] - v_star[a])
        ).ravel()
    rhs = -residual
    solver.back_substitute(band, diagonal, boundary.fixed, boundary.pins, rhs)
    dq = rhs.reshape(len(scales), -1, DOF)
    change = Strains(*solver.strain_sensitivities(model.rule, grad_s, grad_o, dq))
    return Sensitivity(
        dq,
        v_star + c_drag * (dq - q_star),
        c_mass * (dq - q_star) - lag,
        (dq - q_star) / (BETA * h * h),
        change,
        old.strains,
    )


def _times(scalar: FloatArray, spin: FloatArray, x: FloatArray) -> FloatArray:
    out = np.empty_like(x)
    solver.multiply_scalar(scalar, spin, x, out)
    return out


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
    rhs = model.load.ravel() - elastic[0] - _times(drag, still, state.velocity).ravel()
    band, diagonal = solver.factorised_mass(mass, spin, boundary.fixed)
    right = rhs[None].copy()
    solver.back_substitute(band, diagonal, boundary.fixed, boundary.pins, right)
    acceleration = right[0].reshape(state.q.shape)
    return replace(state, acceleration=acceleration, auxiliary=acceleration)
