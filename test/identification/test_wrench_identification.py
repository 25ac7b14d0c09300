# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E and mu apart from measured forces: identify, the live estimator, diagnose and design."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnoses import found as some_diagnosis
from measured import swing
from rods import PAPER, command

from dlo_ros.cli.identify_results import remarks, tree
from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis import diagnose
from dlo_ros.diagnosis.findings.diagnosis_outcome import Fitted, NamedEffect, Number, SetupNumber
from dlo_ros.diagnosis.findings.measured_force_scale import with_forces
from dlo_ros.files import read_yaml
from dlo_ros.identification import OnlineEstimator, identify
from dlo_ros.identification.design.expected_information import Plan, outlook
from dlo_ros.identification.force_scale import grip_wrenches, with_scale
from dlo_ros.inference.forecast import forecast
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import (
    find_experiment,
    load_experiment,
    read_experiment,
    with_wrench,
)
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.wrench_sensor import WrenchSensor

WEIGHT = PAPER.rod.linear_density * PAPER.rod.length * 9.81
LENGTH = PAPER.rod.length
ROD = ("length", "diameter", "young_modulus", "density")


def known(sensor: WrenchSensor, factor: float = 1.0) -> Settings:
    """The paper's rope with wrong E and mu, and a sensor whose errors are stated."""
    stated = replace(
        PAPER.wrench, force_std=sensor.force_std, torque_std=sensor.torque_std,
        force_bias_std=sensor.force_bias_std,
    )  # fmt: skip
    return replace(PAPER.with_material(2e7, 2000.0 * factor), wrench=stated)


SENSOR = WrenchSensor.usual(WEIGHT, LENGTH)


@pytest.fixture(scope="module")
def swinging():
    return swing(PAPER, seconds=1.5, sensor=SENSOR, seed=2)


def both_known(estimate) -> bool:
    """Whether E and mu are determined, right to 5 %, and within their standard deviations."""
    assert all(estimate.identifiable.values())
    for name in ("young_modulus", "density"):
        true, std = getattr(PAPER.rod, name), getattr(estimate, f"{name}_std")
        assert getattr(estimate, name) == pytest.approx(true, rel=0.05)
        assert abs(getattr(estimate, name) - true) < 3.5 * std and std < 0.05 * true
    return True


def test_shapes_and_forces_tell_both_e_and_mu(swinging):
    found = identify([swinging], known(SENSOR))
    assert both_known(found.estimate)
    everything, change, mean = found.forces.scale.relative
    assert everything <= min(change, mean) and 0.02 < mean < 0.1
    said = " ".join(remarks(found))
    assert "The forces at the grips (46 messages) determine mu to" in said
    told_json = tree(found)["wrench"]
    assert told_json["messages"] == 46 and told_json["density_std"]["all"] == everything
    assert told_json["left"]["swing, start"]["force"] < 0.02 * WEIGHT


def test_forces_that_contradict_a_stated_density_leave_a_fit_that_has_ended(swinging):
    """It is that of the shapes, on which the density has no bearing."""
    heavy = known(SENSOR, 1.4)
    found = identify([swinging], replace(heavy, rod=replace(heavy.rod, density_std=40.0)))
    assert found.estimate.density < 2700.0 < heavy.rod.density
    assert not any("not converged" in line for line in remarks(found))


@pytest.mark.slow
def test_a_stated_tolerance_leaves_what_forces_tell(swinging):
    """The tolerance of a diameter that nobody states stays out where all else is exact."""
    plain = identify([swinging], known(SENSOR)).estimate
    flat = known(SENSOR).flat() | {
        "effects.gravity_tilt.angle": 0.0, "effects.gravity_tilt.angle_std": 1e-3
    }  # fmt: skip
    found = identify([swinging], Settings.from_mapping(flat))
    assert found.fitted.set_up.keys() == {"effects.gravity_tilt.angle"}
    assert both_known(found.estimate)
    assert found.estimate.young_modulus_std < 1.5 * plain.young_modulus_std


def test_a_start_from_an_observed_shape_leaves_what_forces_tell(swinging):
    """The noise of that shape shakes the simulation in its first instant, and no sensor felt it."""
    estimate = identify([replace(swinging, start="observed")], known(SENSOR)).estimate
    assert estimate.density == pytest.approx(PAPER.rod.density, rel=0.05)
    assert estimate.density_std < 0.05 * PAPER.rod.density


def test_live_forces_tell_both_e_and_mu(swinging):
    estimator = OnlineEstimator(known(SENSOR), budget=np.inf)
    for imposed in swinging.commands:
        estimator.set_command(imposed)
    (felt,) = swinging.wrenches
    for k, observation in enumerate(swinging.observations):
        one = slice(k, k + 1)
        estimator.forces.add(
            Wrenches(
                felt.end, felt.stamps[one], felt.force[one], felt.torque[one], felt.axes[one]
            )
        )  # fmt: skip
        estimator.observe(observation)
    assert both_known(estimator.estimate)
    estimator.reset()
    assert not estimator.estimate.identifiable["density"]


def test_the_scale_of_all_forces_leaves_every_shape(swinging):
    effects = {"point_mass": {"mass": 0.004, "position": 0.3}, "clamp_compliance": {"start": 0.5}}
    heavy = PAPER.with_effects(effects)
    scaled = with_scale(heavy, np.log(2.0))
    assert scaled.rod.density == 2.0 * heavy.rod.density
    assert scaled.effects["point_mass"] == {"mass": 0.008, "position": 0.3}
    assert scaled.effects["clamp_compliance"]["start"] == 0.25
    few = replace(swinging, observations=swinging.observations[:8], wrenches=())
    a, b = (forecast(few, s, spans=14, loads=True) for s in (heavy, scaled))
    np.testing.assert_allclose(a.predicted, b.predicted, atol=2e-4 * LENGTH)
    single, double = (grip_wrenches(f.loadings, "start")[:, 2] for f in (a, b))
    np.testing.assert_allclose(double, 2.0 * single, rtol=0.01)


def test_a_diagnosis_takes_the_scale_of_its_forces(swinging):
    """Of a model that is right but for the scale of all its forces."""
    light = with_scale(PAPER, np.log(0.8))
    rod = light.rod
    model = Fitted(
        light, (rod.young_modulus, None), (rod.density, None),
        (rod.specific_modulus, 0.01 * rod.specific_modulus), None, None,
    )  # fmt: skip
    mass = NamedEffect("point_mass", {"mass": Number(0.008, None, "kg")}, ())
    found = replace(some_diagnosis(), effects=(mass,), baseline=model, extended=model)
    few = replace(swinging, observations=swinging.observations[:20])
    told_by_force = with_forces(found, [few], known(SENSOR))
    for part in (told_by_force.baseline, told_by_force.extended):
        assert part.density[0] == pytest.approx(PAPER.rod.density, rel=0.05)
        assert part.young_modulus[0] == pytest.approx(PAPER.rod.young_modulus, rel=0.05)
        assert 0.0 < part.density[1] < part.young_modulus[1] * rod.density / rod.young_modulus
        assert part.settings.rod.density == pytest.approx(part.density[0])
    (effect,) = told_by_force.effects
    assert effect.parameters["mass"].value == pytest.approx(0.01, rel=0.05)
    # Shapes tell a mass over mu: what they do not know of mu is no longer in it.
    vague = NamedEffect("point_mass", {"mass": Number(0.008, 0.0024, "kg")}, ())
    guessed = replace(model, scale_std=0.299)
    (sharp,) = with_forces(
        replace(found, effects=(vague,), extended=guessed), [few], known(SENSOR)
    ).effects
    std = sharp.parameters["mass"].std
    assert 0.02 < std / sharp.parameters["mass"].value < 0.1
    # Whatever stands in the file does so, and what each recording has of its own.
    own = Number(0.0, 0.1, "s", {"first": -0.1, "second": 0.1})
    slip = NamedEffect("clamp_slip", {"onset": own}, ())
    rival = NamedEffect(
        "gravity_tilt", {"angle": Number(0.1, 0.01, "rad")}, ("constant_force",),
        rival_values={"constant_force": {"x": 0.08}},
    )  # fmt: skip
    drag = SetupNumber(0.04, 0.004, None, "N s/m^2")
    number = replace(drag, value=0.08, unit="N/m")
    numbers = {"surface_friction.force": number, "air_drag.coefficient": drag}
    scaled = with_forces(
        replace(found, effects=(mass, slip), uncertain=(rival,), setup=numbers), [few],
        known(SENSOR),
    )  # fmt: skip
    assert scaled.effects[1].parameters["onset"].own == own.own
    (again,) = scaled.uncertain
    assert again.parameters["angle"].value == pytest.approx(0.1)
    assert again.rival_values["constant_force"]["x"] == pytest.approx(0.1, rel=0.05)
    assert scaled.setup["surface_friction.force"].value == pytest.approx(0.1, rel=0.05)
    there = PAPER.damping.air_drag
    assert scaled.setup["air_drag.coefficient"].value + there == pytest.approx(
        1.25 * (0.04 + there), rel=0.05
    )
    assert "determine mu to" in told_by_force.remarks[-1]
    without = with_forces(found, [replace(few, wrenches=())], known(SENSOR))
    assert without.extended == model
    # A DLO that was weighed weighs that in the plain model, too, whatever a sensor says.
    weighed = replace(known(SENSOR), rod=replace(PAPER.rod, density_std=1e-3 * PAPER.rod.density))
    strong = [replace(w, force=1.2 * w.force, torque=1.2 * w.torque) for w in few.wrenches]
    unknown = replace(found.baseline, density=(PAPER.rod.density, None))
    told = with_forces(
        replace(found, baseline=unknown), [replace(few, wrenches=tuple(strong))], weighed
    )
    assert told.baseline.density[0] == pytest.approx(PAPER.rod.density, rel=0.01)


def test_a_sensor_counts_in_the_design_of_experiments():
    imposed = command(["start"], [0.0, 0.5], [[[0.0] * 3], [[0.05, 0.0, 0.05]]])
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, LENGTH).greville
    plan = Plan("lift", imposed, shape, 0.6, 15.0)
    blind = outlook(plan, PAPER, hypotheses=(1.0,))
    felt = outlook(plan, replace(known(SENSOR), rod=PAPER.rod), hypotheses=(1.0,))
    assert blind.std["density"] > 0.25  # the guess
    assert felt.std["density"] < 0.03 and felt.gain > blind.gain + 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"), [("c_shape", 0), ("c_shape", 1), ("c_shape", 2), ("approach_two", 40004)]
)
def test_both_within_five_per_cent_of_an_experiment(tmp_path, name, seed):
    """The motion of `approach_two` begins and ends abruptly."""
    made = with_wrench(load_experiment(find_experiment(name)))
    synthesize(made, tmp_path / "bag", seed=seed, images=False)
    settings = Settings.load(tmp_path / "bag" / "params.yaml")
    found = identify([load_manipulation(tmp_path / "bag", settings)], settings).estimate
    assert found.identifiable["young_modulus"] and found.identifiable["density"]
    assert found.young_modulus == pytest.approx(5e7, rel=0.05)
    assert found.density == pytest.approx(2500.0, rel=0.05)


@pytest.mark.slow
def test_a_hidden_mass_is_weighed_by_forces(tmp_path):
    tree = read_yaml(find_experiment("c_shape"))
    tree["parameters"]["effects"] = {"point_mass": {"mass": 0.003, "position": 0.3}}
    made = with_wrench(read_experiment(tree, "hidden", "hidden"))
    synthesize(made, tmp_path / "bag", seed=1, images=False)
    settings = Settings.load(tmp_path / "bag" / "params.yaml")
    felt = load_manipulation(tmp_path / "bag", settings)
    masses = []
    for recording in (felt, replace(felt, wrenches=())):
        found = diagnose([recording], settings)
        assert [e.name for e in found.effects] == ["point_mass"]
        masses.append(found.effects[0].parameters["mass"])
    assert abs(masses[0].value - 0.003) < 2.0 * masses[0].std
    assert masses[0].std < 0.5 * masses[1].std


def test_a_mass_that_is_known_to_its_std_goes_with_the_scale_of_forces(tmp_path):
    """Shapes tell its ratio to mu: a file that says 3.6 g of one of 3 g bends no prediction."""
    mass = {"mass": 0.003, "position": 0.4}
    tree = {
        "parameters": {
            "rod": {k: getattr(PAPER.rod, k) for k in ROD},
            "effects": {"point_mass": mass},
        },
        "guess": {"rod": {"young_modulus": 2e7, "density": 2000.0}},
        "duration": 1.2,
        "initial_shape": [[0.0, 0.0], [0.4, -0.05]],
        "motion": {
            "start": [
                {"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.0},
                {"time": 0.4, "position": [0.1, 0.0, 0.05], "angle": 0.5},
                {"time": 0.7, "position": [0.05, 0.0, 0.05], "angle": -0.2},
            ]
        },
    }
    experiment = with_wrench(read_experiment(tree, "hung", "hung.yaml"))
    synthesize(experiment, tmp_path / "bag", images=False)
    stated = {"point_mass": {**mass, "mass": 0.0036}}
    flat = experiment.guess.with_effects(stated).flat()
    settings = Settings.from_mapping(flat | {"effects.point_mass.mass_std": 0.0006})
    found = identify([load_manipulation(tmp_path / "bag", settings)], settings)
    value, std = found.fitted.set_up["effects.point_mass.mass"]
    assert value == pytest.approx(0.003, rel=0.02) and 1e-6 < std < 1e-4
    assert abs(value - 0.003) < 4.0 * std
    effects = found.estimate.settings.effects
    assert effects["point_mass"]["mass"] == pytest.approx(value)
    assert found.estimate.density == pytest.approx(PAPER.rod.density, rel=0.02)
    assert found.recordings[0].err < 4e-4
