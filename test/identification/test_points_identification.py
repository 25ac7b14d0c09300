# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E/mu from another tracker's points: no order, 3 mm noise, 5 % outliers, an independent rod."""

import json

import numpy as np
import pytest
import yaml

from dlo_ros.cli.main import main
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import BAG_MESSAGES, cloud_message, command_message
from dlo_ros.recordings.write import BagWriter
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.true_motion import build_simulation, simulate

pytestmark = pytest.mark.slow

POINTS, NOISE, OUTLIERS = 150, 0.003, 0.05


def record(experiment, path, seed):
    """A bag with the command and lists of points."""
    coarse = {"edges": 60, "step": 4e-3} if experiment.spatial else {}
    length = experiment.truth.rod.length
    truth = simulate(build_simulation(experiment, **coarse)[0], experiment.stamps, length)
    random = np.random.default_rng(seed)
    axes = np.array([1.0, float(experiment.spatial), 1.0])
    with BagWriter(path) as writer:
        command = experiment.command
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, command), command.stamp)
        for k, stamp in enumerate(truth.stamps):
            points = truth.centreline(k, random.uniform(0.0, length, POINTS))
            points += axes * random.normal(0.0, NOISE, points.shape)
            bad = random.random(POINTS) < OUTLIERS
            low, high = points.min(axis=0) - 0.1, points.max(axis=0) + 0.1
            points[bad] = axes * random.uniform(low, high, points.shape)[bad]
            cloud = cloud_message(BAG_MESSAGES, stamp, "board", ("x", "y", "z"), points)
            writer.write(topics.POINTS, cloud, stamp)


@pytest.mark.parametrize(("name", "seeds"), [("c_shape", 3), ("approach_two", 3), ("twisted", 1)])
def test_the_ratio_is_found_with_an_honest_std(name, seeds, tmp_path):
    tree = yaml.safe_load(find_experiment(name).read_text())
    rod = tree["parameters"]["rod"]
    guess = {"young_modulus": 1.6 * rod["young_modulus"], "density": rod["density"]}
    experiment = read_experiment(tree | {"guess": {"rod": guess}}, name, f"{name}.yaml")
    experiment.guess.dump(tmp_path / "params.yaml")
    away = []
    for seed in range(100, 100 + seeds):
        bag, result = tmp_path / f"bag{seed}", tmp_path / f"result{seed}"
        record(experiment, bag, seed)
        words = ["identify", "--params", str(tmp_path / "params.yaml"), "--output", str(result)]
        assert main([*words, str(bag)]) == 0
        found = json.loads((result / "estimate.json").read_text())["specific_modulus"]
        ratio = experiment.truth.rod.specific_modulus
        assert found["value"] == pytest.approx(ratio, rel=0.05)
        away.append((found["value"] - ratio) / found["std"])
    assert np.max(np.abs(away)) < 3.0
