# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The example of docs/adding_an_effect.md: installed, found, simulated, and right."""

import ast
import subprocess
import sys

import pytest
from conftest import ROOT

EXAMPLE = ROOT / "examples" / "own_effects"

PROGRAM = """
import numpy as np
from dlo_ros.command import Command, Motion
from dlo_ros.effects import effects
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

assert effects()["wet_rope"].__module__ == "wet_rope"
PLAIN = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 2e7, "rod.density": 1200.0,
         "simulation.tolerance": 1e-4}

def hanging(**more):
    "Shape of a rope whose start points to the right, at rest."
    settings = Settings.from_mapping({**PLAIN, **more})
    still = np.tile([0.0, 0.0, 0.0, 1.0], (1, 1, 1))
    zero = np.zeros((1, 1, 3))
    command = Command(0, ("start",), np.zeros(1), zero, still, zero * np.nan, 10)
    straight = np.zeros((10, 4))
    straight[:, 0] = SplineBasis(10, 0.4).greville
    simulation = Simulation(settings, Motion([command]))
    simulation.start([Observation(0, straight)])
    return simulation.advance(0).control_points[:, :3]

area = np.pi * 0.004**2 / 4
dry, wet = hanging(), hanging(**{"effects.wet_rope.water": 0.01})
denser = hanging(**{"rod.density": 1200.0 + 0.01 / area})
half = hanging(**{"effects.wet_rope.water": 0.01, "effects.wet_rope.dry": 0.2})
print(abs(wet - denser).max(), abs(wet - dry).max(), dry[-1, 2], half[-1, 2], wet[-1, 2])
try:
    hanging(**{"effects.wet_rope.water": 0.01, "effects.wet_rope.dry": 0.5})
except Exception as err:
    print(err)
"""


FOUND = """
import numpy as np
from dataclasses import replace

from measured import swing
from rods import KNOWN, PAPER

from dlo_ros.effects import starts
from dlo_ros.inference.scene import scene
from dlo_ros.diagnosis import diagnose
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.effects import build, effects
from dlo_ros.identification import identify
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.inference.forecast import forecast

OWN = ("pixel_aspect", "rough_board")
assert not effects()["pixel_aspect"].batched
(camera,) = build({"pixel_aspect": {"ratio": 1.03}})
true = swing(PAPER, seconds=0.8)
seen = replace(true, observations=tuple(
    replace(o, control_points=np.column_stack(
        [camera.measured(o.control_points[:, :3]), o.control_points[:, 3]]))
    for o in true.observations))

# identify: the effect acts in the batched run, too, or that run is left out.
with_effect = KNOWN.with_effects({"pixel_aspect": {"ratio": 1.03}})
one, other = forecast(seen, with_effect), forecast_each(seen, [with_effect])[0]
plain = forecast(seen, KNOWN)
print(abs(one.predicted - other.predicted).max(), abs(one.predicted - plain.predicted).max())
for settings in (with_effect, KNOWN):
    estimate = identify([seen], settings).estimate
    print(estimate.specific_modulus / PAPER.rod.specific_modulus - 1.0)

# diagnose: started from where each says, and found.
begun = begin([seen], KNOWN)
at = begun.at
view = scene(at.model.settings, ["start"], at.predicted)
own = [s for s in starts(view) if s.effect in OWN]
print([s.block for s in own])
found = diagnose([seen], KNOWN)
print(sorted({c.name for c in found.candidates} & set(OWN)), [e.name for e in found.effects])
print(found.extended.settings.effects["pixel_aspect"]["ratio"])
"""
LIVE = """
import rclpy
from rclpy.parameter import Parameter

from dlo_ros.nodes.simulator import SimulatorNode

given = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e6, "rod.density": 2000.0,
         "effects.pixel_aspect.ratio": 1.02, "effects.rough_board.coefficient": 0.1,
         "effects.rough_board.coefficient_std": 0.05}
rclpy.init()
node = SimulatorNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
print(node.settings.effects)
print(node.describe_parameter("effects.rough_board.coefficient").description)
changes = [("effects.pixel_aspect.ratio", 1.01), ("effects.pixel_aspect.ratio", 3.0),
           ("effects.rough_board.coefficient_std", -0.1)]
for name, value in changes:
    answer = node.set_parameters([Parameter(name, value=value)])[0]
    print(answer.successful, node.settings.effects["pixel_aspect"]["ratio"], answer.reason)
node.destroy_node()
rclpy.shutdown()
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The example as pip installs it."""
    folder = tmp_path_factory.mktemp("installed")
    source = tmp_path_factory.mktemp("source")
    for path in EXAMPLE.iterdir():
        if path.is_file():
            (source / path.name).write_bytes(path.read_bytes())
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target")
    command = [sys.executable, "-m", "pip", "install", *options, folder, source]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def told(program, installed):
    """Lines that a program prints which finds the example installed."""
    paths = [str(ROOT), str(installed), str(ROOT / "test" / "support")]
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {paths!r}\n{program}"],
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_an_effect_of_another_package_is_found_and_right(installed):
    numbers, refusal = told(PROGRAM, installed)
    off, moved, dry, half, wet = map(float, numbers.split())
    assert moved > 0.02 and off < 2e-3 * moved
    assert wet < half < dry < 0.0  # water pulls the end down, in half of the rope less
    assert refusal == "effects.wet_rope.dry is 0.5 m; it must lie on the DLO, 0 to 0.4 m"


@pytest.mark.slow
@pytest.mark.long
def test_one_of_the_measurement_and_one_without_derivatives_are_identified_and_diagnosed(installed):
    forecasts, right, wrong, begun, names, ratio = told(FOUND, installed)
    apart, moved = map(float, forecasts.split())
    assert apart < 1e-9 and moved > 2e-3  # of a rope of 0.4 m
    assert abs(float(right)) < 0.3 * abs(float(wrong))  # relative error of E/mu
    assert abs(float(wrong)) > 0.005  # the set-up within its tolerances takes some of it
    assert ast.literal_eval(begun) == [
        {"ratio": 1.0}, {"coefficient": 0.02}, {"coefficient": 0.2},
    ]  # fmt: skip
    assert names == "['pixel_aspect', 'rough_board'] ['pixel_aspect']"
    assert float(ratio) == pytest.approx(1.03, abs=2e-3)


@pytest.mark.slow
def test_the_live_simulator_has_their_parameters(installed):
    pytest.importorskip("rclpy")
    present, described, *answers = told(LIVE, installed)
    assert ast.literal_eval(present) == {
        "pixel_aspect": {"ratio": 1.02}, "rough_board": {"coefficient": 0.1},
    }  # fmt: skip
    assert described == "friction per length over weight per length [1]"
    assert answers[0] == "True 1.01 "
    assert answers[1].startswith("False 1.01 effects.pixel_aspect.ratio is 3.0; it must be")
    assert answers[2].startswith("False 1.01 effects.rough_board.coefficient_std is -0.1; it must")


def test_the_page_shows_the_example_as_it_is():
    page = (ROOT / "docs" / "adding_an_effect.md").read_text()
    for name in ("wet_rope.py", "pixel_aspect.py", "rough_board.py", "pyproject.toml"):
        assert f"```{{literalinclude}} ../examples/own_effects/{name}" in page
