# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameter sets of the paper's rod, and each of them simulated by itself."""

from dataclasses import replace

import numpy as np
from rods import PAPER, SECOND

from dlo_ros.parameters import DampingParameters
from dlo_ros.rod.boundary.conditions import THETA
from dlo_ros.rod.integration import integrate
from dlo_ros.rod.planar_model import in_plane

TOLERANCE = 2e-5  # of L
LENGTH = PAPER.rod.length
STAMPS = [SECOND // 20, SECOND // 5, SECOND // 2]


def with_tolerance(settings, tolerance=TOLERANCE):
    return replace(settings, simulation=replace(settings.simulation, tolerance=tolerance))


def varied(model, count, seed=3):
    """The model with other stiffness, density, drag and relaxation time in each set."""
    rng = np.random.default_rng(seed)
    for factor in rng.uniform(0.4, 2.5, (count, 2)):
        settings = model.settings.with_material(
            factor[0] * PAPER.rod.young_modulus, factor[1] * PAPER.rod.density
        )
        damping = DampingParameters(
            air_drag=rng.uniform(0.0, 0.2), relaxation_time=rng.uniform(0.0, 0.01)
        )
        yield model.with_settings(replace(settings, damping=damping))


def by_itself(model, boundary, state, imposed, stamps):
    """One set, simulated by the engine that knows every rod."""
    flat = in_plane(model, state, imposed)
    return integrate(model, boundary, state, imposed, stamps, flat=flat)


def assert_as_alone(tracks, models, boundary, states, imposed, stamps, tolerance=TOLERANCE):
    """Every set moves as it does alone, to within the tolerance."""
    assert not tracks.failures
    for k, (model, state) in enumerate(zip(models, states, strict=True)):
        alone = by_itself(model, boundary, state, imposed, stamps)
        moved = (tracks.shapes[k] - alone.shapes)[..., :3]
        assert np.linalg.norm(moved, axis=2).mean(axis=1).max() < tolerance * LENGTH
        if tracks.twists.size:
            np.testing.assert_allclose(tracks.twists[k], alone.twists, atol=2e-2)
        end = tracks.state(k)
        np.testing.assert_array_equal(end.q, tracks.shapes[k, -1])
        np.testing.assert_allclose(end.velocity, alone.state.velocity, atol=2e-2)
        bent = np.abs(alone.state.strains.other).max()
        np.testing.assert_allclose(
            end.strains.other, alone.state.strains.other, atol=2e-3 * (bent + 1.0)
        )
        for name in ("tangent", "director"):
            np.testing.assert_allclose(
                getattr(end.reference, name), getattr(alone.state.reference, name), atol=1e-3
            )
        frames = end.frames[:, :THETA]  # the angles are among the control points
        # In space they depend on the steps by which they came.
        close = 1e-5 if tracks.twists.size else 1e-12
        np.testing.assert_allclose(frames, alone.state.frames[:, :THETA], atol=close)
