# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The paper's experiments as recordings, and the parameter sets of its tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.identification import Forecast, Manipulation, forecast
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.synthesis.experiment import Experiment, find_experiment, load_experiment
from dlo_ros.synthesis.synthesize import measure
from dlo_ros.synthesis.true_motion import build_simulation, simulate

# Young's modulus [Pa] and density [kg/m^3].
TABLE_I, TABLE_II, TABLE_III = (1e6, 2000.0), (3e6, 2000.0), (5e7, 2500.0)
TABLE_V = TABLE_III  # another rope of the same material


@dataclass(frozen=True)
class Run:
    """One experiment and the parameter sets that the paper tries on it.

    Args:
        name: name of the experiment file.
        title: name of the experiment in the paper.
        sets: E and mu.
        paper: ERR of each in the paper, in units that it does not state.
    """

    name: str
    title: str
    sets: tuple[tuple[float, float], ...]
    paper: tuple[float, ...]


# Table IV, and the two validation experiments of section IV.
TRAINING = (
    Run("simple", "First experiment", (TABLE_I, TABLE_III), (0.069, 0.067)),
    Run("different", "Second experiment", (TABLE_II, TABLE_III), (0.080, 0.077)),
    Run("c_shape", "Third experiment", (TABLE_I, TABLE_II, TABLE_III), (0.153, 0.107, 0.092)),
)
VALIDATION = (
    Run("approach_two", "First validation", (TABLE_V,), (0.068,)),
    Run("approach_four", "Second validation", (TABLE_V,), (0.090,)),
)


@dataclass(frozen=True)
class Recorded:
    """An experiment that was made.

    Args:
        run: the experiment and its parameter sets.
        settings: settings that are known beforehand; E and mu are a guess.
        manipulation: command and observed shapes.
    """

    run: Run
    settings: Settings
    manipulation: Manipulation

    def predicted(self, material: tuple[float, float]) -> Forecast:
        """From the first observed shape at rest, as in the paper."""
        settings = self.settings.with_material(*material)
        simulation = replace(settings.simulation, start="observed")
        return forecast(self.manipulation, replace(settings, simulation=simulation))


def record(run: Run, seed: int) -> Recorded:
    """Simulate an experiment with the discrete rod and measure it with noise."""
    experiment: Experiment = load_experiment(find_experiment(run.name))
    simulation, _ = build_simulation(experiment)
    truth = simulate(simulation, experiment.stamps, experiment.truth.rod.length)
    observations = []
    for i, points, shape in measure(experiment, truth, range(len(truth.stamps)), seed):
        q = np.column_stack([shape, np.zeros(len(shape))])
        observations.append(Observation(truth.stamps[i], q, points))
    manipulation = Manipulation(run.name, (experiment.command,), tuple(observations))
    return Recorded(run, experiment.guess, manipulation)
