# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which effects can be told apart in which manipulation: `python -m challenge.confusion`.

For each pair the log evidence for an effect A that is there over another one, B, whose size is
fitted instead, in shapes with white noise. A is so strong that it leaves a residual of one standard
deviation of the noise in each number after E/mu and the dampings have been fitted, but for a
damping that is A or B. To first order in the sizes of A and B the log evidence is half the squared
residual that B leaves over that of the noise, which is half the count of numbers for a B that
imitates nothing of A; it is the same for A over B and for B over A. What has no first order
(contact, yield, softening) is there in a small size. The set-up is exact. Printed are the matrix of
each manipulation and, as a table, the pairs with less than CONFUSED in any of them.
"""

import argparse
from dataclasses import replace

import numpy as np

from challenge import manipulations
from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import SimulationParameters
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import START_STAMP, read_experiment

LENGTH, SPANS, FRAMES = 0.4, 28, 61
RATE = 20.0  # shapes a second
SMALL = 0.03  # of the values below: sizes to first order
ROPE = {
    "rod": {"length": LENGTH, "diameter": 0.005, "young_modulus": 2e7, "density": 1500.0},
    "damping": {"air_drag": 0.02, "relaxation_time": 0.006},
}
EFFECTS = {
    "clamp_compliance": {"start": 6.0},
    "clamp_angle": {"start": 0.3},
    "clamp_offset, along": {"start": (0.01, 0.0)},
    "clamp_offset, across": {"start": (0.0, 0.01)},
    "connector": {"mass": 0.006, "extent": 0.06},
    "point_mass": {"mass": 0.006, "position": LENGTH},
    "quadratic_drag": {"coefficient": 0.05},
    "air_drag": {"coefficient": 0.05},
    "viscoelasticity, 0.1 s": {"share": 0.4, "time": 0.1},
    "viscoelasticity, 2 s": {"share": 0.4, "time": 2.0},
    "internal_damping": {"relaxation_time": 0.05},
    "hysteresis": {"moment": 3e-3, "curvature": 1.0},
    "surface_friction": {"force": 0.03},
    "clamp_slip": {"length": 0.02},
    "clamp_slip, onset": {"length": 0.02, "onset": 1.5},
    "length_error": {"difference": 0.02},
    "stiffness_gradient": {"change": 0.5},
    "intrinsic_curvature": {"curvature": 1.0},
    "gravity_tilt": {"angle": 0.1},
    "constant_force, x": {"x": 0.05},
    "constant_force, z": {"z": 0.05},
    "camera_rotation": {"angle": 0.05},
    "camera_shift, x": {"x": 0.01},
    "command_delay": {"delay": 0.05},
}
"""Sizes of which `SMALL` is taken."""
PLACES = ("position", "extent", "time", "onset")
"""Keys that say where or when, not how much."""
DEPTH = 2e-3  # [m] that a table or a peg takes of where the DLO would be
PEG = 0.01  # [m] radius
YIELD, SOFT = 0.9, 10.0  # yield and half curvature, of the largest curvature that occurs
NOTHING = 1e-6  # share of an effect that E/mu and the dampings leave, below which it is none
CONFUSED = 200.0  # a third of the most there can be


def finite(made, plain: np.ndarray) -> dict[str, dict]:
    """Effects that have no first order, in a small size for what the plain shapes are."""
    rod = made.truth.rod
    basis = SplineBasis(rod.control_points, rod.length)
    u = np.linspace(0.0, rod.length, 101)
    points, first, second = (basis.matrix(u, k) @ plain.reshape(FRAMES, -1, 2) for k in range(3))
    bend = np.abs(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
    most = float((bend / np.linalg.norm(first, axis=2) ** 3).max())
    x, z = points.reshape(-1, 2)[np.argmin(points[..., 1])].tolist()
    table = z - 0.5 * rod.diameter + DEPTH
    return {
        "wall, a table": {"offset": table},
        "obstacle": {"x": x, "z": table - PEG, "radius": PEG},
        "plasticity": {"yield_curvature": YIELD * most, "hardening": 0.5},
        "nonlinear_stiffness": {"half_curvature": SOFT * most},
    }


def shapes(made, effects, **changes) -> np.ndarray:
    """Control points x, z of the published spline at FRAMES instants, as one vector."""
    rod = replace(made.truth.rod, **{k: v for k, v in changes.items() if k == "young_modulus"})
    damping = replace(
        made.truth.damping, **{k: v for k, v in changes.items() if k != "young_modulus"}
    )
    settings = replace(
        made.truth, rod=rod, damping=damping, simulation=SimulationParameters(tolerance=2e-5)
    ).with_effects(effects)
    simulation = Simulation(settings, Motion([made.command]), spans=SPANS)
    basis = SplineBasis(rod.control_points, rod.length)
    way = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(made.initial_shape, axis=0), axis=1))]
    )
    first = np.zeros((basis.control_points, 4))
    for k, axis in enumerate((0, 2)):
        first[:, axis] = np.interp(
            basis.greville / rod.length * way[-1], way, made.initial_shape[:, k]
        )
    stamps = [START_STAMP + round(k / RATE * NANOSECONDS) for k in range(FRAMES)]
    simulation.start([Observation(stamps[0], first)], stamps[-1])
    found = [simulation.prediction(), *simulation.advance_through(stamps[1:])]
    return np.array([p.control_points[:, [0, 2]] for p in found]).ravel()


def traces(made) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Changes of the shapes by E and by the dampings, named as effects, and by each effect."""
    plain = shapes(made, {})
    truth = made.truth
    drag, relaxation = truth.damping.air_drag, truth.damping.relaxation_time
    material = {
        "": shapes(made, {}, young_modulus=1.01 * truth.rod.young_modulus) - plain,
        "air_drag": shapes(made, {}, air_drag=1.1 * drag) - plain,
        "internal_damping": shapes(made, {}, relaxation_time=1.1 * relaxation) - plain,
    }
    found = {}
    for label, values in EFFECTS.items():
        name = label.partition(",")[0]
        kept = {k for k in values if k in PLACES or (name, k) == ("hysteresis", "curvature")}
        sized = {k: v if k in kept else scaled(v, SMALL) for k, v in values.items()}
        bare = {k: v if k in kept else scaled(v, 0.0) for k, v in values.items()}
        # A plug of no mass is stiff all the same: its mass is what is told.
        found[label] = shapes(made, {name: sized}) - shapes(made, {name: bare})
    for label, values in finite(made, plain).items():
        found[label] = shapes(made, {label.partition(",")[0]: values}) - plain
    return material, found


def scaled(value: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    """A number, or a vector, times a factor."""
    return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value


def rest(columns: np.ndarray, trace: np.ndarray) -> np.ndarray:
    """Rest of a trace after a linear fit of the columns."""
    columns = columns[:, columns.any(axis=0)]
    columns = columns / np.linalg.norm(columns, axis=0)
    return trace - columns @ np.linalg.lstsq(columns, trace, rcond=1e-9)[0]


def matrix(made) -> tuple[list[str], np.ndarray]:
    """Labels, and the log evidence for the row's effect over the column's.

    A damping that is one of a pair is not fitted beside it.
    """
    material, found = traces(made)
    labels = list(found)
    result = np.zeros((len(labels), len(labels)))
    for i, a in enumerate(labels):
        for j, b in enumerate(labels):
            fitted = np.column_stack([m for name, m in material.items() if name not in (a, b)])
            left = rest(fitted, found[a])
            if np.linalg.norm(left) < NOTHING * np.linalg.norm(found[a]) or not left.any():
                result[i, j] = result[j, i] = np.nan  # it does not show here
            elif i != j and not np.isnan(result[i, j]):
                both = rest(np.column_stack([fitted, found[b]]), found[a])
                result[i, j] = 0.5 * len(left) * float(both @ both) / float(left @ left)
    return labels, result


def main() -> None:
    parser = argparse.ArgumentParser(prog="challenge.confusion", description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    kinds = (manipulations.swing, manipulations.wave, manipulations.u_shape)
    matrices = []
    for kind in kinds:
        manipulation = kind(np.random.default_rng(arguments.seed))
        tree = {"parameters": ROPE, "duration": manipulations.DURATION}
        made = read_experiment(tree | manipulation.tree(LENGTH), kind.__name__, "confusion")
        labels, found = matrix(made)
        matrices.append(found)
        print(f"\n{kind.__name__}\n" + " " * 24 + " ".join(f"{k:>5}" for k in range(len(labels))))
        for k, (label, row) in enumerate(zip(labels, found, strict=True)):
            print(f"{k:>2} {label:<21}" + " ".join(f"{v:5.0f}" for v in row))
    print("\n" + "\n".join(confused(labels, matrices, [k.__name__ for k in kinds])))


def confused(labels: list[str], matrices: list[np.ndarray], kinds: list[str]) -> list[str]:
    """Lines of a Markdown table: pairs with less than CONFUSED in any manipulation.

    Args:
        labels: the effects.
        matrices: log evidence in each manipulation; NaN where an effect does not show.
        kinds: names of the manipulations.
    """
    lines = [f"| pair | {' | '.join(kinds)} |", "| --- " * (len(kinds) + 1) + "|"]
    for i, j in zip(*np.triu_indices(len(labels), 1), strict=True):
        values = [float(m[i, j]) for m in matrices]
        if any(v < CONFUSED for v in values):
            cells = ["not seen" if np.isnan(v) else f"{v:.0f}" for v in values]
            lines.append(f"| `{labels[i]}`, `{labels[j]}` | {' | '.join(cells)} |")
    return lines


if __name__ == "__main__":
    main()
