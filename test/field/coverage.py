# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Whether the stated std of E/mu is true: `PYTHONPATH=.:support python -m field.coverage`.

Recordings of the independent rod whose only fault is that of a condition, or the field's cases
without a cause, go through `identify` or the live estimator. Told are errors of ln(E/mu) and how
many standard deviations they are.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from challenge.generate import _recordings
from challenge.manipulations import FREE, c_shape
from live_estimates import live_estimate

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import SimulationError
from dlo_ros.identification import Estimate, Manipulation, identify
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.true_motion import build_simulation, simulate
from field.generate import _guessed, draw
from field.nuisances import DEGREE, SAMPLES, smooth
from field.stereo import draw as draw_in_space

POINTS = 100
"""Measured points along the rope."""
MEMORY, STRETCH, GROSS, FIXED = 0.5, 0.01, 0.05, 5e-4
"""Correlation of neighbouring pictures; stretch of u; share of grossly wrong pictures; an error
that all pictures have in common, over L."""
TURNED, MOVED = 3.0 * DEGREE, 2e-3
"""Angle [rad] and offset [m] of a clamp that is off."""
COIL = (3.0, 6.0)
"""Curvature at rest times the length of a rope that keeps its coil: 6 to 12 tolerances."""
RESTING = ("rest", "still")
"""Conditions without motion: thirty seconds with an error that stays, and three without."""
TWIST, TWISTING = "twisting_stiffness", 0.7
"""The effect by which a rope resists twist otherwise, and the spread of its logarithm."""
RECORDED = ("parameters", "guess", "duration", "initial_shape", "motion", "camera")
"""Parts of an experiment in space that is measured without cameras."""
EDGES = 60
SLOWLY = 10.0
"""Duration of a rope at rest over that of a motion."""
STEP = 1e-3


@dataclass(frozen=True)
class Drawn:
    """Recordings of a rope.

    Args:
        recordings: recordings of the rope.
        guess: settings that are known beforehand.
        ratio: true E/mu [m^2/s^2].
        thickness: true diameter over the one that is known; shapes tell E D^2/mu.
        twisting: true twisting stiffness over that of a round section; None: it is that.
    """

    recordings: list[Manipulation]
    guess: Settings
    ratio: float
    thickness: float = 1.0
    twisting: float | None = None


def condition(seed: int, name: str) -> Drawn:
    """One recording of 3 s with points whose noise is 0.2 to 0.5 mm across the rope, and a fault.

    Args:
        name: name of the condition, one of `CONDITIONS`.
    """
    for attempt in range(20):
        rng = np.random.default_rng([seed, attempt, 77])
        try:
            return _drawn(rng, seed, name)
        except SimulationError:
            continue
    raise RuntimeError(f"no recording for seed {seed}")


def _drawn(rng: np.random.Generator, seed: int, name: str) -> Drawn:
    kinds = FREE[:3] if name == "stretched" else (*FREE[:3], c_shape)
    chosen = kinds[seed % len(kinds)](rng)
    noise = float(rng.uniform(2e-4, 5e-4))
    tree = _recordings(rng, [chosen], noise)[0]
    _guessed(tree["guess"], False, float(np.exp(0.5 * rng.normal())))
    sign = rng.choice([-1.0, 1.0], 2)
    if name == "clamp":
        way = rng.uniform(0.0, 2.0 * np.pi)
        tree["parameters"]["effects"] = {
            "clamp_angle": {"start": float(sign[0] * TURNED)},
            "clamp_offset": {"start": [float(MOVED * np.cos(way)), float(MOVED * np.sin(way))]},
        }
    if name == "coil":
        length = tree["parameters"]["rod"]["length"]
        size = float(sign[0] * rng.uniform(*COIL) / length)
        along = 1.0 + 0.3 * smooth(rng, np.linspace(0.0, 1.0, SAMPLES))
        tree["parameters"]["effects"] = {
            "intrinsic_curvature": {"curvature": (size * along).tolist()}
        }
    if name in RESTING:
        tree["motion"] = {k: rows[:1] for k, rows in tree["motion"].items()}
        tree["duration"] = 0.1
    made = read_experiment(tree, name, "coverage")
    simulation, _ = build_simulation(made, step=STEP)
    truth = simulate(simulation, made.stamps, made.truth.rod.length)
    stretch = 1.0 + sign[1] * (STRETCH if name == "stretched" else 0.0)
    length = made.truth.rod.length
    shapes = [
        made.hidden.measured(_extended(lambda u, i=i: truth.centreline(i, u), length, stretch), 0.0)
        for i in range(len(truth.stamps))
    ]
    stamps = list(truth.stamps)
    if name in RESTING:
        count = int(SLOWLY * 3.0 * 10.0) if name == "rest" else 90
        shapes = shapes[:1] * count
        stamps = [
            stamps[0] + k * NANOSECONDS // (10 if name == "rest" else 30) for k in range(count)
        ]
    seen = _measured(rng, np.array(shapes), stamps, length, noise, name, made.truth)
    guess = made.guess.with_effects({})
    recording = Manipulation(name, (made.command,), tuple(seen))
    return Drawn([recording], guess, made.truth.rod.specific_modulus)


def _extended(
    curve: Callable[[FloatArray], FloatArray], length: float, stretch: float
) -> FloatArray:
    """Points at `stretch` times their u; beyond the free end straight on, shape (POINTS, 3)."""
    u = np.linspace(0.0, length, POINTS) * stretch
    end = curve(np.array([length - 1e-3 * length, length]))
    beyond = np.maximum(u - length, 0.0) / (1e-3 * length)
    return np.asarray(curve(np.minimum(u, length)) + beyond[:, None] * (end[1] - end[0]))


def _measured(
    rng: np.random.Generator, shapes: FloatArray, stamps: list[int], length: float, noise: float,
    name: str, settings: Settings,
) -> list[Observation]:  # fmt: skip
    """Observations that an observer publishes of true centrelines (F, POINTS, 3)."""
    u = np.linspace(0.0, length, POINTS)
    basis = SplineBasis(settings.rod.control_points, length)
    memory = MEMORY if name == "correlated" else 0.0
    fading = noise * rng.normal(size=POINTS)
    fixed = FIXED * length * smooth(rng, u / length) if name == "rest" else np.zeros(POINTS)
    result = []
    for stamp, true in zip(stamps, shapes, strict=True):
        tangent = np.gradient(true, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        across = np.column_stack([-tangent[:, 2], np.zeros(POINTS), tangent[:, 0]])
        new = noise * rng.normal(size=POINTS)
        fading = memory * fading + np.sqrt(1.0 - memory**2) * new
        points = true + (fading + fixed)[:, None] * across
        if name == "gross" and rng.random() < GROSS and len(result):
            size = 0.1 * np.ptp(shapes[0], axis=0).max()
            points[:, [0, 2]] += size * np.column_stack([smooth(rng, u / length) for _ in "xz"])
        shape = np.column_stack([basis.fit(u, points), np.zeros(settings.rod.control_points)])
        std = np.full(POINTS, noise)
        result.append(Observation(stamp, shape, CentrelinePoints(points, u, std)))
    return result


def field_case(seed: int) -> Drawn:
    """A case of the field without a cause: three or four recordings, splines alone."""
    case = draw(seed, 0)
    rod = case.trees[0]["parameters"]["rod"]
    with tempfile.TemporaryDirectory() as folder:
        bags, _ = case.write(Path(folder))
        guess = Settings.load(Path(folder) / "params.yaml")
        recordings = [load_manipulation(bag, guess) for bag in bags]
    thickness = rod["diameter"] / guess.rod.diameter
    return Drawn(recordings, guess, rod["young_modulus"] / rod["density"], thickness)


def space_case(seed: int) -> Drawn:
    """One recording of 3 s in space, of grippers that move and turn; E up to 30 times off.

    Points are measured without a camera, and no twist. The twisting stiffness is drawn; every other
    rope has a free end.
    """
    case = draw_in_space(seed, "free" if seed % 2 else "grippers")
    (tree,) = case.trees
    ratio = float(np.exp(TWISTING * np.random.default_rng([seed, 5]).normal()))
    tree["parameters"]["effects"] = {TWIST: {"ratio": ratio}}
    rod = tree["parameters"]["rod"]
    made = read_experiment({k: tree[k] for k in RECORDED}, "space", "coverage")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        synthesize(made, bag, images=False, seed=seed, edges=EDGES, step=2.0 * STEP)
        recording = load_manipulation(bag, made.guess)
    return Drawn([recording], made.guess, rod["young_modulus"] / rod["density"], twisting=ratio)


CONDITIONS = (
    "clean", "correlated", "stretched", "gross", "clamp", "coil", "rest", "still", "field", "space"
)  # fmt: skip


def offline(drawn: Drawn) -> Estimate:
    """The estimate of `identify`; where the twisting stiffness is drawn, what is told of it."""
    found = identify(drawn.recordings, drawn.guess)
    if drawn.twisting is not None:
        told = found.fitted.set_up.get(f"effects.{TWIST}.ratio")
        words = "taken as stated" if told is None else "{:.3g} +- {:.2g}".format(*told)
        print(f"twisting stiffness {words}, truly {drawn.twisting:.3g}; ", end="")
    return found.estimate


def live(drawn: Drawn) -> Estimate:
    """The last estimate of the live estimator."""
    (recording,) = drawn.recordings
    return live_estimate(recording, drawn.guess)


def main() -> None:
    parser = argparse.ArgumentParser(prog="field.coverage", description=__doc__)
    parser.add_argument("--condition", choices=CONDITIONS, default="clean")
    parser.add_argument("--live", action="store_true", help="the live estimator, not identify")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first case")
    parser.add_argument("--count", type=int, default=20, help="of cases")
    arguments = parser.parse_args()
    off, std, seconds, bare = [], [], [], []
    for seed in range(arguments.first, arguments.first + arguments.count):
        drawn = (
            field_case(seed)
            if arguments.condition == "field"
            else space_case(seed)
            if arguments.condition == "space"
            else condition(seed, arguments.condition)
        )
        began = time.process_time()
        found = (live if arguments.live else offline)(drawn)
        seconds.append(time.process_time() - began)
        off.append(float(np.log(found.specific_modulus / drawn.ratio)))
        bare.append(off[-1] - 2.0 * float(np.log(drawn.thickness)))
        stated = found.specific_modulus_std
        std.append(np.inf if stated is None else stated / found.specific_modulus)
        print(
            f"{seed}: E/mu {100.0 * off[-1]:+.2f} %, stated {100.0 * std[-1]:.2f} %, "
            f"z {off[-1] / std[-1]:+.2f}; "
            f"E D^2/mu {100.0 * bare[-1]:+.2f} %; {seconds[-1]:.0f} s", flush=True,
        )  # fmt: skip
    z = np.array(off) / np.array(std)
    print(
        f"{arguments.condition}, {len(z)} cases: off by {100.0 * np.median(np.abs(off)):.2f} % in "
        f"the median, {100.0 * np.max(np.abs(off)):.2f} % at most, within 2 % "
        f"{int(np.sum(np.abs(off) < 0.02))}; stated {100.0 * np.median(std):.2f} % in the median; "
        f"rms z {np.sqrt(np.mean(z**2)):.2f}, within the 95 % interval "
        f"{int(np.sum(np.abs(z) < 1.96))}; E D^2/mu off by {100.0 * np.median(np.abs(bare)):.2f} % "
        f"in the median, {100.0 * np.max(np.abs(bare)):.2f} % at most; "
        f"{np.median(seconds):.0f} s in the median"
    )


if __name__ == "__main__":
    main()
