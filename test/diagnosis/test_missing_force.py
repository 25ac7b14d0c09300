# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The missing force, against loads that act in a simulation of the whole, nonlinear rod."""

from dataclasses import replace

import numpy as np
import pytest
from measured import at_rest, swing
from rods import PAPER, SECOND, command

from dlo_ros.diagnosis.residuals.missing_force import missing_force
from dlo_ros.identification import Manipulation, forecast
from dlo_ros.identification.residual_noise import with_noise
from dlo_ros.inference.measured import measured
from dlo_ros.observation import Observation
from dlo_ros.spline import SplineBasis

NOISE = 3e-5
SETTINGS = replace(PAPER, simulation=replace(PAPER.simulation, tolerance=5e-5))
LENGTH = SETTINGS.rod.length
WEIGHT = 9.81 * SETTINGS.rod.linear_density


def ends(seconds=2.0, rate=30.0):
    """Both ends held with a slack between them, the second one carried up and down."""
    times = np.arange(0.0, seconds, 1.0 / rate)
    far = np.zeros((len(times), 3))
    far[:, 0] = 0.75 * LENGTH
    far[:, 2] = 0.15 * LENGTH * np.sin(3.0 * times)
    return times, np.stack([0.0 * far, far], axis=1)


def held(names):
    """A manipulation with both ends held; its shapes are to be simulated."""
    times, positions = ends()
    imposed = command(names, times, positions)
    u = SplineBasis(SETTINGS.rod.control_points, LENGTH).greville / LENGTH
    shape = np.zeros((len(u), 4))
    shape[:, 0], shape[:, 2] = 0.75 * LENGTH * u, -1.4 * LENGTH * u * (1.0 - u)
    seen = tuple(Observation(round(t * SECOND), shape) for t in times)
    return Manipulation("held", (imposed,), seen)


MANIPULATIONS = {
    "free": lambda: swing(SETTINGS, seconds=2.0, noise=0.0),
    "clamped": lambda: held(["start", "end"]),
    "pinned": lambda: held(["control_point_1", "control_point_10"]),
}
ACTING = {"free": (0.01, 0.01), "clamped": (0.2, 0.0), "pinned": (0.05, 0.0)}
"""Loads x, z over the weight: along a DLO that hangs between two ends, more weight does little, and
clamps within their tolerances do what a smaller load does between them."""


def seen_with(manipulation, effects, settings=SETTINGS, noise=NOISE):
    """A recording of what a rod with effects does, and what the plain one would do."""
    points = forecast(manipulation, settings.with_effects(effects)).predicted.copy()
    rng = np.random.default_rng(0)
    points[:, :, [0, 2]] += noise * rng.normal(size=points[:, :, [0, 2]].shape)
    seen = tuple(
        replace(o, control_points=p) for o, p in zip(manipulation.observations, points, strict=True)
    )
    recording = measured(Manipulation("pushed", manipulation.commands, seen), settings)
    predicted = forecast(manipulation, settings).predicted
    return with_noise(recording, predicted, settings), predicted


@pytest.mark.long
@pytest.mark.parametrize("name", MANIPULATIONS)
def test_an_even_load_is_found_as_it_acts(name):
    x, z = np.array(ACTING[name]) * WEIGHT
    acting, effects = np.array([x, 0.0, z]), {"constant_force": {"x": x, "z": z}}
    recording, predicted = seen_with(MANIPULATIONS[name](), effects)
    found = missing_force(recording, predicted, SETTINGS, np.linspace(0.0, 1.0, 11) * LENGTH)
    assert not found.force[..., 1].any() and not found.std[..., 1].any()
    off = (found.force - acting)[..., [0, 2]]
    std = found.std[..., [0, 2]]
    assert np.mean(np.abs(off) > 2.0 * std) < 0.1
    assert np.mean(found.force[:, 3:8, 0]) == pytest.approx(x, rel=0.25)
    assert np.median(std[:, 3:8, 0]) < 0.5 * x
    assert missing_force(recording, predicted[:4], SETTINGS, np.array([0.1])) is None


@pytest.mark.parametrize("name", MANIPULATIONS)
def test_where_nothing_is_missing_nothing_is_found(name):
    recording, predicted = seen_with(MANIPULATIONS[name](), {})
    found = missing_force(recording, predicted, SETTINGS, np.linspace(0.0, 1.0, 11) * LENGTH)
    assert np.abs(found.force).max() < 0.05 * WEIGHT
    assert np.mean(np.abs(found.force) > 2.0 * found.std) < 0.05


@pytest.mark.parametrize("name", MANIPULATIONS)
def test_a_dlo_that_is_longer_asks_for_no_load(name):
    """Held at both ends it bulges out as if something blew into it."""
    effects = {"length_error": {"difference": 0.006 * LENGTH}}
    recording, predicted = seen_with(MANIPULATIONS[name](), effects)
    off = np.linalg.norm(recording.observed[:, :, :3] - predicted[:, :, :3], axis=2).mean()
    assert off > 20.0 * NOISE
    found = missing_force(recording, predicted, SETTINGS, np.linspace(0.0, 1.0, 11) * LENGTH)
    assert np.abs(found.force).max() < 0.1 * WEIGHT
    assert np.median(np.abs(found.force)) < 0.02 * WEIGHT


@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("free", {"clamp_angle": {"start": 0.03}}),
        ("clamped", {"clamp_angle": {"end": 0.03}}),
        ("clamped", {"clamp_offset": {"end": (0.001, 0.002)}}),
        ("pinned", {"clamp_offset": {"end": (0.001, 0.002)}}),
    ],
)
def test_an_end_that_is_held_a_little_elsewhere_asks_for_no_load(name, effects):
    """It bends the DLO beside it as only a load of many times the weight could."""
    recording, predicted = seen_with(MANIPULATIONS[name](), effects)
    off = np.linalg.norm(recording.observed[:, :, :3] - predicted[:, :, :3], axis=2).mean()
    assert off > 10.0 * NOISE
    found = missing_force(recording, predicted, SETTINGS, np.linspace(0.0, 1.0, 11) * LENGTH)
    assert np.abs(found.force).max() < 0.05 * WEIGHT
    assert np.mean(np.abs(found.force) > 2.0 * found.std) < 0.05


@pytest.mark.parametrize("share", [0.4, 0.7])
def test_a_weight_is_found_where_it_hangs(share):
    stiff = SETTINGS.with_material(20.0 * SETTINGS.rod.young_modulus, SETTINGS.rod.density)
    # Heavier than what a clamp within its tolerances does.
    mass, place = 0.1 * stiff.rod.linear_density * LENGTH, share * LENGTH
    weighted = {"point_mass": {"mass": mass, "position": place}}
    rest = at_rest(stiff, frames=12, noise=1e-6, same=False)
    recording, predicted = seen_with(rest, weighted, stiff, noise=3e-6)
    u = np.linspace(0.0, LENGTH, 101)
    found = missing_force(recording, predicted, stiff, u)
    pull = found.force[..., 2].mean(axis=0)
    assert u[np.argmin(pull)] == pytest.approx(place, abs=0.12 * LENGTH)
    assert pull.min() < -2.0 * found.std[0, np.argmin(pull), 2]
    far = np.abs(u - place) > 0.35 * LENGTH
    assert np.abs(pull[far]).max() < abs(pull.min())


def test_missing_force_in_space_is_found_out_of_the_plane():
    """A cantilever at rest in space that a small uniform load bends sideways: w L^4 / 8 B."""
    rod, frames = SETTINGS.rod, 20
    basis = SplineBasis(rod.control_points, rod.length)
    load = 0.05 * 9.81 * rod.linear_density
    u = np.linspace(0.0, rod.length, 100)
    aside = load * u**2 * (u**2 - 4 * rod.length * u + 6 * rod.length**2)
    aside /= 24.0 * rod.bending_stiffness
    shape = np.zeros((rod.control_points, 4))
    shape[:, 0] = basis.greville
    settings = replace(SETTINGS, gravity=(0.0, 0.0, -1e-3))  # so that nothing but it bends the rod
    rng = np.random.default_rng(0)
    seen = []
    for k in range(frames):
        points = np.zeros((100, 3))
        points[:, 0], points[:, 1] = u, aside
        control = np.zeros_like(shape)
        control[:, :3] = basis.fit(u, points + 1e-4 * rng.normal(size=points.shape))
        seen.append(Observation(k * SECOND // 30, control))
    imposed = command(["start"], [0.0], np.zeros((1, 3)), n=rod.control_points)
    recording = measured(Manipulation("sideways", (imposed,), tuple(seen)), settings)
    predicted = np.tile(shape, (frames, 1, 1))
    recording = with_noise(recording, predicted, settings)
    found = missing_force(recording, predicted, settings, np.linspace(0.2, 0.8, 7) * rod.length)
    assert found.force.shape == found.std.shape == (frames, 7, 3)
    assert np.mean(found.force[..., 1]) == pytest.approx(load, rel=0.2)
    assert np.abs(np.mean(found.force[..., 2])) < 0.2 * load
    assert (found.std > 0.0).all()
