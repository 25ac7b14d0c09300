# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The example of docs/another_rod_model.md: registered from outside, simulated, fitted, right."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from rods import PAPER, SECOND, command, held_start

from dlo_ros.__main__ import run
from dlo_ros.command import Motion
from dlo_ros.errors import InputError, ParameterError, SimulationError
from dlo_ros.identification import identify
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.inference.forecast import Manipulation, forecast
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod import LiveSimulation, Simulation, rod_simulations, simulation_of
from dlo_ros.rod.difference_quotients import DifferenceQuotients
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import SplineBasis

EXAMPLE = ROOT / "examples" / "own_rod_model"
STIFF = replace(PAPER, rod=replace(PAPER.rod, young_modulus=2e9))
BASIS = SplineBasis(STIFF.rod.control_points, STIFF.rod.length)


def straight():
    shape = np.zeros((10, 4))
    shape[:, 0] = BASIS.greville
    return shape


def register(folder, monkeypatch, entry):
    """As pip would install a distribution with one entry point."""
    info = folder / "own_rod_model-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own_rod_model\nVersion: 0.1.0\n")
    (info / "entry_points.txt").write_text(f"[dlo_ros.rod_simulations]\n{entry}\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.syspath_prepend(EXAMPLE)
    rod_simulations.cache_clear()


@pytest.fixture
def cantilever(tmp_path, monkeypatch):
    """Settings of the example's model."""
    register(tmp_path, monkeypatch, "linear_cantilever = linear_cantilever:LinearCantilever")
    yield with_model(STIFF, "linear_cantilever")
    rod_simulations.cache_clear()


def with_model(settings, name):
    return replace(settings, simulation=replace(settings.simulation, model=name))


def recording(settings, count=20):
    """A manipulation in which the clamp is raised and turned, as the settings' model sees it."""
    turn = np.array([0.0, np.sin(-0.2), 0.0, np.cos(-0.2)])
    rotations = [[[0.0, 0.0, 0.0, 1.0]], [turn]]
    imposed = command(["start"], [0.0, 1.0], [[[0, 0, 0]], [[0.05, 0, 0.1]]], rotations)
    simulation = simulation_of(settings, Motion([imposed]))
    simulation.start([Observation(0, straight())])
    stamps = [k * SECOND // count for k in range(count)]
    shapes = [simulation.prediction(), *simulation.advance_through(stamps[1:])]
    seen = tuple(Observation(p.stamp, p.control_points) for p in shapes)
    return Manipulation("own", (imposed,), seen)


def test_the_models_name_chooses_it(cantilever):
    kind = type(simulation_of(cantilever, Motion([held_start()])))
    assert kind.__name__ == "LinearCantilever"
    assert isinstance(simulation_of(STIFF, Motion([held_start()])), Simulation)
    table = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 2e9,
             "rod.density": 2500.0, "simulation.model": "linear_cantilever"}  # fmt: skip
    assert Settings.from_mapping(table).simulation.model == "linear_cantilever"


def test_an_unknown_model_is_refused_with_those_that_there_are(cantilever):
    words = "simulation.model is 'chain'; .* known are linear_cantilever, spline"
    with pytest.raises(ParameterError, match=words):
        LiveSimulation(with_model(STIFF, "chain"))


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("other = nowhere:Rod", "cannot be loaded"),
        ("other = math:pi", "is no class with differentiable, starting"),
        ("spline = linear_cantilever:LinearCantilever", "there is one already"),
    ],
)
def test_what_is_no_model_is_left_out_with_a_warning(tmp_path, monkeypatch, caplog, entry, words):
    register(tmp_path, monkeypatch, entry)
    with caplog.at_level(logging.WARNING):
        assert dict(rod_simulations()) == {"spline": Simulation}
    assert words in caplog.text
    rod_simulations.cache_clear()


def test_it_is_simulated_and_differentiated(cantilever):
    found = forecast(recording(cantilever), cantilever, parameters=MATERIAL)
    rod = cantilever.rod
    sag = rod.linear_density * 9.81 * rod.length**4 / (8.0 * rod.bending_stiffness)
    assert found.predicted[0][-1, 2] == pytest.approx(-sag, rel=1e-6)
    assert np.isnan(found.resolution_error) and not found.loadings
    # w is proportional to the density over E, and knows neither drag nor relaxation.
    tip = found.sensitivity[0, :, -1, 2]
    np.testing.assert_allclose(tip, [sag, -sag, 0.0, 0.0], rtol=1e-5, atol=1e-12)


def test_many_sets_are_simulated_one_by_one(cantilever):
    made = recording(cantilever)
    sets = [cantilever, cantilever.with_material(3e9, 2500.0)]
    for found, one in zip(forecast_each(made, sets), sets, strict=True):
        np.testing.assert_array_equal(found.predicted, forecast(made, one).predicted)


def test_a_fit_with_it_finds_its_stiffness(cantilever):
    found = identify([recording(cantilever)], cantilever.with_material(1.2e9, 2500.0))
    truth = cantilever.rod.specific_modulus
    assert found.estimate.specific_modulus == pytest.approx(truth, rel=1e-3)


def test_a_live_simulation_runs_it(cantilever):
    live = LiveSimulation(cantilever)
    live.set_command(held_start())
    live.start([Observation(0, straight())])
    before = live.advance(SECOND).control_points
    assert live.control_points == 10
    live.update(cantilever.with_material(4e9, 2500.0))
    after = live.advance(2 * SECOND).control_points
    assert after[-1, 2] == pytest.approx(before[-1, 2] / 2.0)
    fork = live.rehearsing(held_start(stamp=2 * SECOND), ("young_modulus",)).prepared()
    assert isinstance(fork, DifferenceQuotients)
    (derivative,) = fork.prediction().sensitivity
    assert derivative[-1, 2] == pytest.approx(-after[-1, 2], rel=1e-5)


def test_predict_tries_a_motion_with_it(cantilever, tmp_path, capsys):
    params, motion = tmp_path / "params.yaml", tmp_path / "motion.yaml"
    params.write_text(
        "/**:\n  ros__parameters:\n"
        "    rod: {length: 0.4, diameter: 0.004, young_modulus: 2.0e9, density: 2500.0,"
        " specific_modulus_std: 8.0e4}\n    simulation: {model: linear_cantilever}\n"
    )
    motion.write_text(
        "start:\n"
        "  - {time: 0.0, position: [0.0, 0.0, 0.0], angle: 0.0}\n"
        "  - {time: 0.5, position: [0.0, 0.0, 0.1], angle: 0.0}\n"
    )
    output = tmp_path / "out.mcap"
    given = ["predict", "--params", params, "--command", motion, "--output", output]
    assert run([str(word) for word in given]) == 0
    told = capsys.readouterr().out
    assert "26 predicted splines" in told and "loads: none" in told and "band: the para" in told


def test_difference_quotients_agree_with_the_splines_own_sensitivities():
    names = ("young_modulus", "density", "air_drag")
    settings = replace(PAPER, simulation=replace(PAPER.simulation, start="equilibrium"))
    motion = Motion([command(["start"], [0.0, 0.3], [[[0, 0, 0]], [[0.0, 0, 0.05]]])])
    stamps = [SECOND // 10, SECOND // 5]
    own = Simulation(settings, motion, parameters=names, spans=14)
    middle = Simulation(settings, motion, spans=14)
    quotients = DifferenceQuotients(middle, names, kind=Simulation)
    for one in (own, quotients):
        one.start([Observation(0, straight())])
    for exact, found in zip(
        own.advance_through(stamps), quotients.advance_through(stamps), strict=True
    ):
        scale = np.abs(exact.sensitivity).max(axis=(1, 2), keepdims=True)
        assert (np.abs(found.sensitivity - exact.sensitivity) / scale).max() < 0.02
        np.testing.assert_allclose(found.control_points, exact.control_points, atol=1e-5)


def test_difference_quotients_refuse_poses_of_clamps(cantilever):
    with pytest.raises(InputError, match=r"no sensitivity to 'start\.x'"):
        simulation_of(cantilever, Motion([held_start()]), parameters=("start.x",))


def test_an_effect_that_it_does_not_know_is_refused(cantilever):
    changed = cantilever.with_effects({"point_mass": {"mass": 0.01, "position": 0.2}})
    with pytest.raises(SimulationError, match=r"effects\.point_mass: .* knows no such"):
        simulation_of(changed, Motion([held_start()]))


def test_the_page_shows_the_example_as_it_is():
    page = (ROOT / "docs" / "another_rod_model.md").read_text()
    for name in ("linear_cantilever.py", "pyproject.toml"):
        assert f"```{{literalinclude}} ../examples/own_rod_model/{name}" in page
