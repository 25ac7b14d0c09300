# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws a case: rope, manipulations, a set-up with its errors, causes; writes bags.

The laws are not those that `diagnose` fits: curvature at rest is a random smooth function, the
edges of a stiff segment are soft, stiffness varies exponentially along the rope, a rope slips
through its grip at some moment.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from challenge import manipulations
from challenge.draws import NAMED, Drawn
from challenge.generate import _recordings, _scene
from challenge.residual import Refit, beside, changed

from dlo_ros.errors import SimulationError
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import BAG_MESSAGES, command_message, spline_message
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.experiment import Experiment, read_experiment
from dlo_ros.synthesis.hidden_rod import build_rod, change, stretched, true_length
from dlo_ros.synthesis.picture_bag import record_board_pictures
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation
from dlo_ros.synthesis.synthesize import LEAD, measure, parameter_text, truth_text
from dlo_ros.synthesis.true_motion import Grips, Truth, lay_along, simulate
from field.nuisances import Errors, set_up
from field.pictures import Cluttered, drawn

EDGES, STEP = 120, 1e-3
VISIBLE = (4.0, 20.0)
"""Range of the residual that a cause leaves after E and mu were fitted again, over the size of the
measurement's own errors, which is OWN of L."""
OWN = 1.2e-3
SOFT = 0.2
"""Width of a stiff segment's edges over its extent."""
TRIES = 60
Law = Callable[[DiscreteRod], DiscreteRod]


@dataclass(frozen=True)
class Case:
    """A drawn case.

    Args:
        seed: seed of all random numbers.
        causes: values of what is to be found, the main one first.
        set_up: errors of the set-up.
        ratio: residual of each cause over the measurement's own errors.
        manipulations: names of the manipulations.
        trees: an experiment file for each recording.
    """

    seed: int
    causes: dict[str, dict]
    set_up: dict[str, dict]
    ratio: dict[str, float]
    manipulations: tuple[str, ...]
    trees: tuple[dict, ...]

    def write(self, folder: Path, *, pictures: bool = False) -> tuple[list[Path], float | None]:
        """Write a bag for each recording, `params.yaml`, and the answer as `case.json`.

        Args:
            folder: folder to write into; it is made.
            pictures: whether a camera's pictures are written instead of shapes.

        Returns:
            The bags, and the measurement's own mean error [m], which pictures do not tell.
        """
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng([self.seed, 1])
        rod = self.trees[0]["parameters"]["rod"]
        basis = SplineBasis(rod["control_points"], rod["length"])
        u = basis.greville / rod["length"]
        errors = Errors.drawn(rng, u, rod["length"])
        seen = drawn(rng) if pictures else {}
        bags, own = [], []
        for k, (name, tree) in enumerate(zip(self.manipulations, self.trees, strict=True)):
            made = read_experiment(tree | seen, name, f"case {self.seed}")
            truth = simulated(made, rng, "clamp_slip" in self.causes)
            bags.append(folder / f"{k}_{name}")
            with BagWriter(bags[-1], False) as writer:
                message = command_message(BAG_MESSAGES, made.command)
                writer.write(topics.COMMAND, message, made.command.stamp - LEAD)
                if pictures:
                    _film(made, truth, writer, self.seed)
                else:
                    own.append(_observe(made, truth, writer, errors, rng))
                writer.write_text("params.yaml", parameter_text(made))
                writer.write_text("truth.yaml", truth_text(made, truth))
        (folder / "params.yaml").write_text((bags[0] / "params.yaml").read_text())
        answer = {k: v for k, v in asdict(self).items() if k != "trees"}
        (folder / "case.json").write_text(json.dumps(answer, indent=2))
        return bags, float(np.mean(own)) if own else None


def _film(made: Experiment, truth: Truth, writer: BagWriter, seed: int) -> None:
    """What a camera sees of an experiment."""
    renderer = Cluttered(made.geometry, made.look, made.truth.rod.diameter, seed)
    frames = range(len(truth.stamps))
    record_board_pictures(made, truth, writer, frames, renderer, Grips(made).places)


def _observe(
    made: Experiment, truth: Truth, writer: BagWriter, errors: Errors, rng: np.random.Generator
) -> float:
    """What is measured of an experiment; returns its mean error [m]."""
    basis = SplineBasis(made.truth.rod.control_points, made.truth.rod.length)
    frames = range(len(truth.stamps))
    true = [points for _, _, points in measure(made, truth, frames, int(rng.integers(1 << 30)))]
    names = made.command.names
    free = "end" not in names and f"control_point_{basis.control_points}" not in names
    u = basis.greville / basis.length
    shapes, kept = errors.of(rng, np.array(true), u, free)
    for stamp, points in zip(np.array(truth.stamps)[kept], shapes[kept], strict=True):
        message = spline_message(BAG_MESSAGES, int(stamp), made.truth.frame_id, points)
        writer.write(topics.OBSERVED, message, int(stamp))
    return float(np.median(np.linalg.norm(shapes - true, axis=2).mean(axis=1)))


def simulated(made: Experiment, rng: np.random.Generator, slips: bool) -> Truth:
    """The true motion, by laws that are not those of the effects."""
    grips = Grips(made)
    settings, hidden = made.truth, made.hidden
    plain = {k: v for k, v in hidden.effects.items() if k not in LAWS}
    length = settings.rod.length
    rod = build_rod(settings, replace(hidden, effects=plain), edges=EDGES, pins=grips.nodes_at)
    for name, law in LAWS.items():
        if name in hidden.effects:
            rod = law(rod, length, hidden.effects[name])
    grips.attach(rod)
    changes = change(settings, replace(hidden, effects=plain), grips.travelled)
    if slips:
        slip = hidden.number("clamp_slip", "length") / true_length(settings, hidden)
        at, took = rng.uniform(0.25, 0.6) * manipulations.DURATION, rng.uniform(0.05, 1.0)

        def changes(rod: DiscreteRod, time: float) -> DiscreteRod:
            share = 0.5 * (1.0 + np.tanh((time - at) / took))
            return stretched(rod, 1.0 + slip * float(share), np.zeros(len(rod.u)))

    simulation = DiscreteRodSimulation(
        rod, grips.boundary, lay_along(made.initial_shape, rod), step=STEP, change=changes
    )
    simulation.settle()
    return simulate(simulation, made.stamps, length)


def _segment(rod: DiscreteRod, length: float, values: dict) -> DiscreteRod:
    u = rod.u * (length / rod.u[-1])
    half = 0.5 * values["extent"]
    inside = 0.5 * (1.0 - np.tanh((np.abs(u - values["centre"]) - half) / (SOFT * half)))
    factor = np.exp(inside * np.log(values["ratio"]))
    return replace(rod, bending_stiffness=factor * rod.bending_stiffness)


def _gradient(rod: DiscreteRod, length: float, values: dict) -> DiscreteRod:
    factor = np.exp(values["change"] * (rod.u / rod.u[-1] - 0.5))
    return replace(rod, bending_stiffness=factor * rod.bending_stiffness)


LAWS = {"stiff_segment": _segment, "stiffness_gradient": _gradient, "clamp_slip": lambda r, *_: r}


def draw(seed: int, count: int = 1, names: tuple[str, ...] = ()) -> Case:
    """Draw a case; the same arguments give the same one.

    Args:
        count: number of causes, 0 to 3; more than 3 recordings where there are several causes.
        names: names of the causes; drawn where none are given.

    Raises:
        RuntimeError: no such cause shows itself in any manipulation tried.
    """
    rng = np.random.default_rng([seed, count])
    names = names or tuple(str(n) for n in rng.choice(list(NAMED), count, replace=False))
    for _ in range(TRIES):
        try:
            found = _try(rng, seed, names)
        except SimulationError:
            continue
        if found is not None:
            return found
    raise RuntimeError(f"no case with {', '.join(names)} for seed {seed}")


def _try(rng: np.random.Generator, seed: int, names: tuple[str, ...]) -> Case | None:
    chosen = manipulations.choose(rng, int(rng.integers(3, 5)))
    trees = _recordings(rng, chosen, 2e-4)
    parameters = trees[0]["parameters"]
    length = parameters["rod"]["length"]
    weighed = rng.random() < 0.5
    factor = float(np.exp(0.5 * rng.normal()))
    guess = trees[0]["guess"]  # which all trees share
    _guessed(guess, weighed, factor)
    guess["rod"]["diameter"] = parameters["rod"]["diameter"] * (1.0 + 0.02 * rng.normal())
    scale = OWN * length
    ends = tuple(e for e in ("start", "end") if any(getattr(m, f"clamps_{e}") for m in chosen))
    errors = set_up(rng, length, ends)
    # A wall that only a rope of another rest shape would have met is no cause.
    refit = Refit(trees, scale, 0.015 if weighed else 0.5, errors)
    scene = _scene(parameters, chosen, refit)
    causes, ratios = {}, {}
    for name in names:
        strengths = NAMED[name](rng, scene)
        if strengths is None:
            return None
        block, ratio = _visible(rng, refit, name, strengths)
        if block is None:
            return None
        causes[name], ratios[name] = block, round(ratio, 1)
    effects = beside(errors, causes)
    return Case(
        seed, dict(sorted(causes.items(), key=lambda c: -ratios[c[0]])),
        {k: v for k, v in errors.items() if k not in causes}, ratios,
        tuple(m.name for m in chosen), tuple(changed(tree, effects, {}) for tree in trees),
    )  # fmt: skip


def _visible(rng, refit: Refit, name: str, strengths: Drawn) -> tuple[dict | None, float]:
    """Values of a cause that shows, at a strength drawn at random; None where there are none."""
    low, high = np.log([strengths.lower, strengths.upper])
    for _ in range(6):
        block = strengths.values(float(np.exp(rng.uniform(0.3 * low + 0.7 * high, high))))
        ratio, _ = refit.ratio({name: block}, {})
        if VISIBLE[0] <= ratio <= VISIBLE[1]:
            return block, ratio
    return None, 0.0


def _guessed(guess: dict, weighed: bool, factor: float) -> None:
    """Take out of a guess what nobody measures: damping, and often the density."""
    guess["damping"] = {
        k: v * factor for k, v in guess["damping"].items() if not k.endswith("_std")
    }
    if not weighed:
        guess["rod"].pop("density_std")
        guess["rod"]["density"] *= factor
