# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What an effect leaves in the residual after E and mu have been fitted again."""

from dataclasses import dataclass

import numpy as np

from dlo_ros.synthesis.experiment import NANOSECONDS, START_STAMP, read_experiment
from dlo_ros.synthesis.true_motion import build_simulation, simulate

EDGES, STEP = 50, 4e-3  # enough to compare two shapes of the same discretisation
POINTS, EVERY = 25, 4
ROUNDS = 8
DIFFERENCE = 0.03  # of ln E and ln mu, for derivatives


@dataclass(frozen=True)
class Shapes:
    """Measured shapes of all recordings at some instants, without noise.

    Args:
        points: x and z [m], shape (T, POINTS, 2).
        normals: shape (T, POINTS, 2).
        nodes: nodes of each recording, shape (T, N + 1, 2).
    """

    points: np.ndarray
    normals: np.ndarray
    nodes: tuple[np.ndarray, ...]


def changed(tree: dict, effects: dict, foreign: dict, material=(0.0, 0.0)) -> dict:
    """An experiment with effects, and with ln E and ln mu changed."""
    parameters = dict(tree["parameters"])
    rod = dict(parameters["rod"])
    rod["young_modulus"] *= float(np.exp(material[0]))
    rod["density"] *= float(np.exp(material[1]))
    parameters["rod"] = rod
    if effects:
        parameters["effects"] = effects
    return tree | {"parameters": parameters, "foreign": foreign}


def beside(known: dict, effects: dict) -> dict:
    """Effects beside others that are there all the same."""
    return known | {name: {**known.get(name, {}), **block} for name, block in effects.items()}


def shapes(trees: list[dict], effects: dict, foreign: dict, material=(0.0, 0.0)) -> Shapes:
    """Simulate recordings coarsely."""
    points, normals, nodes = [], [], []
    for tree in trees:
        made = read_experiment(changed(tree, effects, foreign, material), "challenge", "challenge")
        length = made.truth.rod.length
        simulation, _ = build_simulation(made, edges=EDGES, step=STEP)
        truth = simulate(simulation, made.stamps[::EVERY], length)
        nodes.append(truth.nodes)
        u = np.linspace(0.0, length, POINTS)
        for i, stamp in enumerate(truth.stamps):
            time = (stamp - START_STAMP) / NANOSECONDS
            seen = made.hidden.measured(truth.centreline(i, u), time)[:, [0, 2]]
            along = np.gradient(seen, axis=0)
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            points.append(seen)
            normals.append(np.column_stack([-along[:, 1], along[:, 0]]))
    return Shapes(np.array(points), np.array(normals), tuple(nodes))


class Refit:
    """E and mu fitted to recordings with an effect, by a model without it.

    Args:
        trees: recordings without effects.
        noise: noise of a measured point [m].
        density_std: prior standard deviation of ln mu.
        known: effects that the fitted model has as well.
    """

    def __init__(
        self, trees: list[dict], noise: float, density_std: float, known: dict | None = None
    ) -> None:
        self.trees, self.noise, self.density_std = trees, noise, density_std
        self.known = known or {}
        self.plain = shapes(trees, self.known, {})
        self._by_density: np.ndarray | None = None

    def _column(self, at: Shapes, material: np.ndarray, k: int) -> np.ndarray:
        other = shapes(self.trees, self.known, {}, material + DIFFERENCE * np.eye(2)[k])
        return _across(other, at) / DIFFERENCE

    def ratio(self, effects: dict, foreign: dict) -> tuple[float, np.ndarray]:
        """Residual over noise, and the changes of ln E and ln mu that absorbed the rest."""
        true = shapes(self.trees, beside(self.known, effects), foreign)
        # A picture has some hundred measured points, of which these are a few.
        weight = 100.0 / POINTS * EVERY / self.noise**2
        material, model = np.zeros(2), self.plain
        miss = _across(true, model)
        cost = weight * miss @ miss
        if self._by_density is None:
            self._by_density = self._column(self.plain, material, 1)
        for _ in range(ROUNDS):
            # The weighed density hardly moves, so its derivative is taken once.
            jacobian = np.column_stack([self._column(model, material, 0), self._by_density])
            normal = weight * jacobian.T @ jacobian
            normal[1, 1] += self.density_std**-2
            right = weight * jacobian.T @ miss
            right[1] -= material[1] / self.density_std**2
            step = np.clip(np.linalg.solve(normal, right), -1.0, 1.0)
            for share in (1.0, 0.3):
                trial = material + share * step
                other = shapes(self.trees, self.known, {}, trial)
                left = _across(true, other)
                after = weight * left @ left + (trial[1] / self.density_std) ** 2
                if after < cost:
                    break
            gain = cost - after
            if gain > 0.0:
                material, model, miss, cost = trial, other, left, after
            if gain < 0.02 * cost:
                break
        return float(np.sqrt(np.mean(miss**2)) / self.noise), material


def _across(shape: Shapes, from_: Shapes) -> np.ndarray:
    return ((shape.points - from_.points) * from_.normals).sum(axis=2).ravel()
