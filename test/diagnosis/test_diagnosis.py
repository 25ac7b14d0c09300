# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Diagnosis: its linear algebra against dense answers, its decisions, and whole cases."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from rods import KNOWN, PAPER

from dlo_ros.diagnosis import diagnose
from dlo_ros.effects import Start, effects, starts
from dlo_ros.errors import InputError
from dlo_ros.identification import Manipulation
from dlo_ros.identification.material_model import material_model
from dlo_ros.identification.offline.initial_fit import begin, fitted
from dlo_ros.identification.residual_noise import whitened, with_noise
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.losses import WhiteLoss
from dlo_ros.inference.measured import measured
from dlo_ros.inference.priors import cause_priors
from dlo_ros.inference.scene import scene
from dlo_ros.observation import CentrelinePoints
from dlo_ros.spline import SplineBasis

pytestmark = pytest.mark.long


def test_what_was_measured_beforehand_stays_near_its_value():
    known, guess = "air_drag", "young_modulus"
    model = material_model(KNOWN, KNOWN)
    theta = model.theta()
    assert theta == pytest.approx([p.centre for p in model.parameters])
    theta[[model.index(known), model.index(guess)]] += 20.0
    moved = model.at(theta).settings
    drag, std = KNOWN.damping.air_drag, KNOWN.damping.air_drag_std
    assert moved.damping.air_drag == pytest.approx(drag * np.exp(4.0 * std / drag))
    assert moved.rod.young_modulus == 1e12
    widths = {p.name: p.std for p in model.parameters}
    assert widths[known] == pytest.approx(std / drag) and widths[guess] == 4.0


def test_every_effect_is_looked_for():
    one = swing(PAPER, seconds=0.5)
    shapes = np.array([o.control_points[:, :3] for o in one.observations])
    found = scene(KNOWN, one.commands[0].names, [shapes])
    names = {s.effect for s in starts(found)}
    # Pegs: see test_contact_search.py; every set-up has some of the others.
    assert names == set(effects()) - {
        "obstacle",
        "clamp_offset",
        "grip_offset",
        "grip_angle",
        "camera_shift",
        "anisotropy",
        "twisting_stiffness",
    }
    assert found.clamps == ("start",)
    # Damping that is a guess is fitted anyway, and cannot be exceeded.
    guessed = starts(replace(found, clamps=(), known=()))
    clamps = {"clamp_angle", "clamp_compliance"}
    assert {s.effect for s in guessed} == names - clamps - {"air_drag", "internal_damping"}


@pytest.mark.slow
def test_a_plain_swing_is_adequate():
    found = diagnose([swing(PAPER, seconds=1.0), swing(PAPER, seconds=1.0, seed=1)], KNOWN)
    assert found.verdict == "adequate"
    assert found.effects == ()
    assert found.extended.settings.effects == {}
    assert found.baseline.err_holdout == pytest.approx(found.noise_floor, rel=0.3)
    assert found.baseline.specific_modulus[0] == pytest.approx(PAPER.rod.specific_modulus, rel=0.02)


def test_noise_is_told_from_what_repeats():
    manipulation = swing(PAPER, seconds=1.0, noise=3e-4)
    beginning = begin([manipulation], KNOWN)
    (recording,) = beginning.recordings
    n = PAPER.rod.control_points
    # 120 points of 0.3 mm each, of which a coefficient is a mean.
    assert np.median(recording.noise[:n]) == pytest.approx(3e-4 / 120**0.5, rel=0.3)
    assert beginning.error < 0.2 * 3e-4
    assert len(beginning.at.model.parameters) == 4
    again = fitted(beginning.at.model, beginning.recordings)
    assert again.model.theta() == pytest.approx(beginning.at.model.theta(), abs=1e-3)


def test_a_repeated_picture_counts_once():
    one = swing(PAPER, seconds=0.2)
    twice = tuple(o for o in one.observations for _ in range(3))
    recording = measured(replace(one, observations=twice), KNOWN)
    assert len(recording.times) == len(one.observations)


def test_what_cannot_be_diagnosed_is_refused():
    one = swing(PAPER, seconds=0.2)
    with pytest.raises(InputError, match="no recording"):
        diagnose([], KNOWN)
    with pytest.raises(InputError, match="dlo/command"):
        diagnose([Manipulation("bare", (), one.observations)], KNOWN)
    with pytest.raises(InputError, match="dlo/observed"):
        diagnose([Manipulation("blind", one.commands, ())], KNOWN)
    other = replace(KNOWN, rod=replace(KNOWN.rod, control_points=12))
    with pytest.raises(InputError, match="control_points"):
        diagnose([one], other)


def test_a_peg_that_is_hit_has_derivatives_of_a_sensible_size():
    """Exact sensitivities through impacts grow beyond all bounds; differences answer to steps."""
    one = swing(KNOWN, seconds=0.8)
    recording = replace(measured(one, KNOWN), spans=14)
    length = KNOWN.rod.length
    peg = {"x": 0.45 * length, "z": -0.45 * length, "radius": 0.01}
    parameters, _ = cause_priors(KNOWN, Start("obstacle", peg, (), tuple(peg), neutral=False))
    model = material_model(KNOWN, KNOWN).extended("obstacle", peg, parameters)
    ((_, jacobian),) = simulate(model, [recording]).fields
    assert np.isfinite(jacobian).all()
    moves = np.abs(jacobian).max(axis=(0, 2))
    assert (moves[4:6] < 3.0).all()  # metres per metre


def test_a_step_stops_at_what_was_measured_and_the_rest_goes_on():
    """With one unknown at its border the others take the least squares answer without it."""
    hidden = replace(KNOWN, damping=replace(KNOWN.damping, air_drag=5.0 * KNOWN.damping.air_drag))
    one = swing(hidden, seconds=1.0)
    begun = begin([one], KNOWN)
    at, found = begun.at, begun.at.model.settings
    factor = np.exp(4.0 * KNOWN.damping.air_drag_std / KNOWN.damping.air_drag)
    assert found.damping.air_drag < 1.0001 * factor * KNOWN.damping.air_drag
    # It is not explained away.
    left = whitened(at, begun.recordings)
    assert np.mean([np.mean(r[1:] * r[:-1]) for r in left]) > 4.0
    # The rest is at its least squares answer with what has met its border left there.
    loss = WhiteLoss([r.noise for r in begun.recordings])
    hessian, gradient = loss.normal_equations(at)
    hessian += np.diag(at.model.precision())
    gradient += at.model.precision() * at.model.offset()
    inside = [k for k, p in enumerate(at.model.parameters) if p.guessed or abs(gradient[k]) < 1.0]
    assert 0 in inside
    assert np.abs(np.linalg.solve(hessian[np.ix_(inside, inside)], gradient[inside]))[0] < 0.02


def test_what_a_camera_sees_wrongly_in_every_picture_counts_as_noise():
    """Points that scatter less than their std says repeat their errors in every picture."""
    one, count, noise = swing(KNOWN, seconds=0.6, noise=3e-4), 120, 3e-4
    true = measured(swing(KNOWN, seconds=0.6, noise=0.0), KNOWN).observed
    u = np.linspace(0.0, KNOWN.rod.length, count)

    def stated(std):
        def with_points(o):
            basis = SplineBasis(len(o.control_points), KNOWN.rod.length)
            seen = basis.matrix(u) @ o.control_points[:, :3]
            return replace(o, points=CentrelinePoints(seen, u, np.full(count, std)))

        return replace(one, observations=tuple(map(with_points, one.observations)))

    for std in (noise, 4.0 * noise):
        recording = measured(stated(std), KNOWN)
        n = recording.observed.shape[1]
        noisy = with_noise(recording, true, KNOWN)
        assert noisy.noise[:n].min() >= std / np.sqrt(count)
    assert np.median(noisy.noise[:n]) == pytest.approx(std / np.sqrt(count))
