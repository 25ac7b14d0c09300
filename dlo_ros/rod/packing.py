# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Conversion between the package's objects and the tuples of arrays of compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.effects import Effect
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.boundary.imposed_motion import KEPT, Boundary
from dlo_ros.rod.elements.rod_tables import (
    ConstitutiveLaw,
    InternalVariables,
    Reference,
    Stiffness,
)
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar_model import IN_PLANE, expand, flat_reference, reduce
from dlo_ros.rod.sensitivity.sensitive_equilibrium import RestState
from dlo_ros.rod.sensitivity.sensitivity_state import LINEAR, Rates, SensitivityState
from dlo_ros.rod.solve.equation_system import System, Uniform
from dlo_ros.rod.solve.integrator_state import LAST, NEXT, IntegratorState
from dlo_ros.rod.state import State, Strains
from dlo_ros.rod_settings import kink_curvature
from dlo_ros.spline import FloatArray

IMPOSED_KEPT = 128
"""Commands that are kept with a command: for each variant those that its effects lead through."""


def parts_of(model: RodModel, *, flat: bool) -> System:
    """The rod's numbers as one variant, without the leading axis that compiled code expects.

    They are those of a rod that nothing holds, whose reach is that of a clamp of 1 m: see `held`.
    """
    uniform = Uniform(
        model.line_mass, model.spin, model.drag, reduce(model.line_load, flat), model.hinge,
        kink_curvature(model.body),
    )  # fmt: skip
    nowhere = np.zeros((0, 0))
    return System(
        model.rule, model.stiffness, model.law, model.surroundings, model.mass, model.spin,
        model.drag, reduce(model.load, flat), uniform, np.array(model.body.relaxation_time),
        np.array(model.body.lengthening), np.zeros(0), nowhere, nowhere, model.basis.length,
    )  # fmt: skip


def held(numbers: System, model: RodModel, boundary: Boundary, *, flat: bool) -> System:
    """The variants of a rod, held as a boundary says.

    Args:
        numbers: the variants of the rod that nothing holds.
        model: the rod.
    """
    fixed, pins, rows = _held(boundary, flat)
    return numbers._replace(
        rule=model.rule, reach=boundary.reach * numbers.reach, fixed=fixed, pins=pins,
        pin_rows=rows,
    )  # fmt: skip


@lru_cache(maxsize=KEPT)
def _held(boundary: Boundary, flat: bool) -> tuple[np.ndarray, FloatArray, FloatArray]:
    """The numbers of a rod that are imposed, and the rows of its pins, see `Boundary`."""
    fixed, pins, rows = boundary.fixed, boundary.pins, boundary.pin_rows
    if not flat:
        return fixed, pins, rows
    columns = (4 * np.arange(len(fixed) // 4)[:, None] + np.array(IN_PLANE)).ravel()
    coordinates = [k for k in range(len(pins)) if k % 3 in IN_PLANE]
    pinned, all_rows = (np.ascontiguousarray(x[coordinates][:, columns]) for x in (pins, rows))
    return fixed[columns], pinned, all_rows


def stacked(parts: Sequence[System]) -> System:
    """Variants of a rod for compiled code; the first is the rod itself."""
    one = parts[0]
    around = _stack([p.around for p in parts])._replace(
        span=one.around.span, b=one.around.b, weight=one.around.weight
    )
    result: System = _stack(parts)
    return result._replace(
        rule=one.rule, around=around, fixed=one.fixed, pins=one.pins, pin_rows=one.pin_rows,
        length=one.length,
    )  # fmt: skip


def stacked_imposed(commands: Sequence[conditions.Imposed]) -> conditions.Imposed:
    """Variants of an imposed motion for compiled code."""
    result: conditions.Imposed = _stack(commands)
    return result._replace(kinds=commands[0].kinds)


def _stack(items: Any) -> Any:
    """Tuples of arrays and numbers as one such tuple, whose arrays have a leading axis."""
    one = items[0]
    if isinstance(one, tuple):
        return type(one)(*(_stack(parts) for parts in zip(*items, strict=True)))
    result = np.empty((len(items), *np.shape(one)))
    result[:] = one
    for k, item in enumerate(items):
        if item is not one:
            result[k] = item
    return result


def true_command(model: RodModel, command: Command) -> Command:
    """The command that is truly imposed where `command` was commanded, by the model's effects."""
    imposing = tuple(e for e in model.effects if type(e).impose is not Effect.impose)
    if not imposing:
        return command
    kept: dict[tuple[Effect, ...], Command] = command.__dict__.setdefault("_imposed", {})
    true = kept.get(imposing)
    if true is None:
        if len(kept) >= IMPOSED_KEPT:
            kept.clear()
        true = command
        for count, effect in enumerate(imposing, 1):  # variants have the first effects in common
            before, true = true, kept.get(imposing[:count])
            if true is None:
                true = kept[imposing[:count]] = effect.impose(before)
    return true


def imposed_of(
    model: RodModel, boundary: Boundary, command: Command, true: Command
) -> conditions.Imposed:
    """The motion truly imposed, for compiled code, with the length that slips in meanwhile.

    Args:
        command: command as it was given, effects not applied; over its path the grip slips.
        true: the same with effects applied.
    """
    imposed, body = boundary.imposed(true), model.body
    if not body.slip:
        return imposed
    share = body.slip / (model.basis.length * body.lengthening)
    if body.slip_step is None:
        # An effect may add points, between which the command progresses as before.
        return imposed._replace(gain=share * np.interp(true.times, command.times, command.progress))
    onset, duration = body.slip_step
    return imposed._replace(slip_step=np.array([share, onset + command.began_at, duration]))


def growth_at(
    model: RodModel, boundary: Boundary, command: Command, times: FloatArray
) -> FloatArray:
    """Free length over the model's at S times, see `equation_system.growth`.

    Args:
        command: command that the rod follows, effects not applied.
        times: times from the command's start [s], shape (S,).

    Returns:
        Shape (S,).
    """
    if not model.body.slip:
        return np.ones(len(times))
    imposed = imposed_of(model, boundary, command, true_command(model, command))
    share, onset, duration = imposed.slip_step
    s = np.clip((times - onset) / duration, 0.0, 1.0)
    return np.asarray(
        1.0 + share * s * s * (3.0 - 2.0 * s) + np.interp(times, imposed.times, imposed.gain)
    )


def moving_of(state: State, command: Command, *, flat: bool) -> IntegratorState:
    """A copy of a state for compiled code."""
    clock = [(state.stamp - command.stamp) / NANOSECONDS, state.last_step, state.next_step]
    return IntegratorState(
        np.array(clock), reduce(state.q, flat), reduce(state.velocity, flat),
        reduce(state.acceleration, flat), reduce(state.auxiliary, flat),
        Reference(*(x.copy() for x in state.reference)), state.frames.copy(),
        state.strains.stretch.copy(), state.previous.stretch.copy(), state.strains.other.copy(),
        state.previous.other.copy(), InternalVariables(*(x.copy() for x in state.internal)),
    )  # fmt: skip


def rest_state_of(state: State) -> RestState:
    """A copy of a state at rest for compiled code."""
    strains = state.strains
    return RestState(
        state.q.copy(), Reference(*(x.copy() for x in state.reference)), state.frames.copy(),
        strains.stretch.copy(), strains.other.copy(),
        InternalVariables(*(x.copy() for x in state.internal)),
    )  # fmt: skip


def unchanged(state: State, count: int) -> RestState:
    """Zero derivatives of a state at rest by `count` parameters."""
    n, nb = len(state.q), len(state.strains.other)
    zeros, vectors = np.zeros, (count, nb, 3)
    return RestState(
        zeros((count, n, 4)),
        Reference(zeros(vectors), zeros(vectors), zeros(vectors), zeros((count, nb))),
        zeros((count, 2, *state.frames.shape)), zeros((count, nb)), zeros(vectors),
        InternalVariables(*(zeros((count, *x.shape)) for x in state.internal)),
    )  # fmt: skip


def varying_of(state: State, *, flat: bool) -> SensitivityState:
    """A copy of a state's sensitivities for compiled code; their parameters are not in it."""
    v = state.sensitivity
    assert v is not None
    return SensitivityState(
        v.step, v.moves, v.rates, v.kind, reduce(v.q, flat),
        reduce(v.velocity, flat), reduce(v.acceleration, flat), reduce(v.auxiliary, flat),
        Reference(*(x.copy() for x in v.reference)), v.frames.copy(), v.stretch.copy(),
        v.stretch_before.copy(), v.other.copy(), v.other_before.copy(),
        InternalVariables(*(x.copy() for x in v.internal)),
    )  # fmt: skip


def nothing_varies(state: State, count: int, *, flat: bool = False) -> SensitivityState:
    """Zero sensitivities of a state to `count` parameters; `flat`: those of a planar rod."""
    n, nb, d = len(state.q), len(state.strains.other), 2 if flat else 4

    def zeros(*shape: int) -> FloatArray:
        return np.zeros((count, *shape))

    return SensitivityState(
        zeros(), zeros(), _no_rates(n, nb, d, count), LINEAR, zeros(n, d), zeros(n, d),
        zeros(n, d), zeros(n, d), Reference(zeros(nb, 3), zeros(nb, 3), zeros(nb, 3), zeros(nb)),
        state.frames[None, None].repeat(2, axis=1).repeat(count, axis=0), zeros(nb), zeros(nb),
        zeros(nb, 3), zeros(nb, 3), InternalVariables(*(zeros(*x.shape) for x in state.internal)),
    )  # fmt: skip


def _no_rates(n: int, nb: int, d: int, count: int) -> Rates:
    """Zero derivatives of the numbers of a rod with n control points and nb quadrature points."""

    def zeros(*shape: int) -> FloatArray:
        return np.zeros((count, *shape))

    stiffness = Stiffness(zeros(nb), zeros(nb), zeros(nb, 3), zeros(nb, 2), zeros(nb), zeros(nb))
    law = ConstitutiveLaw._make(
        (zeros(), zeros(nb), zeros(nb), zeros(), zeros(), zeros(), zeros(), zeros(nb))
    )
    return Rates(
        stiffness, zeros(n, 4), zeros(n, 4), zeros(n, 4), zeros(n, d), zeros(), law, zeros(),
        zeros(), zeros(), zeros(),
    )  # fmt: skip


def insensitive(state: State, count: int) -> State:
    """The state with zero sensitivities to `count` parameters; without sensitivities where 0."""
    return replace(state, sensitivity=nothing_varies(state, count) if count else None)


def varying_in_space(varying: SensitivityState, q: FloatArray) -> SensitivityState:
    """Sensitivities of a planar rod as those of one in space at q (n, 4)."""
    moving = varying.q, varying.velocity, varying.acceleration, varying.auxiliary
    d_q, velocity, acceleration, auxiliary = (expand(x, q) for x in moving)
    return varying._replace(
        q=d_q, velocity=velocity, acceleration=acceleration, auxiliary=auxiliary
    )


def state_of(
    model: RodModel, before: State, m: IntegratorState, stamp: int,
    varying: SensitivityState | None = None,
) -> State:  # fmt: skip
    """The state in space that compiled code has reached."""
    flat = m.q.shape[1] == len(IN_PLANE)
    q, velocity, acceleration, auxiliary = (
        expand(x, before.q) for x in (m.q, m.velocity, m.acceleration, m.auxiliary)
    )
    if varying is not None and flat:
        varying = varying_in_space(varying, q)
    return State(
        stamp, q, velocity, acceleration, auxiliary,
        flat_reference(model, q, before.reference) if flat else m.reference, m.frames,
        Strains(m.stretch, m.other), Strains(m.stretch_before, m.other_before), m.internal,
        float(m.clock[LAST]), float(m.clock[NEXT]), varying,
    )  # fmt: skip
