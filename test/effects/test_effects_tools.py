# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects where a user meets them: in the parameter file of `predict` and of the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from twins import WAVED, tree

from dlo_ros.cli.main import main
from dlo_ros.command import Motion
from dlo_ros.errors import ParameterError
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    command_message,
    spline_message,
    topics,
)
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.true_motion import build_simulation, simulate

pytestmark = pytest.mark.long

HIDDEN = {
    "point_mass": {"mass": 0.004, "position": 0.25},
    "clamp_angle": {"start": 0.1},
    "camera_scale": {"ratio": 1.02},
    "command_delay": {"delay": 0.04},
    "intrinsic_curvature": {"curvature": [2.0, -1.0, 0.5]},
}
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A bag of the discrete rod with hidden effects, as a camera would have seen it."""
    folder = tmp_path_factory.mktemp("hidden")
    made = read_experiment(tree(WAVED, HIDDEN, 0.8), "hidden", "hidden")
    simulation, _ = build_simulation(made)
    truth = simulate(simulation, made.stamps, made.truth.rod.length)
    basis = SplineBasis(made.truth.rod.control_points, made.truth.rod.length)
    with BagWriter(folder / "bag") as writer:
        writer.write(
            topics.COMMAND, command_message(BAG_MESSAGES, made.command), made.command.stamp
        )
        for k, stamp in enumerate(made.stamps):
            seen = made.hidden.measured(truth.control_points(k, basis))
            shape = np.column_stack([seen, np.zeros(len(seen))])
            message = spline_message(BAG_MESSAGES, stamp, "board", shape)
            writer.write(topics.OBSERVED, message, stamp)
    values = {k: {a: tuple(b) if isinstance(b, list) else b for a, b in v.items()}
              for k, v in HIDDEN.items()}  # fmt: skip
    made.truth.dump(folder / "plain.yaml")
    made.truth.with_effects(values).dump(folder / "extended.yaml")
    return folder


def predicted_err(recording, tmp_path, params, capsys):
    words = ["predict", "--params", str(recording / params), "--output", str(tmp_path / params)]
    assert main([*words, str(recording / "bag")]) == 0
    said = capsys.readouterr().out
    return float(said.split("ERR ")[1].split(" mm")[0])


def test_predict_simulates_the_effects_of_its_parameter_file(recording, tmp_path, capsys):
    plain = predicted_err(recording, tmp_path, "plain.yaml", capsys)
    extended = predicted_err(recording, tmp_path, "extended.yaml", capsys)
    assert plain > 5.0  # mm
    assert extended < 0.2


def test_predict_refuses_an_effect_that_leaves_no_rope(recording, tmp_path, capsys):
    wrong = tmp_path / "wrong.yaml"
    text = (recording / "extended.yaml").read_text()
    wrong.write_text(text.replace("position: 0.25", "position: 0.7"))
    words = ["predict", "--params", str(wrong), "--output", str(tmp_path / "out")]
    assert main([*words, str(recording / "bag")]) == 2
    said = capsys.readouterr().err
    assert "effects.point_mass.position is 0.7 m; it must lie on the DLO" in said
    assert "Traceback" not in said and said.count("\n") == 1


PLAIN = read_experiment(tree(WAVED, {}, 0.8), "plain", "plain")


def shape_of(settings):
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, settings.rod.length).greville
    return shape


CHANGES = {
    "point_mass": ({"mass": 0.0, "position": 0.3}, {"mass": 0.01, "position": 0.3}),
    "surface_friction": (None, {"force": 0.1}),
    "plasticity": ({"yield_curvature": 1e6}, {"yield_curvature": 3.0}),
    "nonlinear_stiffness": ({"half_curvature": 1e6}, {"half_curvature": 20.0}),
    "obstacle": ({"z": -99.0}, {"x": 0.1, "z": -0.35, "radius": 0.01}),
    "length_error": ({"difference": 0.0}, {"difference": 0.02}),
    "clamp_angle": ({"start": 0.0}, {"start": 0.1}),
    "camera_rotation": ({"angle": 0.0}, {"angle": 0.1}),
    "gravity_tilt": (None, {"angle": 0.2}),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_running_simulation_takes_effects_over(name):
    """It comes to the shape in which a simulation begins that has known of the effect."""
    settings = replace(
        PLAIN.truth, damping=replace(PLAIN.truth.damping, air_drag=1.0, relaxation_time=0.05)
    )
    command = replace(PLAIN.command, stamp=0, times=PLAIN.command.times[:1],
                      positions=PLAIN.command.positions[:1], rotations=PLAIN.command.rotations[:1],
                      velocities=PLAIN.command.velocities[:1])  # fmt: skip
    before, after = CHANGES[name]
    live = LiveSimulation(settings.with_effects({name: before} if before else {}))
    live.set_command(command)
    live.start([Observation(0, shape_of(settings))])
    live.advance(SECOND // 10)
    changed = settings.with_effects({name: after})
    live.update(changed)
    shape = live.advance(6 * SECOND).control_points
    assert np.all(np.isfinite(shape))
    fresh = Simulation(changed, Motion([command]))
    fresh.start([Observation(0, shape_of(settings))])
    expected = fresh.prediction().control_points
    if name in ("surface_friction", "plasticity", "obstacle"):  # these depend on the path
        assert np.abs(shape - expected)[:, :3].max() < 0.1
    else:
        np.testing.assert_allclose(shape[:, :3], expected[:, :3], atol=2e-3 * settings.rod.length)


def test_a_change_that_leaves_no_rope_changes_nothing():
    live = LiveSimulation(PLAIN.truth)
    live.set_command(PLAIN.command)
    live.start([Observation(PLAIN.command.stamp, shape_of(PLAIN.truth))])
    with pytest.raises(ParameterError, match=r"leave -0\.1 m of a DLO"):
        live.update(PLAIN.truth.with_effects({"length_error": {"difference": -0.5}}))
    assert live.settings is PLAIN.truth
    live.advance(PLAIN.command.stamp + SECOND // 10)


def test_a_parameter_file_is_refused_where_effects_leave_no_rope(recording, tmp_path):
    for text, message in (
        ("length_error: {difference: -0.39}", "leave 0.01 m of a DLO of 0.4 m"),
        ("stiff_segment: {centre: 0.5, extent: 0.1, ratio: 2.0}", "centre is 0.5 m; it must lie"),
        ("air_drag: {coefficient: -1.0}", "coefficient is -0.95 N s/m.2 in all"),
    ):
        file = tmp_path / "params.yaml"
        plain = (recording / "plain.yaml").read_text().rstrip().removesuffix("...")
        file.write_text(f"{plain}    effects:\n      {text}\n")
        with pytest.raises(ParameterError, match=message):
            Settings.load(file)


def test_a_parameter_file_says_the_unit_of_each_number(tmp_path):
    text = (
        Settings.from_mapping(
            {
                "rod.length": 0.4,
                "rod.diameter": 0.004,
                "rod.young_modulus": 1e6,
                "rod.density": 2000.0,
                "effects.point_mass.mass": 0.01,
                "effects.intrinsic_curvature.curvature": [1.0, -2.0],
            }
        )
    ).text()
    for line in (
        "      length: 0.4  # m",
        "      young_modulus: 1000000.0  # Pa",
        "    gravity: [0.0, 0.0, -9.81]  # m/s^2",
        "        mass: 0.01  # kg",
        "        curvature: [1.0, -2.0]  # 1/m",
        "      poisson_ratio: 0.33",
    ):
        assert line in text.splitlines(), line
    (tmp_path / "params.yaml").write_text(text)
    assert Settings.load(tmp_path / "params.yaml").text() == text
