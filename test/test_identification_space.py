# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E/mu from a motion in space with twist, simulated by the independent rod."""

import pytest
import yaml
from ordinary import some_of

from dlo_ros.identification import identify
from dlo_ros.recordings.read import read_recording
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.synthesize import synthesize

pytestmark = pytest.mark.long


@pytest.mark.parametrize("factor", some_of([1.0 / 30.0, 30.0], [30.0]))
def test_the_ratio_is_found_from_thirty_times_off(factor, tmp_path):
    tree = yaml.safe_load(find_experiment("twisted").read_text())
    true = tree["parameters"]["rod"]["young_modulus"]
    tree["guess"] = {"rod": {"young_modulus": factor * true, "density": 2000.0}}
    made = read_experiment(tree | {"duration": 1.5}, "space", "space.yaml")
    synthesize(made, tmp_path / "bag", images=False, edges=60, step=4e-3)
    found = identify([read_recording(tmp_path / "bag", made.guess)], made.guess).estimate
    ratio = made.truth.rod.specific_modulus
    assert found.specific_modulus == pytest.approx(ratio, rel=0.02)
    assert abs(found.specific_modulus - ratio) < 4.0 * found.specific_modulus_std
    assert found.density_std is None  # a motion alone tells E/mu
