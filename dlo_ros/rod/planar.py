"""The rod in its plane: the same model with x and z only, where nothing leaves the plane y = 0.

A single camera watches the DLO in that plane, so most runs are of this kind; they cost a quarter.
States keep their spatial form: they are reduced for the compiled code and expanded afterwards.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.command import END, START, Command
from dlo_ros.rod import engine, grips
from dlo_ros.rod.boundary import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import State
from dlo_ros.rod.tables import Reference
from dlo_ros.spline import FloatArray

IN_PLANE = [0, 2]  # x and z of x, y, z, theta
ROUNDING = 1e-12


def in_plane(model: RodModel, state: State, command: Command) -> bool:
    """Whether motion, rest strains and loads all lie in the plane y = 0."""
    off = (state.q, state.velocity, state.acceleration, state.auxiliary)
    if any(np.abs(x[:, [1, 3]]).max() > ROUNDING * model.basis.length for x in off):
        return False
    if np.abs(state.reference.director[:, 1] - 1.0).max() > 1e-9:
        return False
    directors = state.frames[:, grips.DIRECTOR : grips.BODY]
    if np.abs(directors[:, 1] - 1.0).max() > 1e-9:
        return False
    stiff = model.stiffness
    if stiff.bend_rest[:, 1].any() or stiff.twist_rest.any() or model.load[:, 1].any():
        return False
    if np.abs(command.positions[:, :, 1]).max(initial=0.0) > ROUNDING * model.basis.length:
        return False
    turned = [k for k, name in enumerate(command.names) if name in (START, END)]
    return not turned or bool(np.abs(command.rotations[:, turned][:, :, [0, 2]]).max() < 1e-9)


def reduce(x: FloatArray, flat: bool) -> FloatArray:
    """Columns x and z of an array (..., n, 4) for the plane, all of them else; always a copy."""
    return np.ascontiguousarray(x[..., IN_PLANE]) if flat else np.array(x)


def expand(x: FloatArray, like: FloatArray) -> FloatArray:
    """An array (..., n, 2) with zeros for y and theta, or an array (..., n, 4) as it is."""
    if x.shape[-1] == like.shape[-1]:
        return x
    result = np.zeros((*x.shape[:-1], 4))
    result[..., IN_PLANE] = x
    return result


def flat_reference(model: RodModel, q: FloatArray, before: Reference) -> Reference:
    """The reference frame at a planar configuration (n, 4): its first director stays y."""
    p = model.basis_slope @ q[:, :3]
    s = model.basis_curvature @ q[:, :3]
    speed = np.linalg.norm(p, axis=1, keepdims=True)
    tangent = p / speed
    rate = (s - tangent * np.sum(tangent * s, axis=1, keepdims=True)) / speed
    return Reference(tangent, rate, before.director, before.twist)


def system_of(model: RodModel, boundary: Boundary, *, flat: bool) -> engine.System:
    """The rod's constants for compiled code, in the plane or in space."""
    gram = model.gram
    fixed, pins, rows = boundary.fixed, boundary.pins, boundary.pin_rows
    weight, load = model.weight, model.load
    if flat:
        n = model.basis.control_points
        columns = (4 * np.arange(n)[:, None] + np.array(IN_PLANE)).ravel()
        coordinates = [k for k in range(len(pins)) if k % 3 in IN_PLANE]
        fixed = fixed[columns]
        pins = np.ascontiguousarray(pins[coordinates][:, columns])
        rows = np.ascontiguousarray(rows[coordinates][:, columns])
        weight, load = reduce(weight, flat), reduce(load, flat)
    return engine.System(
        model.rule, model.stiffness, model.mass, model.spin, model.drag, np.zeros_like(gram),
        weight, load, fixed, pins, rows, model.settings.damping.relaxation_time,
        model.basis.length, boundary.reach,
    )  # fmt: skip
