# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Every answer of docs/physics.md: each example reaches its error, and draws its picture."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from ordinary import some_of

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SHARED = {"elastica", "report", "scene"}  # what the examples have in common

# About twice the error that is reached (docs/physics.md), in the example's own measure.
BOUNDS = {
    "cantilever": 5e-4,
    "catenary": 2.2e-4,
    "closed_loop": 1e-9,
    "energy": 4e-3,
    "euler_column": 4e-4,
    "frequencies": 1e-3,
    "helix": 5e-6,
    "michell_ring": 3.3e-3,
    "refinement": 2e-4,
    "rigid_motion": 1e-10,
    "self_buckling": 1.7e-4,
    "sensitivities": 3e-6,
    "soft_and_stiff": 1.3e-3,
    "tip_load": 6e-6,
    "twisted_rod": 1e-6,
}
DEAR = {"sensitivities", "soft_and_stiff"}
RESULTS = {}


@pytest.fixture
def example(monkeypatch):
    """A function that gives the module and the result of an example; each is run once."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    plain = (*BOUNDS, *SHARED)  # names that other modules of the tests may have, too
    others = {name: sys.modules.pop(name) for name in plain if name in sys.modules}

    def load(name):
        module = importlib.import_module(name)
        assert Path(module.__file__).parent == EXAMPLES
        if name not in RESULTS:
            RESULTS[name] = module.run()
        return module, RESULTS[name]

    yield load
    for name in plain:
        sys.modules.pop(name, None)
    sys.modules.update(others)


def test_every_example_is_tested():
    assert {p.stem for p in EXAMPLES.glob("*.py")} == set(BOUNDS) | SHARED


@pytest.mark.parametrize(
    "name",
    some_of(BOUNDS, BOUNDS.keys() - {"sensitivities", "soft_and_stiff", "frequencies", "energy"}),
)
def test_example_reaches_its_error_and_draws_a_picture(name, example, tmp_path):
    module, result = example(name)
    assert 0.0 < result.error < BOUNDS[name], result.summary
    path = tmp_path / f"{name}.png"
    module.plot(result, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 20_000


def test_cantilever_errors_fall_with_stiffness(example):
    _, result = example("cantilever")
    assert np.all(np.diff(result.distances) > 0.0)
    assert result.distances[0] < 1e-9


def test_small_load_at_the_tip(example):
    _, result = example("tip_load")
    assert result.linear_error < 1e-6
    np.testing.assert_allclose(result.deflections, result.exact, rtol=2e-5)


def test_each_frequency(example):
    _, result = example("frequencies")
    np.testing.assert_allclose(result.found[:2], result.exact[:2], rtol=2e-4)


def test_rope_tends_to_the_catenary(example):
    _, result = example("catenary")
    assert np.all(np.diff(result.distances) < 0.0)


def test_buckled_columns_follow_the_elastica(example):
    _, column = example("self_buckling")
    np.testing.assert_allclose(column.tips, column.exact, atol=2e-4)
    assert np.abs(column.tips).max() > 0.8
    _, pinned = example("euler_column")
    np.testing.assert_allclose(pinned.heights, pinned.exact, atol=3e-4)


def test_twist_leaves_the_axis_only_beyond_the_critical_one(example):
    _, result = example("twisted_rod")
    assert result.departures[result.twists < 0.9].max() < 1e-4
    assert result.departures[-1] > 4e-3
    orders = np.log2(result.errors[:2] / result.errors[1:3])
    assert np.all(orders > 3.5)


def test_ring_that_passed_through_itself_has_lost_two_turns(example):
    _, result = example("michell_ring")
    assert result.lost == pytest.approx(4.0 * np.pi, abs=0.08)


def test_energy_falls_with_damping(example):
    _, result = example("energy")
    assert result.growth < 0.0
    assert np.all(result.total[1:, -1] < -0.3)
    assert abs(result.coarse[-1]) < 0.025


def test_helix_and_cantilever_converge(example):
    _, helix = example("helix")
    assert np.all(helix.errors[:-1] > 12.0 * helix.errors[1:])
    _, refinement = example("refinement")
    assert np.all(np.diff(refinement.errors, axis=1) < 0.0)
    assert refinement.orders[0] > 4.0 and refinement.orders[1] > 3.3


def test_free_fall(example):
    _, result = example("rigid_motion")
    assert result.fall < 1e-8


@pytest.mark.slow
def test_sensitivities_of_each_motion(example):
    _, result = example("sensitivities")
    assert np.all(result.errors.max(axis=1) < [3e-6, 2e-6, 2e-6])


def test_soft_and_stiff_rods_are_stable(example):
    _, result = example("soft_and_stiff")
    assert result.stable
    assert result.errors[0].max() < 4e-8
    assert np.all(np.diff(result.errors, axis=1) < 0.0)
