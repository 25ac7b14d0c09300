# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a DLO is, told from the time before it hits something."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_candidates import KNOWN
from measured import swing
from rods import PAPER

from dlo_ros.diagnosis.fitting.initial_fit import begin
from dlo_ros.diagnosis.fitting.worker_processes import Problem
from dlo_ros.diagnosis.selection.effect_search import candidate
from dlo_ros.diagnosis.selection.pre_contact import alone_before

DRAG = 0.05
"""That is not in the parameter file [N s/m^2]."""


def silent(text, share):
    pass


def struck(air_drag, first=0.6, far=0.15):
    """A swing of 2 s that is somewhere else from a share of it on, and its plain fit."""
    one = swing(replace(PAPER, damping=replace(PAPER.damping, air_drag=air_drag)), noise=1e-4)
    aside = np.zeros((PAPER.rod.control_points, 4))
    aside[:, 2] = far * np.linspace(0.0, 1.0, len(aside)) ** 2
    seen = [
        replace(o, control_points=o.control_points + aside * (k > first * len(one.observations)))
        for k, o in enumerate(one.observations)
    ]
    beginning = begin([replace(one, observations=tuple(seen))], KNOWN)
    problem = Problem(beginning.recordings, KNOWN, beginning.recordings)
    return problem, candidate("", "", beginning.at, KNOWN)


@pytest.mark.slow
def test_an_effect_that_a_hit_covers_is_told_from_before():
    problem, plain = struck(PAPER.damping.air_drag + DRAG)
    found = alone_before(problem, plain, ("start",), 1, silent)
    assert found and "air_drag" in [c.effect for c in found]
    (drag,) = (c for c in found if c.effect == "air_drag")
    value = drag.at.model.settings.effects["air_drag"]["coefficient"]
    assert value == pytest.approx(DRAG, rel=0.05)
    # Held against all of the recording, it explains nothing after the hit.
    assert len(drag.at.residuals[0]) == len(plain.at.residuals[0])
    assert drag.root_autocovariance > 0.5 * plain.root_autocovariance


def test_where_nothing_is_wrong_before_nothing_is_told():
    problem, plain = struck(PAPER.damping.air_drag)
    assert alone_before(problem, plain, ("start",), 1, silent) == []
