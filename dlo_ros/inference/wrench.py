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
from scipy.optimize import minimize

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.inference.thresholds import FEWEST_FRAMES
from dlo_ros.inference.variances import LONGEST_MEMORY, ar1_rate, ar1_spectral_density
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
    size = np.abs(predicted).max(axis=0) / weight / np.array([1.0] * 3 + [rod.length] * 3)
    active = size > 1e-6
    if not found.any() or not active.any():
        return None
    times = (np.asarray(stamps) - stamps[0]) / NANOSECONDS
    own = scatter(measured)
    lever = LEVER * rod.length
    if stated.force_std > 0.0:
        lever_std = stated.torque_std / stated.force_std or lever
        own = np.where(np.arange(6) < 3, stated.force_std, lever_std * stated.force_std)
    elif stated.torque_std > 0.0:
        own = np.where(np.arange(6) < 3, own, stated.torque_std)
    bias = stated.force_bias_std
    if bias > 0.0:
        both = stated.force_std > 0.0 and stated.torque_std > 0.0
        twist = bias * (stated.torque_std / stated.force_std if both else lever)
    else:  # not known: as large as what is measured
        force, torque = (np.sqrt(np.mean(values[found][:, p] ** 2)) for p in (_FORCE, _TORQUE))
        bias = max(float(force), weight)
        twist = max(float(torque), lever * bias)
    axes = _axes(measured, stamps)
    columns = [_placed(axes[:, :, i] * bias, None) for i in range(3)]
    columns += [_placed(None, axes[:, :, i] * twist) for i in range(3)]
    offsets = [True] * 6
    if stated.delay_std > 0.0 and len(times) > 2:
        columns.append(-stated.delay_std * np.gradient(predicted, times, axis=0))
    if stated.tool_mass_std > 0.0:
        columns += _tool(measured.end, axes, stamps, settings, commands, lever)
    columns += list(more)
    offsets += [False] * (len(columns) - 6)
    usual = weight * np.array([1.0] * 3 + [rod.length] * 3)
    white = np.maximum(own * float(np.sqrt(np.mean(share[found] ** 2))), LEAST_NOISE * usual)
    return WrenchField(
        name,
        (values - predicted)[found][:, active],
        derivative[found][:, active],
        np.stack(columns, axis=2)[found][:, active],
        np.array(offsets),
        (np.arange(6) >= 3)[active],
        white[active],
        usual[active],
    )


_FORCE, _TORQUE = slice(0, 3), slice(3, 6)


def _placed(force: FloatArray | None, torque: FloatArray | None) -> FloatArray:
    """A column (F, 6) of its halves; None is zero."""
    other = force if torque is None else torque
    assert other is not None
    zero = np.zeros_like(other)
    return np.hstack([zero if force is None else force, zero if torque is None else torque])


def _axes(measured: Wrenches, stamps: Sequence[int]) -> FloatArray:
    """The sensor's axes at the shapes, shape (F, 3, 3)."""
    nearest = np.searchsorted(measured.stamps, np.asarray(stamps))
    return measured.axes[np.clip(nearest, 0, len(measured.stamps) - 1)]


def _tool(
    end: str, axes: FloatArray, stamps: Sequence[int], settings: Settings,
    commands: Sequence[Command], lever: float,
) -> list[FloatArray]:  # fmt: skip
    """What a mass between sensor and DLO adds, tared at rest; none where it stays so."""
    motion, mass = Motion(list(commands)), settings.wrench.tool_mass_std
    side, places = round(SIDE * NANOSECONDS), []
    for stamp in stamps:
        command = motion.at(int(stamp))
        k = None if command is None else command.held(end, settings.rod.control_points)
        if command is None or k is None:
            return []
        a, b, c = (command.sample(int(stamp) + s)[0][k] for s in (-side, 0, side))
        places.append((a - 2.0 * b + c) / SIDE**2)
    weight = -np.array(settings.gravity)
    pull = np.array(places) + weight
    # Tared at rest, in the sensor's axes as they are at the first shape: a motion may begin there.
    tared = pull - axes @ (axes[0].T @ weight)
    if not np.abs(tared).max() > 1e-6:
        return []
    result = [mass * _placed(tared, None)]
    for i in range(3):
        turn = np.cross(axes[:, :, i], pull)
        turn -= axes @ (axes[0].T @ np.cross(axes[0, :, i], weight))
        result.append(mass * lever * _placed(None, turn))
    return result


def expected(field: WrenchField) -> FloatArray:
    """Information (P, P) of forces with their stated noise alone, before they are measured."""
    transformed = _Transformed.of(field)
    variance = np.broadcast_to(field.white**2, field.residual.shape)
    return transformed.information(variance, field).information


def wrench_information(
    field: WrenchField, offset: FloatArray, precision: FloatArray
) -> WrenchInformation:
    """Variances of one end's errors, and the information that its forces hold with them.

    Args:
        offset: expected logarithms minus those at which the derivatives are taken, shape (P,).
        precision: precision of that expectation, shape (P, P).
    """
    transformed = _Transformed.of(field)
    return transformed.information(transformed.fitted(offset, precision), field)


def from_change(field: WrenchField, variance: FloatArray) -> FloatArray:
    """Information (P, P) of how forces change, offsets being unknown altogether.

    Args:
        variance: see `WrenchInformation`.
    """
    factor = np.where(field.offsets, UNBIASED, 1.0)
    unknown = replace(field, nuisances=field.nuisances * factor)
    return _Transformed.of(unknown).information(variance, unknown).information


def from_mean(field: WrenchField, variance: FloatArray) -> FloatArray:
    """Information (P, P) of the mean of forces over time alone.

    Args:
        variance: see `WrenchInformation`.
    """
    changing = np.arange(len(variance))[:, None] > 0
    only = np.where(changing, UNUSED * variance, variance)
    return _Transformed.of(field).information(only, field).information


@dataclass(frozen=True)
class _Transformed:
    """A field in the cosine transform over time.

    Args:
        r, j, z: residual (F, C), derivative (F, C, P), nuisances (F, C, Q).
        frequency: radians per frame, shape (F,).
        kinds: 0 for forces, 1 for torques, shape (C,).
        white, scale: see `WrenchField`.
    """

    r: FloatArray
    j: FloatArray
    z: FloatArray
    frequency: FloatArray
    kinds: NDArray[np.int64]
    white: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, field: WrenchField) -> _Transformed:
        """Those of one end."""
        count = len(field.residual)
        r, j, z = (
            np.asarray(dct(x, axis=0, norm="ortho"), dtype=np.float64)
            for x in (field.residual, field.derivative, field.nuisances)
        )
        frequency = np.pi * np.arange(count) / count
        kinds = field.torque.astype(np.int64)
        return cls(r, j, z, frequency, kinds, field.white, field.scale)

    def variance(self, x: FloatArray) -> FloatArray:
        """Variances (F, C) of five numbers.

        ln of the white part over the stated one, of forces and torques; ln of the fading part over
        the weight, likewise; ln (1 - memory).
        """
        white = self.white**2 * np.exp(2.0 * x[:2])[self.kinds]
        fading = self.scale**2 * np.exp(2.0 * x[2:4])[self.kinds]
        memory = float(-np.expm1(x[4]))
        return np.asarray(white + ar1_spectral_density(memory, self.frequency)[:, None] * fading)

    def _slopes(self, x: FloatArray, by: FloatArray) -> FloatArray:
        """Derivatives by the five numbers, from those by the variances (F, C)."""
        memory = float(-np.expm1(x[4]))
        fading = self.scale**2 * np.exp(2.0 * x[2:4])[self.kinds]
        each = 2.0 * by * self.white**2 * np.exp(2.0 * x[:2])[self.kinds]
        other = 2.0 * by * ar1_spectral_density(memory, self.frequency)[:, None] * fading
        kinds = [self.kinds == k for k in (0, 1)]
        parts = [float(e[:, k].sum()) for e in (each, other) for k in kinds]
        return np.array([*parts, -0.5 * float(np.sum(ar1_rate(memory, self.frequency) @ other))])

    def fitted(self, offset: FloatArray, precision: FloatArray) -> FloatArray:
        """Variances that maximise the marginal likelihood."""
        q = self.z.shape[2]
        columns = np.concatenate([self.j, self.z], axis=2)
        prior = np.zeros((len(offset) + q,) * 2)
        prior[: len(offset), : len(offset)] = precision
        prior[len(offset) :, len(offset) :] = np.eye(q)
        mean = np.concatenate([offset, np.zeros(q)])
        few = len(self.r) < FEWEST_FRAMES

        flat = columns.reshape(-1, len(prior))
        r = self.r.ravel()

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            v = self.variance(x)
            weighted = flat / v.ravel()[:, None]
            lhs = prior + weighted.T @ flat
            rhs = prior @ mean + weighted.T @ r
            inverse = np.linalg.inv(lhs)
            best = inverse @ rhs
            value = float(np.sum(np.log(v)) + r**2 @ (1.0 / v.ravel()))
            value += float(np.linalg.slogdet(lhs)[1] - rhs @ best)
            left = (r - flat @ best) ** 2 + np.einsum("kp,kp->k", flat @ inverse, flat)
            slope = self._slopes(x, 0.5 * (1.0 / v - left.reshape(v.shape) / v**2))
            lacking = np.exp(2.0 * x[2:4]) / LACKING**2
            slope[2:4] += lacking
            return 0.5 * value + 0.5 * float(lacking.sum()), slope

        start = np.array([0.0, 0.0, np.log(1e-3), np.log(1e-3), np.log(0.1)])
        low = np.log(1e-7)
        bounds = [(0.0, 0.0 if few else 6.0)] * 2 + [(low, 0.0)] * 2
        bounds += [(float(np.log1p(-LONGEST_MEMORY)), float(np.log(0.9)))]
        found = minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
        )
        return self.variance(found.x)

    def information(self, v: FloatArray, field: WrenchField) -> WrenchInformation:
        """The information of the field with known variances."""
        p = self.j.shape[2]
        columns = np.concatenate([self.j, self.z], axis=2)
        lhs = np.einsum("fcp,fcq->pq", columns / v[:, :, None], columns, optimize=True)
        rhs = np.einsum("fcp,fc->p", columns, self.r / v)
        lhs[p:, p:] += np.eye(self.z.shape[2])
        back = np.linalg.solve(lhs[p:, p:], np.column_stack([lhs[p:, :p], rhs[p:]]))
        information = lhs[:p, :p] - lhs[:p, p:] @ back[:, :p]
        gradient = rhs[:p] - lhs[:p, p:] @ back[:, p]
        left = field.residual - field.nuisances @ back[:, p]
        size = np.sqrt(np.mean(left**2, axis=0))
        return WrenchInformation(0.5 * (information + information.T), gradient, size, v)
