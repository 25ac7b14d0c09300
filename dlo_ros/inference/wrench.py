# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured forces and torques of the grips beside predicted ones, with the sensor's errors.

Shapes tell ratios of E, mu and damping; every force is proportional to all of them together, so a
measured one tells their common scale. A sensor has an offset, a mass between itself and the DLO and
a clock of its own: these are columns with Gaussian priors, integrated out. What remains is white
noise and an error that dies out over time, with variances by marginal likelihood as those of shapes
(see `variances`), in the cosine transform over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.linalg import block_diag
from scipy.optimize import minimize

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.inference.autoregression import ar1_rate, ar1_spectral_density
from dlo_ros.inference.thresholds import FEWEST_FRAMES
from dlo_ros.inference.variances import LONGEST_MEMORY
from dlo_ros.inference.wrench_messages import LACKING, near, scatter, shaken
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LEVER = 0.1
"""Over L: distance at which a force sensor's errors make those of its torques where none are
stated, and a tool's centre of mass lies."""
LEAST_NOISE = 1e-6
"""Smallest standard deviation over the weight; below is rounding."""
UNBIASED = 1e3
"""Factor of the offset's prior with which the mean tells nothing."""
UNUSED = 1e12
"""Factor of the variance of what is not to count."""
SIDE = 0.01
"""Time to either side over which a grip's acceleration is taken [s]."""
TORQUE = np.arange(6) >= 3
"""Which components of a force and torque are those of the torque."""


@dataclass(frozen=True)
class WrenchField:
    """What was measured and predicted at one end, at F instants in C components.

    Args:
        name: recording and end, for people.
        residual: measured minus predicted [N; N m], shape (F, C).
        derivative: derivatives of the prediction by P logarithms, shape (F, C, P).
        nuisances: columns in prior standard deviations, shape (F, C, Q).
        offsets: whether a column is a constant offset, shape (Q,).
        torque: whether a component is a torque, shape (C,).
        white: stated noise of a component [N; N m], shape (C,).
        scale: weight, and weight times length, of each component [N; N m], shape (C,).
    """

    name: str
    residual: FloatArray
    derivative: FloatArray
    nuisances: FloatArray
    offsets: NDArray[np.bool_]
    torque: NDArray[np.bool_]
    white: FloatArray
    scale: FloatArray


@dataclass(frozen=True)
class WrenchInformation:
    """Information of the forces at one end on P logarithms, nuisances integrated out.

    Args:
        information: shape (P, P).
        gradient: information times the step to the logarithms that fit best, shape (P,).
        left: root mean square of what is left in each component [N; N m], shape (C,).
        variance: variance of the errors, in the cosine transform over time, shape (F, C).
    """

    information: FloatArray
    gradient: FloatArray
    left: FloatArray
    variance: FloatArray


def wrench_field(
    name: str,
    measured: Wrenches,
    stamps: Sequence[int],
    predicted: FloatArray,
    derivative: FloatArray,
    settings: Settings,
    commands: Sequence[Command],
    more: Sequence[FloatArray] = (),
) -> WrenchField | None:
    """One end of one recording; None where nothing was measured near its shapes.

    Args:
        stamps: stamps of the shapes [ns], F of them.
        predicted: force and torque of the grip at these, shape (F, 6).
        derivative: derivatives of the predicted forces by P logarithms, shape (F, 6, P).
        settings: settings of the DLO and its sensors.
        commands: commands that led the grips.
        more: further columns in prior standard deviations, shape (F, 6) each.
    """
    values, share, found = near(measured, stamps)
    found = found & ~shaken(measured, stamps)
    rod, stated = settings.rod, settings.wrench
    weight = rod.linear_density * rod.length * max(float(np.linalg.norm(settings.gravity)), 1e-9)
    usual = weight * np.where(TORQUE, rod.length, 1.0)
    active = np.abs(predicted).max(axis=0) > 1e-6 * usual
    if not found.any() or not active.any():
        return None
    times = (np.asarray(stamps) - stamps[0]) / NANOSECONDS
    lever = LEVER * rod.length
    torque_std = stated.torque_std or lever * stated.force_std
    own = scatter(measured)
    own = np.where(TORQUE, torque_std or own, stated.force_std or own)
    bias = stated.force_bias_std
    if bias > 0.0:
        both = stated.force_std > 0.0 and stated.torque_std > 0.0
        twist = bias * (stated.torque_std / stated.force_std if both else lever)
    else:  # not known: as large as what is measured
        force, torque = (np.sqrt(np.mean(values[found][:, p] ** 2)) for p in (~TORQUE, TORQUE))
        bias = max(float(force), weight)
        twist = max(float(torque), lever * bias)
    axes = _axes(measured, stamps)
    constant = np.zeros((len(stamps), 6, 6))
    constant[:, :3, :3], constant[:, 3:, 3:] = bias * axes, twist * axes
    columns = [constant]
    if stated.delay_std > 0.0 and len(times) > 2:
        columns.append(-stated.delay_std * np.gradient(predicted, times, axis=0)[:, :, None])
    if stated.tool_mass_std > 0.0:
        columns.append(_tool(measured.end, axes, stamps, settings, commands, lever))
    nuisances = np.concatenate([*columns, *(c[:, :, None] for c in more)], axis=2)
    white = np.maximum(own * float(np.sqrt(np.mean(share[found] ** 2))), LEAST_NOISE * usual)
    return WrenchField(
        name,
        (values - predicted)[found][:, active],
        derivative[found][:, active],
        nuisances[found][:, active],
        np.arange(nuisances.shape[2]) < 6,
        TORQUE[active],
        white[active],
        usual[active],
    )


def _axes(measured: Wrenches, stamps: Sequence[int]) -> FloatArray:
    """The sensor's axes at the shapes, shape (F, 3, 3)."""
    nearest = np.searchsorted(measured.stamps, np.asarray(stamps))
    return measured.axes[np.clip(nearest, 0, len(measured.stamps) - 1)]


def _tool(
    end: str, axes: FloatArray, stamps: Sequence[int], settings: Settings,
    commands: Sequence[Command], lever: float,
) -> FloatArray:  # fmt: skip
    """Columns of what a mass between sensor and DLO adds to a sensor that was tared at rest.

    They are its weight and inertia, and the torque of these by its place along each axis, shape
    (F, 6, 4); (F, 6, 0) where it adds nothing.
    """
    motion, mass = Motion(list(commands)), settings.wrench.tool_mass_std
    side, places, none = round(SIDE * NANOSECONDS), [], np.zeros((len(stamps), 6, 0))
    for stamp in stamps:
        command = motion.at(int(stamp))
        k = None if command is None else command.held(end, settings.rod.control_points)
        if command is None or k is None:
            return none
        a, b, c = (command.sample(int(stamp) + s)[0][k] for s in (-side, 0, side))
        places.append((a - 2.0 * b + c) / SIDE**2)
    weight = -np.array(settings.gravity)
    pull = np.array(places) + weight
    # Tared at rest, in the sensor's axes as they are at the first shape: a motion may begin there.
    tared = pull - axes @ (axes[0].T @ weight)
    if not np.abs(tared).max() > 1e-6:
        return none
    turn = np.cross(axes, pull[:, :, None], axis=1)
    turn -= axes @ (axes[0].T @ np.cross(axes[0], weight[:, None], axis=0))
    result = np.zeros((len(stamps), 6, 4))
    result[:, :3, 0], result[:, 3:, 1:] = mass * tared, mass * lever * turn
    return result


def expected(field: WrenchField) -> FloatArray:
    """Information (P, P) of forces with their stated noise alone, before they are measured."""
    variance = np.broadcast_to(field.white**2, field.residual.shape)
    return _with_variance(field, variance).information


def wrench_information(
    field: WrenchField, offset: FloatArray, precision: FloatArray
) -> WrenchInformation:
    """Variances of one end's errors, and the information that its forces hold with them.

    Args:
        offset: expected logarithms minus those at which the derivatives are taken, shape (P,).
        precision: precision of that expectation, shape (P, P).
    """
    return _with_variance(field, _fitted_variance(field, offset, precision))


def from_change(field: WrenchField, variance: FloatArray) -> FloatArray:
    """Information (P, P) of how forces change, offsets being unknown altogether.

    Args:
        variance: see `WrenchInformation`.
    """
    factor = np.where(field.offsets, UNBIASED, 1.0)
    unknown = replace(field, nuisances=field.nuisances * factor)
    return _with_variance(unknown, variance).information


def from_mean(field: WrenchField, variance: FloatArray) -> FloatArray:
    """Information (P, P) of the mean of forces over time alone.

    Args:
        variance: see `WrenchInformation`.
    """
    changing = np.arange(len(variance))[:, None] > 0
    return _with_variance(field, np.where(changing, UNUSED * variance, variance)).information


def _transformed(field: WrenchField) -> tuple[FloatArray, FloatArray]:
    """Residual (F, C), and derivatives beside nuisances (F, C, P + Q), transformed over time."""
    columns = np.concatenate([field.derivative, field.nuisances], axis=2)
    return dct(field.residual, axis=0, norm="ortho"), dct(columns, axis=0, norm="ortho")


def _fitted_variance(field: WrenchField, offset: FloatArray, precision: FloatArray) -> FloatArray:
    """Variances (F, C) that maximise the marginal likelihood.

    They follow from five numbers: ln of the white part over the stated one, of forces and torques;
    ln of the fading part over the weight, likewise; ln (1 - memory).
    """
    residual, columns = _transformed(field)
    r, flat = residual.ravel(), columns.reshape(residual.size, -1)
    prior = block_diag(precision, np.eye(field.nuisances.shape[2]))
    pull = prior[:, : len(offset)] @ offset
    frequency = np.pi * np.arange(len(residual)) / len(residual)
    kind, kinds = field.torque.astype(np.int64), np.array([~field.torque, field.torque])

    def parts(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        white, fading = np.exp(2.0 * x[:2])[kind], np.exp(2.0 * x[2:4])[kind]
        density = ar1_spectral_density(float(-np.expm1(x[4])), frequency)
        return field.white**2 * white, np.outer(density, field.scale**2 * fading)

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        white, fading = parts(x)
        v = white + fading
        weighted = flat / v.ravel()[:, None]
        lhs = prior + weighted.T @ flat
        rhs = pull + weighted.T @ r
        inverse = np.linalg.inv(lhs)
        best = inverse @ rhs
        value = float(np.sum(np.log(v)) + r**2 @ (1.0 / v.ravel()))
        value += float(np.linalg.slogdet(lhs)[1] - rhs @ best)
        left = (r - flat @ best) ** 2 + np.einsum("kp,kp->k", flat @ inverse, flat)
        slope = 1.0 / v - left.reshape(v.shape) / v**2  # twice that by the variances
        forgotten = ar1_rate(float(-np.expm1(x[4])), frequency) @ (slope * fading)
        lacking = np.exp(2.0 * x[2:4]) / LACKING**2
        return 0.5 * value + 0.5 * float(lacking.sum()), np.array(
            [
                *kinds @ (slope * white).sum(axis=0),
                *kinds @ (slope * fading).sum(axis=0) + lacking,
                -0.5 * float(np.sum(forgotten)),
            ]
        )

    start = np.array([0.0, 0.0, np.log(1e-3), np.log(1e-3), np.log(0.1)])
    low = np.log(1e-7)
    bounds = [(0.0, 0.0 if len(residual) < FEWEST_FRAMES else 6.0)] * 2 + [(low, 0.0)] * 2
    bounds += [(float(np.log1p(-LONGEST_MEMORY)), float(np.log(0.9)))]
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
    )
    return np.add(*parts(found.x))


def _with_variance(field: WrenchField, v: FloatArray) -> WrenchInformation:
    """The information of a field whose errors have known variances (F, C)."""
    residual, columns = _transformed(field)
    p, q = field.derivative.shape[2], field.nuisances.shape[2]
    lhs = np.einsum("fcp,fcq->pq", columns / v[:, :, None], columns, optimize=True)
    rhs = np.einsum("fcp,fc->p", columns, residual / v)
    lhs[p:, p:] += np.eye(q)
    back = np.linalg.solve(lhs[p:, p:], np.column_stack([lhs[p:, :p], rhs[p:]]))
    information = lhs[:p, :p] - lhs[:p, p:] @ back[:, :p]
    gradient = rhs[:p] - lhs[:p, p:] @ back[:, p]
    left = np.sqrt(np.mean((field.residual - field.nuisances @ back[:, p]) ** 2, axis=0))
    return WrenchInformation(0.5 * (information + information.T), gradient, left, v)
