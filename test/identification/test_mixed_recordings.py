# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings of different kinds together: in the plane and in space, long and of a single shape."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from ordinary import some_of
from rods import PAPER

from dlo_ros.diagnosis import diagnose
from dlo_ros.identification import identify
from dlo_ros.observation import Observation

pytestmark = pytest.mark.long

NOISE = 3e-4


@pytest.fixture(scope="module")
def planar():
    return swing(PAPER)


@pytest.fixture(scope="module")
def spatial(planar):
    """The motion as cameras measure it that see the other direction, too."""
    rng = np.random.default_rng(5)
    seen = []
    for observation in planar.observations:
        shape = observation.control_points.copy()
        shape[:, 1] = NOISE * rng.normal(size=len(shape))
        seen.append(Observation(observation.stamp, shape))
    return replace(planar, name="spatial", observations=tuple(seen))


@pytest.mark.slow
@pytest.mark.parametrize("turned", some_of([False, True], [False]))
def test_recordings_in_the_plane_and_in_space_are_fitted_together(planar, spatial, turned):
    recordings = [spatial, planar] if turned else [planar, spatial]
    found = identify(recordings, PAPER.with_material(2e7, 2000.0))
    ratio = PAPER.rod.specific_modulus
    assert found.estimate.specific_modulus == pytest.approx(ratio, rel=0.02)
    assert all(not r.planar for r in found.fitted.recordings)


def test_what_lies_in_the_plane_alone_is_fitted_there(planar):
    assert identify([planar], PAPER).fitted.recordings[0].planar


@pytest.mark.slow
def test_a_plane_is_diagnosed_beside_what_is_held_out_in_space(planar, spatial):
    short = replace(spatial, observations=spatial.observations[:30])
    assert diagnose([planar], PAPER, holdout=[short]).verdict == "adequate"


def test_too_few_shapes_to_validate_with_leave_the_estimate(planar, caplog):
    single = replace(planar, name="single", start="moving", observations=planar.observations[:1])
    found = identify([planar], PAPER, validate=[single])
    ratio = PAPER.rod.specific_modulus
    assert found.estimate.specific_modulus == pytest.approx(ratio, rel=0.02)
    (line,) = {r.getMessage() for r in caplog.records if "single" in r.getMessage()}
    assert "needs 2 observed shapes" in line
    assert found.recordings[1].err is None
