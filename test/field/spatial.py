# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws a case in space: as in the plane, but motion, set-up, causes and errors leave it.

The manipulations are those of the plane; each imposed point also goes aside, and clamps swing out
of the plane and turn about the rope. Three coordinates are measured, the twist is not.
"""

from dataclasses import dataclass, replace

import numpy as np
from challenge import manipulations
from challenge.draws import NAMED, Draw, Drawn, Scene
from challenge.generate import _recordings, _strength
from challenge.residual import beside, changed

from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.hidden_rod import PLANE_ONLY
from dlo_ros.synthesis.true_motion import build_simulation, simulate
from field.generate import OWN, VISIBLE, Case, asked, clamped, first_of, loosened, with_causes
from field.nuisances import DEGREE, SAMPLES, set_up, smooth

RATE = 25.0  # [Hz] of the pictures
EDGES, STEP = 24, 8e-3  # enough to compare two shapes of the same discretisation
POINTS, EVERY = 25, 5
DIFFERENCE = 0.03  # of ln E and ln mu, for derivatives
ASIDE, SWING, TURN = 0.15, 0.4, 0.8
"""Largest motion aside, over L, and largest angles of clamps [rad]."""


def set_up_in_space(rng: np.random.Generator, length: float, ends: tuple[str, ...]) -> dict:
    """Errors of a set-up with all their freedom, see `nuisances.set_up`."""
    n = rng.normal
    effects = set_up(rng, length, ends)
    effects["twisting_stiffness"] = {"ratio": float(np.exp(0.7 * n()))}
    effects["gravity_tilt"]["across"] = DEGREE * n()
    effects["camera_rotation"]["angle"] = (0.5 * DEGREE * n(size=3)).tolist()
    effects["camera_shift"]["y"] = 5e-3 * length * n()
    across = 0.5 / length * smooth(rng, np.linspace(0.0, 1.0, SAMPLES), 0.4)
    effects["intrinsic_curvature"]["across"] = across.tolist()
    if ends:
        effects["clamp_angle"] = {e: (3.0 * DEGREE * n(size=3)).tolist() for e in ends}
        effects["clamp_offset"] = {e: (5e-3 * length * n(size=3)).tolist() for e in ends}
    return effects


def _direction(rng: np.random.Generator, axes: int = 3) -> np.ndarray:
    """A unit vector."""
    way = rng.normal(size=axes)
    return way / np.linalg.norm(way)


def intrinsic_curvature(rng: np.random.Generator, scene: Scene) -> Drawn:
    drawn = NAMED["intrinsic_curvature"](rng, scene)
    way = _direction(rng, 2)
    if "curvature" not in drawn.values(drawn.lower):
        return drawn

    def values(s: float) -> dict:
        given = np.asarray(drawn.values(s)["curvature"])
        return {"curvature": (way[0] * given).tolist(), "across": (way[1] * given).tolist()}

    return replace(drawn, values=values)


def clamp_angle(rng: np.random.Generator, scene: Scene) -> Drawn | None:
    drawn, way = NAMED["clamp_angle"](rng, scene), _direction(rng)
    return drawn and replace(
        drawn, values=lambda s: {k: (v * way).tolist() for k, v in drawn.values(s).items()}
    )


def gravity_tilt(rng: np.random.Generator, scene: Scene) -> Drawn:
    a, b = _direction(rng, 2)
    return Drawn(lambda s: {"angle": float(s * a), "across": float(s * b)}, 2e-3, 0.3)


def camera_rotation(rng: np.random.Generator, scene: Scene) -> Drawn:
    way = _direction(rng)
    return Drawn(lambda s: {"angle": (s * way).tolist()}, 1e-3, 0.2)


def constant_force(rng: np.random.Generator, scene: Scene) -> Drawn:
    way = scene.weight * _direction(rng)
    return Drawn(lambda s: dict(zip("xyz", (s * way).tolist(), strict=True)), 2e-3, 0.4)


def anisotropy(rng: np.random.Generator, scene: Scene) -> Drawn:
    angle = float(rng.uniform(-0.5, 0.5) * np.pi)
    return Drawn(lambda s: {"ratio": float(np.exp(s)), "angle": angle}, 0.03, 2.0)


CAUSES: dict[str, Draw] = {
    k: v for k, v in NAMED.items() if k not in (*PLANE_ONLY, "obstacle")
} | {
    f.__name__: f
    for f in (
        intrinsic_curvature, clamp_angle, gravity_tilt, camera_rotation, constant_force, anisotropy,
    )
}  # fmt: skip


def recordings(rng: np.random.Generator, chosen: list[manipulations.Manipulation]) -> list[dict]:
    """Experiment files of the same rope, without effects."""
    trees = _recordings(rng, chosen, 2e-4)
    length = trees[0]["parameters"]["rod"]["length"]
    own = {"camera": {"rate": RATE}}
    return [t | _recording(rng, m, length) | own for t, m in zip(trees, chosen, strict=True)]


def _recording(rng: np.random.Generator, chosen: manipulations.Manipulation, length: float) -> dict:
    """The blocks of an experiment file for a planar manipulation that leaves the plane."""
    motion, ends = {}, []
    for name, way in chosen.ways.items():
        aside = rng.uniform(-1.0, 1.0, (len(way), 3)) * [ASIDE, SWING, TURN]
        ends.append(aside[0, 0])
        rows = [(*point, *beyond) for point, beyond in zip(way, aside, strict=True)]
        motion[name] = [
            {"time": t, "position": [x * length, y * length, z * length]}
            | ({"angle": a, "swing": s, "turn": turn} if name in ("start", "end") else {})
            for t, x, z, a, y, s, turn in manipulations.smooth_rows(rows)
        ]
    shape = chosen.initial_shape
    y = np.linspace(ends[0], ends[-1], len(shape))
    shape = length * np.column_stack([shape[:, 0], y, shape[:, 1]])
    return {"initial_shape": shape.tolist(), "motion": motion}


@dataclass(frozen=True)
class Seen:
    """Shapes of all recordings at some instants, without noise.

    Args:
        points: x, y and z [m], shape (T, POINTS, 3).
        along: tangents, likewise.
        nodes: nodes of each recording, shape (T, N + 1, 3).
    """

    points: np.ndarray
    along: np.ndarray
    nodes: tuple[np.ndarray, ...]

    def across(self, other: "Seen") -> np.ndarray:
        """Distance of other shapes across these [m], shape (3 T POINTS,)."""
        miss = other.points - self.points
        return (miss - (miss * self.along).sum(axis=2, keepdims=True) * self.along).ravel()


def seen(trees: list[dict], effects: dict, material: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """Simulate recordings coarsely."""
    points, nodes = [], []
    for tree in trees:
        made = read_experiment(changed(tree, effects, {}, material), "case", "case")
        length = made.truth.rod.length
        simulation, _ = build_simulation(made, edges=EDGES, step=STEP, space=True)
        truth = simulate(simulation, made.stamps[::EVERY], length)
        nodes.append(truth.nodes)
        u = np.linspace(0.0, length, POINTS)
        points += [made.hidden.measured(truth.centreline(i, u)) for i in range(len(truth.stamps))]
    along = np.gradient(np.array(points), axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return Seen(np.array(points), along, tuple(nodes))


class LinearRefit:
    """Residual of a cause after E and mu have been fitted again, to first order.

    Args:
        trees: recordings without effects.
        size: size of the measurement's own errors [m].
        known: errors of the set-up.
    """

    def __init__(self, trees: list[dict], size: float, known: dict) -> None:
        self.trees, self.size, self.known = trees, size, known
        self.plain = seen(trees, known)
        columns = [
            self.plain.across(seen(trees, known, DIFFERENCE * row)) / DIFFERENCE
            for row in np.eye(2)
        ]
        self._others: dict[tuple[str, ...], Seen] = {}
        self._basis = np.linalg.qr(np.column_stack(columns))[0]

    def ratio(self, effects: dict) -> tuple[float, None]:
        """Residual over the measurement's own errors; None stands for the change of E and mu.

        A cause stands in the place of the set-up's error of that name: it is that much off neutral.
        """
        rest = {k: v for k, v in self.known.items() if k not in effects}
        plain = self.plain if rest == self.known else self._without(tuple(sorted(effects)))
        miss = plain.across(seen(self.trees, beside(self.known, effects)))
        left = miss - self._basis @ (self._basis.T @ miss)
        return float(np.sqrt(3.0 * np.mean(left**2)) / self.size), None

    def _without(self, names: tuple[str, ...]) -> Seen:
        """The shapes without some errors of the set-up."""
        if names not in self._others:
            rest = {k: v for k, v in self.known.items() if k not in names}
            self._others[names] = seen(self.trees, rest)
        return self._others[names]


def draw(seed: int, count: int = 1, names: tuple[str, ...] = (), *, own_rope: bool = False) -> Case:
    """Draw a case in space, see `generate.draw`.

    Raises:
        RuntimeError: no such cause shows itself in any manipulation tried.
    """
    rng = np.random.default_rng([seed, count, 3, *(asked(names) if own_rope else ())])
    names = names or tuple(str(n) for n in rng.choice(list(CAUSES), count, replace=False))
    words = f"case in space with {', '.join(names)} for seed {seed}"
    return first_of(lambda: _try(rng, seed, names), words)


def _try(rng: np.random.Generator, seed: int, names: tuple[str, ...]) -> Case | None:
    chosen = manipulations.choose(rng, int(rng.integers(2, 4)))
    trees = recordings(rng, chosen)
    length = trees[0]["parameters"]["rod"]["length"]
    loosened(rng, trees)
    ends = clamped(chosen)
    errors = set_up_in_space(rng, length, ends)
    refit = LinearRefit(trees, OWN * length, errors)
    scene = _scene(trees[0]["parameters"], ends, refit.plain)
    bare = Case(seed, {}, errors, {}, tuple(m.name for m in chosen), tuple(trees))

    def residual(known: dict, cause: dict) -> float:
        return LinearRefit(trees, refit.size, known).ratio(cause)[0]

    return with_causes(bare, names, lambda name: _shown(rng, refit, name, scene), residual)


def _shown(
    rng: np.random.Generator, refit: LinearRefit, name: str, scene: Scene
) -> tuple[dict | None, float]:
    """Values of a cause, of a residual drawn at random; None where no strength leaves one."""
    drawn, (low, high) = CAUSES[name](rng, scene), VISIBLE
    target = float(np.exp(rng.uniform(np.log(1.1 * low), np.log(0.9 * high))))
    if drawn is None:
        return None, 0.0
    strength, ratio, _ = _strength(lambda s: refit.ratio({name: drawn.values(s)}), drawn, target)
    return (drawn.values(strength) if low <= ratio <= high else None), ratio


def _scene(parameters: dict, ends: tuple[str, ...], plain: Seen) -> Scene:
    """What is known of the recordings; pegs and walls lie along y and see x and z alone."""
    rod, damping = parameters["rod"], parameters["damping"]
    per_length = rod["density"] * np.pi * rod["diameter"] ** 2 / 4.0
    turns = []
    for nodes in plain.nodes:
        edges = np.diff(nodes, axis=1)
        edges /= np.linalg.norm(edges, axis=2, keepdims=True)
        cosine = np.clip((edges[:, 1:] * edges[:, :-1]).sum(axis=2), -1.0, 1.0)
        turns.append(np.arccos(cosine).max(axis=1) * edges.shape[1] / rod["length"])
    return Scene(
        length=rod["length"], weight=float(9.81 * per_length),
        curvature=float(np.percentile(np.concatenate(turns), 90.0)),
        air_drag=damping["air_drag"], relaxation_time=damping["relaxation_time"],
        mass=float(per_length * rod["length"]), clamps_start="start" in ends,
        clamps_end="end" in ends, shapes=tuple(n[:, :, [0, 2]] for n in plain.nodes),
    )  # fmt: skip
