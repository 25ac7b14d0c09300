# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws a case: rope, manipulations, a set-up with its errors, causes; writes bags.

The laws are not those that `diagnose` fits: curvature at rest is a random smooth function, the
edges of a stiff segment are soft, stiffness varies exponentially along the rope, a rope slips
through its grip at some moment.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from zlib import crc32

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
from dlo_ros.synthesis.hidden_rod import (
    build_rod,
    build_spatial_rod,
    change,
    give_at_grips,
    stretched,
    true_length,
)
from dlo_ros.synthesis.picture_bag import record_board_pictures
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation
from dlo_ros.synthesis.synthesize import LEAD, measure, parameter_text, truth_text
from dlo_ros.synthesis.true_motion import Grips, Truth, lay_along, simulate
from field.nuisances import Errors, set_up
from field.pictures import Cluttered, drawn

EDGES, STEP = 120, 1e-3
COARSE = 80, 2e-3
"""Edges and time step in space."""
VISIBLE = (4.0, 20.0)
"""Range of the residual that a cause leaves after E and mu were fitted again, over the size of the
measurement's own errors, which is OWN of L."""
OWN = 1.2e-3
SOFT = 0.2
"""Width of a stiff segment's edges over its extent."""
TRIES = 60
Law = Callable[[DiscreteRod], DiscreteRod]


@dataclass(frozen=True)
class Slip:
    """A slip through a grip, at its own moment in each recording.

    Args:
        at, took: middle and half-width of the smooth step by which the DLO slips [s].
    """

    at: float
    took: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Slip":
        """A slip at a random moment."""
        at = rng.uniform(0.25, 0.6) * manipulations.DURATION
        return cls(at, rng.uniform(0.05, 1.0))

    def share(self, time: float) -> float:
        """Fraction of the length that has slipped through at a time [s]."""
        return float(0.5 * (1.0 + np.tanh((time - self.at) / self.took)))

    @property
    def gained(self) -> float:
        """Fraction of the length that slips through while the recording lasts."""
        return self.share(manipulations.DURATION) - self.share(0.0)


def compared(causes: dict[str, dict], slips: list[Slip]) -> dict[str, dict]:
    """Numbers of causes that what was simulated has as well.

    A slip has no onset, and gains in a recording less than its length.

    Args:
        causes: the numbers of all causes.
        slips: the slip of each recording; empty: there is none.
    """
    if not slips:
        return causes
    gained = float(np.mean([s.gained for s in slips]))
    lengths = {k: v * gained for k, v in causes["clamp_slip"].items() if k == "length"}
    return {**causes, "clamp_slip": lengths}


@dataclass(frozen=True)
class Case:
    """A drawn case.

    Args:
        seed: seed of all random numbers.
        causes: values of what is to be found, the main one first.
        set_up: errors of the set-up.
        ratio: residual of each cause beside the others, over the measurement's own errors.
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
        spatial = read_experiment(self.trees[0], "case", "case").spatial
        axes = (0, 1, 2) if spatial else (0, 2)
        errors = Errors.drawn(rng, u, rod["length"], axes)
        seen = drawn(rng) if pictures else {}
        bags, own, slips = [], [], []
        for k, (name, tree) in enumerate(zip(self.manipulations, self.trees, strict=True)):
            made = read_experiment(tree | seen, name, f"case {self.seed}")
            if "clamp_slip" in self.causes:
                slips.append(Slip.drawn(rng))
            truth = simulated(made, slips[-1] if slips else None)
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
        answer["compared"] = compared(self.causes, slips)
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


def simulated(made: Experiment, slipping: Slip | None) -> Truth:
    """The true motion, by laws that are not those of the effects."""
    grips = Grips(made)
    settings, hidden = made.truth, made.hidden
    plain = {k: v for k, v in hidden.effects.items() if k not in LAWS}
    length, space = settings.rod.length, made.spatial
    rod, step = built(made, grips.nodes_at), COARSE[1] if space else STEP
    grips.attach(rod)
    axes = 3 if space else 2
    changes = change(settings, replace(hidden, effects=plain), grips.travelled, axes)
    if slipping is not None:
        slip = hidden.number("clamp_slip", "length") / true_length(settings, hidden)

        def changes(rod: DiscreteRod, time: float) -> DiscreteRod:
            return stretched(rod, 1.0 + slip * slipping.share(time), np.zeros(len(rod.u)))

    motion, held = (
        (SpatialSimulation, grips.spatial_boundary)
        if space
        else (DiscreteRodSimulation, grips.boundary)
    )
    laid = lay_along(made.initial_shape, rod)
    simulation = motion(rod, held, laid, step=step, change=changes)
    simulation.settle()
    return simulate(simulation, made.stamps, length)


def built(made: Experiment, pins: Sequence[float]) -> DiscreteRod:
    """The rod, by laws that are not those of the effects.

    Args:
        pins: material coordinates u [m] where a node must lie.
    """
    settings, hidden = made.truth, made.hidden
    later = {*LAWS, "clamp_compliance"}
    plain = {k: v for k, v in hidden.effects.items() if k not in later}
    build, edges = (build_spatial_rod, COARSE[0]) if made.spatial else (build_rod, EDGES)
    rod = build(settings, replace(hidden, effects=plain), edges=edges, pins=pins)
    for name, law in LAWS.items():
        if name in hidden.effects:
            rod = law(rod, settings.rod.length, hidden.effects[name])
    give_at_grips(rod, hidden)  # a grip is as stiff as it is, whatever the rope beside it
    return rod


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


def draw(seed: int, count: int = 1, names: tuple[str, ...] = (), *, own_rope: bool = False) -> Case:
    """Draw a case; the same arguments give the same one.

    Args:
        count: number of causes, 0 to 3; more than 3 recordings where there are several causes.
        names: names of the causes; drawn where none are given.
        own_rope: whether causes of other names have another rope for the same seed.

    Raises:
        RuntimeError: no such cause shows itself in any manipulation tried.
    """
    rng = np.random.default_rng([seed, count, *(asked(names) if own_rope else ())])
    names = names or tuple(str(n) for n in rng.choice(list(NAMED), count, replace=False))
    words = f"case with {', '.join(names)} for seed {seed}"
    return first_of(lambda: _try(rng, seed, names), words)


def asked(names: tuple[str, ...]) -> tuple[int, ...]:
    """Part of a generator's seed by which cases with other causes have another rope."""
    return (crc32(" ".join(names).encode()),) if names else ()


def first_of(attempt: Callable[[], Case | None], words: str) -> Case:
    """The first case that an attempt gives.

    Raises:
        RuntimeError: none of so many attempts gives one.
    """
    for _ in range(TRIES):
        try:
            found = attempt()
        except SimulationError:
            continue
        if found is not None:
            return found
    raise RuntimeError(f"no {words}")


def _try(rng: np.random.Generator, seed: int, names: tuple[str, ...]) -> Case | None:
    chosen = manipulations.choose(rng, int(rng.integers(3, 5)))
    trees = _recordings(rng, chosen, 2e-4)
    parameters = trees[0]["parameters"]
    length = parameters["rod"]["length"]
    weighed = loosened(rng, trees)
    errors = set_up(rng, length, clamped(chosen))
    # A wall that only a rope of another rest shape would have met is no cause.
    refit = Refit(trees, OWN * length, 0.015 if weighed else 0.5, errors)
    scene = _scene(parameters, chosen, refit)
    bare = Case(seed, {}, errors, {}, tuple(m.name for m in chosen), tuple(trees))

    def residual(known: dict, cause: dict) -> float:
        return Refit(trees, refit.noise, refit.density_std, known).ratio(cause, {})[0]

    return with_causes(
        bare, names, lambda name: _visible(rng, refit, name, NAMED[name](rng, scene)), residual
    )


def clamped(chosen: list[manipulations.Manipulation]) -> tuple[str, ...]:
    """Ends that are clamped in any recording."""
    return tuple(e for e in ("start", "end") if any(getattr(m, f"clamps_{e}") for m in chosen))


def with_causes(
    bare: Case,
    names: tuple[str, ...],
    drawn: Callable[[str], tuple[dict | None, float]],
    residual: Callable[[dict, dict], float],
) -> Case | None:
    """A case with causes that show, alone and beside each other; None where one does not.

    Args:
        bare: the case without them.
        names: names of the causes.
        drawn: function that returns the values of a cause, given its name, None where it does not
            show, and the residual that it leaves over the measurement's own errors.
        residual: function that returns this residual, given all effects but a cause, and the cause.
    """
    causes, ratios = {}, {}
    for name in names:
        block, ratio = drawn(name)
        if block is None:
            return None
        causes[name], ratios[name] = block, ratio
    set_up = {k: v for k, v in bare.set_up.items() if k not in causes}
    if len(names) > 1:
        # A DLO that moves otherwise because of another cause may pass by a peg.
        for name, block in causes.items():
            others = {k: v for k, v in causes.items() if k != name}
            ratios[name] = residual(beside(set_up, others), {name: block})
    if any(ratio < VISIBLE[0] for ratio in ratios.values()):
        return None
    effects = beside(bare.set_up, causes)
    return replace(
        bare, causes=dict(sorted(causes.items(), key=lambda c: -ratios[c[0]])), set_up=set_up,
        ratio={name: round(ratio, 1) for name, ratio in ratios.items()},
        trees=tuple(changed(tree, effects, {}) for tree in bare.trees),
    )  # fmt: skip


def _visible(
    rng: np.random.Generator, refit: Refit, name: str, strengths: Drawn | None
) -> tuple[dict | None, float]:
    """Values of a cause that shows, at a strength drawn at random; None where there are none."""
    if strengths is None:
        return None, 0.0
    low, high = np.log([strengths.lower, strengths.upper])
    for _ in range(6):
        block = strengths.values(float(np.exp(rng.uniform(0.3 * low + 0.7 * high, high))))
        ratio, _ = refit.ratio({name: block}, {})
        if VISIBLE[0] <= ratio <= VISIBLE[1]:
            return block, ratio
    return None, 0.0


def loosened(rng: np.random.Generator, trees: list[dict]) -> bool:
    """Take out of the guess what nobody measures; returns whether the rope was weighed."""
    weighed = bool(rng.random() < 0.5)
    guess = trees[0]["guess"]  # which all trees share
    _guessed(guess, weighed, float(np.exp(0.5 * rng.normal())))
    diameter = trees[0]["parameters"]["rod"]["diameter"]
    guess["rod"]["diameter"] = diameter * (1.0 + 0.02 * rng.normal())
    return weighed


def _guessed(guess: dict, weighed: bool, factor: float) -> None:
    """Take out of a guess what nobody measures: damping, and often the density."""
    guess["damping"] = {
        k: v * factor for k, v in guess["damping"].items() if not k.endswith("_std")
    }
    if not weighed:
        guess["rod"].pop("density_std")
        guess["rod"]["density"] *= factor
