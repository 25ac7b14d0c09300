# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The example of docs/adding_an_effect.md: installed, found, simulated, and right."""

import subprocess
import sys

import pytest
from conftest import ROOT

EXAMPLE = ROOT / "examples" / "wet_rope"

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


def test_an_effect_of_another_package_is_found_and_right(installed):
    code = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(installed)!r}]\n{PROGRAM}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    numbers, refusal = done.stdout.splitlines()
    off, moved, dry, half, wet = map(float, numbers.split())
    assert moved > 0.02 and off < 2e-3 * moved
    assert wet < half < dry < 0.0  # water pulls the end down, in half of the rope less
    assert refusal == "effects.wet_rope.dry is 0.5 m; it must lie on the DLO, 0 to 0.4 m"


def test_the_page_shows_the_example_as_it_is():
    page = (ROOT / "docs" / "adding_an_effect.md").read_text()
    for name in ("wet_rope.py", "pyproject.toml"):
        assert f"```{{literalinclude}} ../examples/wet_rope/{name}" in page
