# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to those pictures in which the DLO has not hit anything yet."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from rods import KNOWN, PAPER

from dlo_ros.diagnosis.contact.undisturbed import (
    LEADS,
    Undisturbed,
    outlier_frames,
    robust_loss,
    undisturbed,
)
from dlo_ros.identification.material_model import material_model
from dlo_ros.identification.residual_noise import with_noise
from dlo_ros.inference.joint import evaluate, simulate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WHITE
from dlo_ros.inference.measured import measured
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.scene import scene
from dlo_ros.inference.thresholds import CERTAIN


def pushed_aside(first, far=0.03):
    """A swing whose tip is far from where it would be from a share of it on; a model too stiff."""
    one = swing(PAPER, seconds=1.2)
    aside = np.zeros((PAPER.rod.control_points, 4))
    aside[:, 2] = far * np.linspace(0.0, 1.0, len(aside)) ** 2
    seen = list(one.observations)
    for k in range(int(first * len(seen)), len(seen)):
        seen[k] = replace(seen[k], control_points=seen[k].control_points + aside)
    recording = measured(replace(one, observations=tuple(seen)), KNOWN)
    begun = simulate(material_model(KNOWN, KNOWN), [recording], ())
    recordings = (with_noise(recording, begun.predicted[0], KNOWN),)
    theta = material_model(KNOWN, KNOWN).theta()
    theta[0] += 0.2
    start = evaluate(material_model(KNOWN, KNOWN).at(theta), recordings)
    return recordings, start


def modulus(at):
    return at.model.settings.rod.young_modulus / PAPER.rod.young_modulus


@pytest.mark.slow
@pytest.mark.parametrize(("first", "far"), [(2.0 / 3.0, 0.03), (0.3, 0.1)])
def test_what_was_right_before_tells_of_what_was_wrong(first, far):
    """Also where most pictures are off: only those before tell what the DLO was."""
    recordings, start = pushed_aside(first, far)
    together = fit(start, recordings, 8, loss=WHITE)
    assert abs(modulus(together) - 1.0) > 0.02
    view = scene(KNOWN, ["start"], [r.observed for r in recordings])
    found = undisturbed(recordings, joint_model(together.model.settings, KNOWN, view))
    assert found is not None
    assert modulus(found.at) == pytest.approx(1.0, abs=0.01)
    (wrong,) = outlier_frames(found.at, recordings, found.scale)
    assert not wrong[: int((first - 0.05) * len(wrong))].any()
    assert wrong[int((first + 0.05) * len(wrong)) :].all()
    assert robust_loss(found.at, recordings, found.scale) < robust_loss(
        together, recordings, found.scale
    )


@pytest.mark.slow
def test_where_nothing_was_hit_nothing_is_disturbed():
    recordings, start = pushed_aside(1.0)
    together = fit(start, recordings, 8, loss=WHITE)
    view = scene(KNOWN, ["start"], [r.observed for r in recordings])
    assert undisturbed(recordings, joint_model(together.model.settings, KNOWN, view)) is None


def test_where_the_nearest_fit_finds_nothing_the_next_is_taken(monkeypatch):
    """A fit to pictures of which some are disturbed may come nearest on the whole."""
    recordings, start = pushed_aside(0.5)
    at, calls = simulate(start.model, recordings, ()), []

    def fitted(_, model, right):
        calls.append(list(right))
        return None if len(calls) == len(LEADS) + 1 else Undisturbed(model, at, CERTAIN)

    monkeypatch.setattr("dlo_ros.diagnosis.contact.undisturbed._fitted", fitted)
    view = scene(KNOWN, ["start"], [r.observed for r in recordings])
    assert undisturbed(recordings, joint_model(start.model.settings, KNOWN, view)) is not None
    assert len(calls) == len(LEADS) + 2
