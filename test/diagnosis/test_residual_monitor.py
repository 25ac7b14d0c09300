# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The live identification notices what E, mu and damping cannot explain, and names suspects."""

import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.monitor.residual_monitor import ResidualMonitor, correlated_residual
from dlo_ros.identification import Manipulation, OnlineEstimator
from dlo_ros.nodes.estimator_thread import EstimatorThread


def watched(recording, guess, pieces=np.inf):
    """What the watch says at the end; it does so many pieces of its work after a picture."""
    estimator, watch = OnlineEstimator(guess, budget=np.inf), ResidualMonitor()
    for imposed in recording.commands:
        estimator.set_command(imposed)
    for observation in recording.observations:
        estimator.observe(observation)
        if estimator.run is not None and watch.due(estimator.run.used):
            run = estimator.run
            watch.look(run.forecast(), run.simulation.settings, estimator.window())
        done = 0
        while watch.busy and done < pieces:
            watch.proceed()
            done += 1
    return watch, estimator


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("simple", 2),
        *(
            pytest.param(*costly, marks=pytest.mark.slow)
            for costly in [("c_shape", 1), ("approach_two", 3)]
        ),
    ],
)
def test_it_is_silent_where_there_is_nothing(name, seed):
    watch, estimator = watched(*moving(name, {}, seed))
    assert watch.suspicion is None
    run = estimator.run
    leftover = correlated_residual(run.forecast(), run.simulation.settings)
    # The noise of a camera was seen, so that it could have found something.
    assert 3e-5 < leftover.noise < 2e-4
    assert leftover.common < 0.5 * leftover.noise


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("c_shape", {"point_mass": {"mass": 0.006, "position": 0.3}}),
        *(
            pytest.param(*costly, marks=pytest.mark.slow)
            for costly in [
                ("c_shape", {"intrinsic_curvature": {"kink": 0.6, "position": 0.15}}),
                ("simple", {"clamp_angle": {"start": 0.25}}),
                ("c_shape", {"surface_friction": {"force": 0.02}}),
            ]
        ),
    ],
)
def test_a_strong_effect_is_among_the_suspects(name, effects):
    watch, _ = watched(*moving(name, effects, 4))
    assert watch.suspicion is not None
    (hidden,) = effects
    assert hidden in [suspect for suspect, _ in watch.suspicion.suspects.found]
    assert hidden in str(watch.suspicion)
    assert "dlo_ros diagnose" in str(watch.suspicion)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param({"clamp_angle": {"start": 0.05}}, marks=pytest.mark.slow),
        {"length_error": {"difference": 0.002}, "camera_rotation": {"angle": 0.008}},
    ],
)
def test_a_set_up_within_its_tolerances_is_no_reason_to_warn(effects):
    recording, guess = moving("simple", effects, 6)
    watch, estimator = watched(recording, guess)
    run = estimator.run
    assert correlated_residual(run.forecast(), run.simulation.settings).correlated
    assert watch.suspicion is None


@pytest.mark.slow
@pytest.mark.long
def test_its_work_comes_in_pieces():
    recording, guess = moving("c_shape", {"point_mass": {"mass": 0.006, "position": 0.3}}, 4)
    at_once, _ = watched(recording, guess)
    sliced, _ = watched(recording, guess, pieces=3)
    # It has begun and is not through yet.
    assert sliced.busy
    assert sliced.suspicion is None
    while sliced.busy:
        sliced.proceed()
    assert at_once.suspicion.suspects.found[0][0] == "point_mass"
    assert sliced.suspicion is not None  # of the first pictures, which need not tell what it is


@pytest.mark.slow
def test_a_jump_in_one_picture_is_no_correlated_residual():
    recording, guess = moving("c_shape", {}, 1)
    seen = list(recording.observations)
    for k in (40, 60):
        shape = seen[k].control_points + np.array([0.0, 0.0, 0.01, 0.0])
        seen[k] = type(seen[k])(seen[k].stamp, shape)
    spoilt = Manipulation("spoilt", recording.commands, tuple(seen))
    watch, _ = watched(spoilt, guess)
    assert watch.suspicion is None


@pytest.mark.slow
def test_the_identifiers_thread_tells_of_it(monkeypatch):
    # Else other tests on the same processors go first.
    monkeypatch.setattr("dlo_ros.nodes.estimator_thread.NICENESS", 0)
    recording, guess = moving("c_shape", {"point_mass": {"mass": 0.006, "position": 0.3}}, 4)
    thread = EstimatorThread(guess, threading.Event().set)
    thread.start()
    outcomes = []
    try:
        for imposed in recording.commands:
            thread.command(imposed)
        for observation in recording.observations:
            thread.observe(observation)  # at once: it looks at all of them, not at the first
        deadline = time.monotonic() + 240.0
        while time.monotonic() < deadline:
            outcomes += thread.take()
            suspicion = outcomes[-1].suspicion if outcomes else None
            if suspicion and suspicion.suspects and suspicion.suspects.found:
                break
            time.sleep(0.05)
    finally:
        thread.stop()
    assert not [o.problem for o in outcomes if o.problem]
    assert "point_mass" in [name for name, _ in outcomes[-1].suspicion.suspects.found]
    # What came of work between splines is marked; every spline has its own outcome.
    assert [o.stamp for o in outcomes if not o.later] == [o.stamp for o in recording.observations]
    for before, after in pairwise(outcomes):
        assert not after.later or after.stamp == before.stamp
