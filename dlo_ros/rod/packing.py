"""Between the package's objects and the tuples of arrays that compiled code takes."""

from __future__ import annotations

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.rod import grips
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar import IN_PLANE, expand, flat_reference, reduce
from dlo_ros.rod.state import State
from dlo_ros.rod.stepping import Moving, System, Uniform
from dlo_ros.rod.tables import Reference
from dlo_ros.rod.variation import Varying


def system_of(model: RodModel, boundary: Boundary, *, flat: bool) -> System:
    """The rod's constants for compiled code, in the plane or in space; kept with the model."""
    cache: dict[tuple[Boundary, bool], System] = model.__dict__.setdefault("_systems", {})
    found = cache.get((boundary, flat))
    if found is None:
        found = cache[boundary, flat] = _system(model, boundary, flat)
    return found


def _system(model: RodModel, boundary: Boundary, flat: bool) -> System:
    n = model.basis.control_points
    fixed, pins, rows = boundary.fixed, boundary.pins, boundary.pin_rows
    if flat:
        columns = (4 * np.arange(n)[:, None] + np.array(IN_PLANE)).ravel()
        coordinates = [k for k in range(len(pins)) if k % 3 in IN_PLANE]
        fixed = fixed[columns]
        pins = np.ascontiguousarray(pins[coordinates][:, columns])
        rows = np.ascontiguousarray(rows[coordinates][:, columns])
    uniform = Uniform(model.line_mass, model.spin, model.drag, reduce(model.line_load, flat))
    return System(
        model.rule, model.stiffness, model.law, model.surroundings, model.mass, model.spin,
        model.drag, np.zeros_like(model.gram), reduce(model.load, flat), uniform, fixed, pins,
        rows, model.body.relaxation_time, model.basis.length,
        boundary.reach * model.body.lengthening,
    )  # fmt: skip


def true_command(model: RodModel, command: Command) -> Command:
    """What is truly imposed where `command` was commanded, by the model's effects."""
    if not model.effects:
        return command
    cache: dict[int, tuple[Command, Command]] = model.__dict__.setdefault("_commands", {})
    if id(command) not in cache:
        true = command
        for effect in model.effects:
            true = effect.impose(true)
        cache[id(command)] = command, true
    return cache[id(command)][1]


def imposed_of(model: RodModel, boundary: Boundary, command: Command) -> grips.Imposed:
    """A command for compiled code, with the length that slips through a grip meanwhile."""
    gain = np.zeros(len(command.times))
    if model.body.slip:
        gain = model.body.slip / (model.basis.length * model.body.lengthening) * command.progress
    return grips.Imposed(
        command.times, command.positions, command.rotations, command.velocities, boundary.kinds,
        gain,
    )  # fmt: skip


def moving_of(state: State, command: Command, *, flat: bool) -> Moving:
    """A state for compiled code."""
    return Moving(
        (state.stamp - command.stamp) / NANOSECONDS, state.last_step, state.next_step,
        reduce(state.q, flat), reduce(state.velocity, flat), reduce(state.acceleration, flat),
        reduce(state.auxiliary, flat), state.reference, state.frames, state.strains.stretch,
        state.previous.stretch, state.strains.other, state.previous.other, state.history,
    )  # fmt: skip


def varying_of(state: State, *, flat: bool) -> Varying:
    """A state's sensitivities for compiled code; none where it has none."""
    v = state.sensitivity
    assert v is not None
    return v._replace(
        q=reduce(v.q, flat), velocity=reduce(v.velocity, flat),
        acceleration=reduce(v.acceleration, flat), auxiliary=reduce(v.auxiliary, flat),
    )  # fmt: skip


def nothing_varies(state: State, count: int, *, flat: bool = False) -> Varying:
    """Sensitivities of a state that depends on none of `count` parameters."""
    n, nb = len(state.q), len(state.strains.other)
    zero = np.zeros((count, n, 2 if flat else 4))
    vectors, stretch = np.zeros((count, nb, 3)), np.zeros((count, nb))
    history = type(state.history)(*(np.zeros((count, *x.shape)) for x in state.history))
    frames = np.tile(state.frames, (count, 2, 1, 1))
    return Varying(
        zero, zero, zero, zero, Reference(vectors, vectors, vectors, stretch), frames, stretch,
        stretch, vectors, vectors, history,
    )  # fmt: skip


def state_of(
    model: RodModel, before: State, m: Moving, stamp: int, varying: Varying | None = None
) -> State:
    """What compiled code left, as a state in space."""
    flat = m.q.shape[1] == len(IN_PLANE)
    q = expand(m.q, before.q)
    if varying is not None:
        varying = varying._replace(
            q=expand(varying.q, q), velocity=expand(varying.velocity, q),
            acceleration=expand(varying.acceleration, q), auxiliary=expand(varying.auxiliary, q),
        )  # fmt: skip
    return State(
        stamp, q, expand(m.velocity, q), expand(m.acceleration, q), expand(m.auxiliary, q),
        flat_reference(model, q, before.reference) if flat else m.reference, m.frames,
        type(before.strains)(m.stretch, m.other),
        type(before.strains)(m.stretch_before, m.other_before), m.history, m.last_step,
        m.next_step, varying,
    )  # fmt: skip
