# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which effect, where, and how its size is scaled: one function for each name.

Each takes a generator of random numbers and a `Scene` and returns a `Drawn`: the effect's values as
a function of one strength, and the range of strengths that is physically plausible.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from challenge.manipulations import DURATION

Values = dict[str, float | list[float]]


@dataclass(frozen=True)
class Scene:
    """What is known of the recordings without any effect.

    Args:
        length, weight: L [m], weight per length [N/m].
        curvature: 90th percentile of the largest curvature of each picture [1/m].
        relaxation_time, air_drag: damping of the rope.
        mass: mass of the rope [kg].
        clamps_start, clamps_end: whether any recording has that clamp.
        shapes: true shapes of each recording, nodes in time [m], each (T, N + 1, 2).
    """

    length: float
    weight: float
    curvature: float
    air_drag: float
    relaxation_time: float
    mass: float
    clamps_start: bool
    clamps_end: bool
    shapes: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Drawn:
    """An effect of open strength.

    Args:
        values: the effect's keys for a strength.
        lower, upper: range of the strength.
    """

    values: Callable[[float], Values]
    lower: float
    upper: float


Draw = Callable[[np.random.Generator, Scene], Drawn | None]


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def intrinsic_curvature(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign, kind = _sign(rng), rng.integers(3)
    if kind == 0:
        return Drawn(lambda s: {"curvature": sign * s}, 0.02, 1.5 / scene.length)
    if kind == 1:
        position = float(rng.uniform(0.2, 0.8) * scene.length)
        return Drawn(lambda s: {"kink": sign * s, "position": position}, 0.01, 1.0)
    pattern = rng.uniform(-1.0, 1.0, rng.integers(3, 6))
    pattern /= np.abs(pattern).max()
    return Drawn(lambda s: {"curvature": (s * pattern).tolist()}, 0.02, 3.0 / scene.length)


def clamp_angle(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    ends = [k for k, has in (("start", scene.clamps_start), ("end", scene.clamps_end)) if has]
    if not ends:
        return None
    end, sign = ends[rng.integers(len(ends))], _sign(rng)
    return Drawn(lambda s: {end: sign * s}, 2e-3, 0.4)


def clamp_compliance(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    ends = [k for k, has in (("start", scene.clamps_start), ("end", scene.clamps_end)) if has]
    if not ends:
        return None
    end, weak = ends[rng.integers(len(ends))], 1.0 / (scene.weight * scene.length**2)
    return Drawn(lambda s: {end: s * weak}, 5e-3, 0.8)


def clamp_offset(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    ends = [k for k, has in (("start", scene.clamps_start), ("end", scene.clamps_end)) if has]
    if not ends:
        return None
    end, a = ends[rng.integers(len(ends))], rng.uniform(0.0, 2.0 * np.pi)
    x, z = np.cos(a) * scene.length, np.sin(a) * scene.length
    return Drawn(lambda s: {end: [float(s * x), float(s * z)]}, 1e-3, 0.05)


def gravity_tilt(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = _sign(rng)
    return Drawn(lambda s: {"angle": sign * s}, 2e-3, 0.3)


def point_mass(rng: np.random.Generator, scene: Scene) -> Drawn:
    position = float(rng.uniform(0.25, 1.0) * scene.length)
    return Drawn(lambda s: {"mass": s * scene.mass, "position": position}, 2e-3, 2.0)


def connector(rng: np.random.Generator, scene: Scene) -> Drawn:
    extent = float(rng.uniform(0.05, 0.2) * scene.length)
    return Drawn(lambda s: {"mass": s * scene.mass, "extent": extent}, 0.02, 2.0)


def stiff_segment(rng: np.random.Generator, scene: Scene) -> Drawn:
    centre = float(rng.uniform(0.15, 0.85) * scene.length)
    extent = float(rng.uniform(0.12, 0.3) * scene.length)
    sign = 1.0 if rng.random() < 0.7 else -0.5
    return Drawn(
        lambda s: {"centre": centre, "extent": extent, "ratio": float(np.exp(sign * s))}, 0.03, 2.5
    )


def stiffness_gradient(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = _sign(rng)
    return Drawn(lambda s: {"change": sign * s}, 0.02, 1.7)


def nonlinear_stiffness(rng: np.random.Generator, scene: Scene) -> Drawn:
    return Drawn(lambda s: {"half_curvature": scene.curvature / s}, 0.1, 2.5)


def plasticity(rng: np.random.Generator, scene: Scene) -> Drawn:
    hardening = float(rng.uniform(0.1, 0.6))
    return Drawn(
        lambda s: {
            "yield_curvature": scene.curvature * float(np.exp(-s)),
            "hardening": hardening,
        },
        0.02,
        2.0,
    )


def hysteresis(rng: np.random.Generator, scene: Scene) -> Drawn:
    turn = float(rng.uniform(0.1, 0.4) * scene.curvature)
    unit = scene.weight * scene.length**2
    return Drawn(lambda s: {"moment": s * unit, "curvature": turn}, 1e-3, 0.3)


def viscoelasticity(rng: np.random.Generator, scene: Scene) -> Drawn:
    time = float(np.exp(rng.uniform(np.log(0.05), np.log(2.0))))
    return Drawn(lambda s: {"share": s, "time": time}, 0.02, 0.85)


def surface_friction(rng: np.random.Generator, scene: Scene) -> Drawn:
    return Drawn(lambda s: {"force": s * scene.weight}, 2e-3, 0.5)


def air_drag(rng: np.random.Generator, scene: Scene) -> Drawn:
    return Drawn(lambda s: {"coefficient": s * scene.air_drag}, 0.05, 15.0)


def quadratic_drag(rng: np.random.Generator, scene: Scene) -> Drawn:
    unit = scene.mass / scene.length**2
    return Drawn(lambda s: {"coefficient": s * unit}, 0.02, 10.0)


def wall(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    """A table under what the rope sweeps, or a wall beside it, clear of every first shape.

    Its strength is how far it reaches into the swept area.
    """
    for angle in rng.permutation([0.0, 0.0, 0.5 * np.pi, -0.5 * np.pi]):
        normal = np.array([np.sin(angle), np.cos(angle)])
        tilt = float(angle + rng.uniform(-0.1, 0.1))
        normal = np.array([np.sin(tilt), np.cos(tilt)])
        swept = min((s @ normal).min() for s in scene.shapes)
        first = min((s[0] @ normal).min() for s in scene.shapes)
        if first - swept > 0.05 * scene.length:
            deepest = min(first - swept - 0.02 * scene.length, 0.15 * scene.length)
            edge = float(swept - 0.004)
            return Drawn(lambda s, e=edge, a=tilt: {"offset": e + s, "angle": a}, 1e-3, deepest)
    return None


def internal_damping(rng: np.random.Generator, scene: Scene) -> Drawn:
    return Drawn(lambda s: {"relaxation_time": s * scene.relaxation_time}, 0.1, 40.0)


def command_delay(rng: np.random.Generator, scene: Scene) -> Drawn:
    return Drawn(lambda s: {"delay": s}, 1e-3, 0.2)


def clamp_slip(rng: np.random.Generator, scene: Scene) -> Drawn:
    if rng.random() < 0.5:
        return Drawn(lambda s: {"length": s * scene.length}, 1e-3, 0.12)
    onset = float(rng.uniform(0.2, 0.8) * DURATION)
    return Drawn(lambda s: {"length": s * scene.length, "onset": onset}, 1e-3, 0.12)


def length_error(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = _sign(rng)
    return Drawn(lambda s: {"difference": sign * s * scene.length}, 1e-3, 0.06)


def camera_scale(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = _sign(rng)
    return Drawn(lambda s: {"ratio": 1.0 + sign * s}, 1e-3, 0.08)


def camera_rotation(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = _sign(rng)
    return Drawn(lambda s: {"angle": sign * s}, 1e-3, 0.2)


def camera_shift(rng: np.random.Generator, scene: Scene) -> Drawn:
    a = rng.uniform(0.0, 2.0 * np.pi)
    x, z = np.cos(a) * scene.length, np.sin(a) * scene.length
    return Drawn(lambda s: {"x": float(s * x), "z": float(s * z)}, 1e-3, 0.05)


def constant_force(rng: np.random.Generator, scene: Scene) -> Drawn:
    a = rng.uniform(0.0, 2.0 * np.pi)
    x, z = np.cos(a) * scene.weight, np.sin(a) * scene.weight
    return Drawn(lambda s: {"x": float(s * x), "z": float(s * z)}, 2e-3, 0.4)


def obstacle(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    """A peg at the border of what the rope sweeps, clear of every first shape and of the grips.

    Its strength is how far it reaches into the swept area, so that it takes nothing at 0.
    """
    radius = float(rng.uniform(0.008, 0.02))
    deepest = 0.08 * scene.length
    everywhere = np.concatenate([s.reshape(-1, 2) for s in scene.shapes])
    first = np.concatenate([s[0] for s in scene.shapes])
    grips = np.concatenate([s[:, k] for s in scene.shapes for k in (0, 4, -5, -1)])
    for _ in range(2000):
        shapes = scene.shapes[rng.integers(len(scene.shapes))]
        i = int(rng.integers(len(shapes) // 6, len(shapes)))
        j = int(rng.integers(shapes.shape[1] // 6, shapes.shape[1]))
        way = shapes[i, j] - shapes[0, j]
        along = shapes[i, j] - shapes[i, j - 1]
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        across *= np.sign(way @ across) or 1.0
        if way @ across < 0.08 * scene.length:
            continue
        touching = shapes[i, j] + (radius + 0.003) * across
        deep = touching - deepest * across
        if (
            np.linalg.norm(everywhere - touching, axis=1).min() > radius + 0.002
            and np.linalg.norm(first - deep, axis=1).min() > radius + 0.006
            and np.linalg.norm(grips - deep, axis=1).min() > radius + 0.006
        ):
            x, z = touching
            return Drawn(
                lambda s, x=x, z=z, n=across: {
                    "x": float(x - s * n[0]),
                    "z": float(z - s * n[1]),
                    "radius": radius,
                },
                1e-3,
                deepest,
            )
    return None


def gusts(rng: np.random.Generator, scene: Scene) -> Drawn:
    seed, time = int(rng.integers(1 << 30)), float(rng.uniform(0.08, 0.2))
    return Drawn(
        lambda s: {"force": s * scene.weight, "correlation_time": time, "seed": seed}, 2e-3, 1.0
    )


def stiffness_drift(rng: np.random.Generator, scene: Scene) -> Drawn:
    sign = 1.0 if rng.random() < 0.5 else -0.35
    return Drawn(lambda s: {"rate": sign * s}, 0.01, 0.9)


def camera_creep(rng: np.random.Generator, scene: Scene) -> Drawn:
    a = rng.uniform(0.0, 2.0 * np.pi)
    return Drawn(lambda s: {"x": float(s * np.cos(a)), "z": float(s * np.sin(a))}, 2e-4, 0.02)


NAMED: dict[str, Draw] = {
    f.__name__: f
    for f in (
        intrinsic_curvature,
        clamp_angle,
        clamp_compliance,
        gravity_tilt,
        point_mass,
        connector,
        stiff_segment,
        stiffness_gradient,
        nonlinear_stiffness,
        plasticity,
        hysteresis,
        viscoelasticity,
        surface_friction,
        air_drag,
        quadratic_drag,
        internal_damping,
        command_delay,
        clamp_slip,
        length_error,
        camera_scale,
        camera_rotation,
        obstacle,
        wall,
        constant_force,
    )
}
"""Effects of the interface, of which one is drawn where none is asked for."""
SET_UP: dict[str, Draw] = {f.__name__: f for f in (clamp_offset, camera_shift)}
"""Errors of every set-up, of which one alone often does what another does: drawn where they are
asked for by name."""

OTHERS: dict[str, Draw] = {f.__name__: f for f in (gusts, stiffness_drift, camera_creep)}
"""Effects that no name of the interface fits."""
