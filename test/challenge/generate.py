# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws a whole challenge: rope, manipulations, noise, effects of wanted size; writes bags."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from challenge import manipulations
from challenge.draws import NAMED, OTHERS, SET_UP, Drawn, Scene
from challenge.residual import Refit, changed, shapes
from dlo_ros.errors import SimulationError
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.synthesize import synthesize

KINDS = {
    "single": (3.0, 20.0),
    "weak": (1.2, 3.0),
    "pair": (3.0, 20.0),
    "none": (0.0, 0.0),
    "foreign": (3.0, 20.0),
    "triple": (3.0, 20.0),
}
"""Kinds of challenges and the range of residual over noise after E and mu were fitted again."""

DENSITY_STD = 0.015  # a rope that has been weighed
DAMPING_STD = 0.02
TRIES = 40

EDGES, STEP = 300, 5e-4
"""Leaves 0.005 of the noise as discretisation error in the median, and 6e-5 of E / mu."""


@dataclass(frozen=True)
class Challenge:
    """A drawn challenge.

    Args:
        seed, kind: seed and kind with which it was drawn.
        effects, foreign: hidden effects, as in an experiment file.
        ratio: residual over noise of each effect alone, after E and mu have been fitted again.
        absorbed: change of ln(E / mu) by which that fit absorbs a part, of each effect alone.
        noise: noise of the measured points across the rope [m].
        manipulations: names of the manipulations.
        trees: an experiment file for each recording.
    """

    seed: int
    kind: str
    effects: dict[str, dict]
    foreign: dict[str, dict]
    ratio: dict[str, float]
    absorbed: dict[str, float]
    noise: float
    manipulations: tuple[str, ...]
    trees: tuple[dict, ...]

    def write(
        self, folder: Path, *, images: bool = False, edges: int = EDGES, step: float = STEP
    ) -> list[Path]:
        """Write a bag for each recording, `params.yaml`, and the answer as `challenge.json`.

        Args:
            folder: folder to write into; it is made.
            images: whether a camera is rendered.
            edges, step: edges and time step of the simulation, as `synthesize` takes them.

        Returns:
            The bags' folders.
        """
        folder.mkdir(parents=True, exist_ok=True)
        bags = []
        for k, (name, tree) in enumerate(zip(self.manipulations, self.trees, strict=True)):
            bag = folder / f"{k}_{name}"
            made = read_experiment(tree, bag.name, f"challenge {self.seed}")
            synthesize(made, bag, seed=1000 * self.seed + k, images=images, edges=edges, step=step)
            bags.append(bag)
        (folder / "params.yaml").write_text((bags[0] / "params.yaml").read_text())
        answer = {k: v for k, v in asdict(self).items() if k != "trees"}
        (folder / "challenge.json").write_text(json.dumps(answer, indent=2))
        return bags


def draw(
    seed: int, kind: str = "single", names: tuple[str, ...] = (), *, recordings: int | None = None
) -> Challenge:
    """Draw a challenge; the same arguments give the same one.

    Args:
        seed: seed of all random numbers.
        kind: kind of challenge, one of `KINDS`.
        names: the effects; drawn where none are given.
        recordings: number of recordings, 2 to 4; None: drawn.

    Raises:
        RuntimeError: no such effect shows itself strongly enough in any manipulation tried.
    """
    known = OTHERS if kind == "foreign" else NAMED
    asked = crc32(" ".join(names).encode())
    rng = np.random.default_rng([seed, list(KINDS).index(kind), asked])
    if not names:
        count = {"none": 0, "pair": 2, "triple": 3}.get(kind, 1)
        names = tuple(str(n) for n in rng.choice(list(known), count, replace=False))
    known = {**known, **SET_UP}
    for _ in range(TRIES):
        try:
            found = _try(rng, seed, kind, names, known, recordings)
        except SimulationError:
            continue
        if found is not None:
            return found
    raise RuntimeError(f"no challenge of kind {kind} with {', '.join(names)} for seed {seed}")


def _try(rng, seed, kind, names, known, recordings) -> Challenge | None:
    chosen = manipulations.choose(rng, recordings or int(rng.integers(2, 5)))
    noise = float(rng.uniform(2e-4, 5e-4))
    trees = _recordings(rng, chosen, noise)
    refit = Refit(trees, noise, DENSITY_STD)
    scene = _scene(trees[0]["parameters"], chosen, refit)
    low, high = KINDS[kind]
    hidden, ratios, absorbed = {}, {}, {}
    for name in names:
        drawn = known[name](rng, scene)
        target = float(np.exp(rng.uniform(np.log(1.1 * low), np.log(0.9 * high))))
        if drawn is None:
            return None

        def ratio(strength: float, name=name, drawn=drawn) -> tuple[float, np.ndarray]:
            block = {name: drawn.values(strength)}
            return refit.ratio({}, block) if kind == "foreign" else refit.ratio(block, {})

        strength, reached, material = _strength(ratio, drawn, target)
        if not low <= reached <= high:
            return None
        hidden[name], ratios[name] = drawn.values(strength), round(reached, 2)
        absorbed[name] = round(float(material[0] - material[1]), 4)
    effects, foreign = ({}, hidden) if kind == "foreign" else (hidden, {})
    if len(names) > 1 and not _all_act(trees, effects, low * noise):
        return None
    return Challenge(
        seed=seed,
        kind=kind,
        effects=effects,
        foreign=foreign,
        ratio=ratios,
        absorbed=absorbed,
        noise=noise,
        manipulations=tuple(m.name for m in chosen),
        trees=tuple(changed(tree, effects, foreign) for tree in trees),
    )


def _all_act(trees: list[dict], effects: dict, least: float) -> bool:
    """Whether each effect moves the points by `least` [m] beside the others.

    A DLO that another effect makes stiffer may pass by a peg.
    """
    together = shapes(trees, effects, {})
    for name in effects:
        bare = shapes(trees, {k: v for k, v in effects.items() if k != name}, {})
        if float(np.sqrt(np.mean((together.points - bare.points) ** 2))) < least:
            return False
    return True


def _strength(ratio, drawn: Drawn, target: float) -> tuple[float, float, np.ndarray]:
    """Strength with about the wanted residual, as near as the plausible range allows."""
    strength = float(np.sqrt(drawn.lower * drawn.upper))
    bounds = [drawn.lower, drawn.upper]
    best = None
    for attempt in range(6):
        reached, material = ratio(strength)
        if best is None or abs(np.log(reached / target)) < abs(np.log(best[1] / target)):
            best = strength, reached, material
        if abs(np.log(reached / target)) < 0.15:
            break
        if attempt >= 2 and abs(np.log(best[1] / target)) > 1.2:
            break  # it does not answer to its strength
        bounds[0 if reached < target else 1] = strength
        wanted = strength * float(np.clip(target / max(reached, 1e-9), 0.1, 10.0))
        if not bounds[0] * 1.02 < wanted < bounds[1] / 1.02:
            wanted = float(np.sqrt(bounds[0] * bounds[1]))
        if abs(np.log(wanted / strength)) < 0.02:
            break
        strength = wanted
    return best


def _recordings(rng, chosen, noise: float) -> list[dict]:
    """Experiment files of the same rope, whose params.yaml has a wrong E and a weighed density."""
    length, diameter = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.003, 0.008))
    density = float(rng.uniform(900.0, 2500.0))
    area = np.pi * diameter**2 / 4.0
    scale = length / float(np.exp(rng.uniform(np.log(1.3), np.log(4.5))))  # (B / w)^(1/3)
    young = 9.81 * density * area * scale**3 / (np.pi * diameter**4 / 64.0)
    drag = float(density * area * rng.uniform(0.3, 1.2))  # decay of a motion in some seconds
    relaxation = float(rng.uniform(0.003, 0.012))
    guess = {
        "rod": {
            "young_modulus": float(young * np.exp(rng.uniform(-0.7, 0.7))),
            "density": float(density * (1.0 + DENSITY_STD * rng.normal())),
            "density_std": DENSITY_STD * density,
        },
        "damping": {
            "air_drag": float(drag * (1.0 + DAMPING_STD * rng.normal())),
            "air_drag_std": DAMPING_STD * drag,
            "relaxation_time": float(relaxation * (1.0 + DAMPING_STD * rng.normal())),
            "relaxation_time_std": DAMPING_STD * relaxation,
        },
    }
    parameters = {
        "rod": {
            "length": length,
            "diameter": diameter,
            "young_modulus": float(young),
            "density": density,
            "control_points": manipulations.CONTROL_POINTS,
        },
        "damping": {"air_drag": drag, "relaxation_time": relaxation},
        "camera": {"translation": [0.0, -0.35 * length, 2.6 * length]},
    }
    common = {
        "parameters": parameters,
        "guess": guess,
        "duration": manipulations.DURATION,
        "measurement": {"std": noise, "spacing": length / 100.0},
    }
    trees = []
    for manipulation in chosen:
        trees.append(common | manipulation.tree(length))
    return trees


def _scene(parameters: dict, chosen, refit: Refit) -> Scene:
    rod, damping = parameters["rod"], parameters["damping"]
    per_length = rod["density"] * np.pi * rod["diameter"] ** 2 / 4.0
    largest = []
    for nodes in refit.plain.nodes:
        edges = np.diff(nodes, axis=1)
        angle = np.unwrap(np.arctan2(-edges[..., 1], edges[..., 0]), axis=1)
        bend = np.abs(np.diff(angle, axis=1)) * (nodes.shape[1] - 1) / rod["length"]
        largest.append(bend.max(axis=1))
    return Scene(
        length=rod["length"],
        weight=float(9.81 * per_length),
        curvature=float(np.percentile(np.concatenate(largest), 90.0)),
        air_drag=damping["air_drag"],
        relaxation_time=damping["relaxation_time"],
        mass=float(per_length * rod["length"]),
        clamps_start=any(m.clamps_start for m in chosen),
        clamps_end=any(m.clamps_end for m in chosen),
        shapes=refit.plain.nodes,
    )
