# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings of simulated experiments, without a bag."""

import json
from functools import cache

import numpy as np
import yaml

from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.identification import Manipulation
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.observation import Observation
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.synthesize import measure
from dlo_ros.synthesis.true_motion import build_simulation, simulate


@cache
def true_motion(tree, name, step):
    """An experiment of a tree as JSON, and its motion, which does not depend on a seed."""
    experiment = read_experiment(json.loads(tree), name, "test")
    simulation, _ = build_simulation(experiment, step=step)
    return experiment, simulate(simulation, experiment.stamps, experiment.truth.rod.length)


def recorded(tree, seed, name="recording", step=5e-4):
    """A recording of an experiment's tree, its guess, and its truth."""
    experiment, truth = true_motion(json.dumps(tree), name, step)
    observations = []
    for i, points, shape in measure(experiment, truth, range(len(truth.stamps)), seed):
        q = np.column_stack([shape, np.zeros(len(shape))])
        observations.append(Observation(truth.stamps[i], q, points))
    recording = Manipulation(name, (experiment.command,), tuple(observations))
    return recording, experiment.guess, experiment.truth


def moving(name, effects, seed):
    """A recording of the discrete rod, and a guess that knows of no effect."""
    tree = yaml.safe_load(find_experiment(name).read_text())
    tree["parameters"]["effects"] = effects
    recording, guess, truth = recorded(tree, seed, step=1e-3)
    guess = guess.with_effects({})
    return recording, guess.with_material(0.5 * truth.rod.young_modulus, guess.rod.density)


def true_modulus(name):
    """E / mu [m^2/s^2] of an experiment's DLO."""
    return read_experiment(
        yaml.safe_load(find_experiment(name).read_text()), name, "test"
    ).truth.rod.specific_modulus


@cache
def fitted_set_up():
    """A set-up fitted to a recording whose clamp is turned, and that recording."""
    recording, given = moving("simple", {"clamp_angle": {"start": 0.02}}, 12)
    begun = begin([recording], given)
    training = training_set(begun, 1, begun.at.model.settings, given)
    return training.prepared.setup, training.prepared.recordings
