# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A clamped rod plucked in its first three modes at once swings at the beam's frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, OURS, Result, canvas, main, save
from scene import NO_DAMPING, WEIGHTLESS, clamp
from scipy.optimize import brentq, least_squares

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = 21
STEP, DURATION = 4e-3, 2.4  # [s]
AMPLITUDE = 1e-3  # of L, of every mode


@dataclass(frozen=True)
class Frequencies(Result):
    """Instants [s], modal amplitudes over L (instants, 3), frequencies [Hz]: found and exact."""

    times: FloatArray
    amplitudes: FloatArray
    found: FloatArray
    exact: FloatArray


def modes(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roots beta_i L of the clamped-free beam and its mode shapes at x = u / L, shape (m, 3)."""
    roots = np.array([brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), *g, xtol=1e-14)
                      for g in ((1.0, 3.0), (4.0, 6.0), (7.0, 9.0))])  # fmt: skip
    ratio = (np.cos(roots) + np.cosh(roots)) / (np.sin(roots) + np.sinh(roots))
    b = np.outer(x, roots)
    return roots, 0.5 * (np.cosh(b) - np.cos(b) - ratio * (np.sinh(b) - np.sin(b)))


def run() -> Frequencies:
    """Release the rod and fit a cosine to every modal amplitude."""
    rod = replace(WEIGHTLESS.rod, control_points=24)
    settings = replace(WEIGHTLESS, rod=rod, damping=NO_DAMPING)
    control = replace(settings.simulation, tolerance=1e-6, start="observed")
    settings = replace(settings, simulation=control)
    basis = SplineBasis(rod.control_points, rod.length)
    u, weight = basis.quadrature()
    roots, shapes = modes(u / rod.length)
    shape = np.zeros((rod.control_points, 4))
    shape[:, 0] = basis.greville
    shape[:, 2] = basis.fit(u, AMPLITUDE * rod.length * shapes.sum(axis=1, keepdims=True))[:, 0]
    command = replace(clamp(), control_points=rod.control_points)
    simulation = Simulation(settings, Motion([command]), spans=SPANS)
    simulation.start([Observation(0, shape)])
    times = np.arange(0.0, DURATION, STEP)
    project = np.linalg.solve(shapes.T @ (weight[:, None] * shapes), shapes.T * weight)
    amplitudes = np.empty((len(times), 3))
    for k, t in enumerate(times):
        points = simulation.advance(round(t * NANOSECONDS)).control_points
        amplitudes[k] = project @ basis.evaluate(points, u)[:, 2] / rod.length
    exact = (roots / rod.length) ** 2 * np.sqrt(rod.bending_stiffness / rod.linear_density)
    exact /= 2.0 * np.pi
    found = np.array([frequency(times, amplitudes[:, k], exact[k]) for k in range(3)])
    errors = np.abs(found / exact - 1.0)
    summary = "frequencies " + ", ".join(
        f"{f:.4f} Hz (beam {e:.4f}, {d:.0e})" for f, e, d in zip(found, exact, errors, strict=True)
    )
    return Frequencies(summary, float(errors.max()), times, amplitudes, found, exact)


def frequency(times: FloatArray, x: FloatArray, guess: float) -> float:
    """Frequency [Hz] of the decaying cosine that fits x(t) best."""

    def misfit(p: FloatArray) -> FloatArray:
        phase = 2.0 * np.pi * p[0] * times
        wave = np.exp(-p[3] * times) * (p[1] * np.cos(phase) + p[2] * np.sin(phase))
        misfits: FloatArray = (wave - x) / AMPLITUDE
        return misfits

    return float(
        least_squares(misfit, (guess, AMPLITUDE, 0.0, 0.0), x_scale=(1, 1e-3, 1e-3, 1)).x[0]
    )


def plot(result: Frequencies, path: Path) -> None:
    """How every modal amplitude swings, beside a cosine of the exact frequency."""
    for axes in (panels := canvas(3)):
        k = panels.index(axes)
        part = result.times < 2.4 / result.exact[k]
        t = result.times[part]
        axes.plot(t, 1e3 * result.amplitudes[part, k], color=OURS, label="spline rod")
        dots = np.linspace(0.0, t[-1], 40)
        swing = 1e3 * AMPLITUDE * np.cos(2.0 * np.pi * result.exact[k] * dots)
        axes.plot(dots, swing, ".", color=EXACT, label="beam theory")
        axes.set(
            xlabel="time [s]", ylim=(-1.1, 1.6), title=f"mode {k + 1}: {result.found[k]:.3f} Hz"
        )
    panels[0].set(ylabel="modal amplitude [L / 1000]")
    panels[0].legend()
    save(panels[0], path, "First three frequencies of a clamped rod")


if __name__ == "__main__":
    main(run, plot)
