# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes in a search's result: effects that take enough error away and stand in for no other."""

from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.diagnosis.explain import joint_explanation
from dlo_ros.diagnosis.explain.cause_naming import Cause, without_dampings
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.findings import joint_learning
from dlo_ros.inference.joint import evaluate


@pytest.mark.parametrize(
    ("frames", "left", "off", "named"),
    [
        (12, 2e-3, 1, ["point_mass", "gravity_tilt"]),
        (12, 3e-3, 1, []),  # a camera that creeps may be the reason
        (12, 2.9e-3, 5, ["point_mass", "gravity_tilt"]),
        (12, 3.1e-3, 5, []),
        (3, 3e-3, 1, ["gravity_tilt"]),
        (3, 2e-3, 5, ["point_mass", "gravity_tilt"]),
    ],
)
def test_what_leaves_much_may_stand_for_an_unknown_cause(monkeypatch, frames, left, off, named):
    """And so may anything in a few shapes, where little is wrong for certain, unless it is told as
    one of several.
    """
    monkeypatch.setattr(joint_explanation, "departures", lambda *_: off)
    found = SimpleNamespace(at=SimpleNamespace(mean_err=left), causes=())
    recordings = [SimpleNamespace(times=np.arange(frames))]
    prepared = SimpleNamespace(recordings=recordings, plain_err=6e-3)
    causes = (
        Cause("point_mass", (), {}, 9.0, 5e-3, 0.0),
        Cause("gravity_tilt", (), {"constant_force": {}}, 9.0, 5e-3, 0.0),
    )
    told = joint_explanation._no_stand_ins(causes, found, prepared)
    assert [c.effect for c in told] == named


@pytest.mark.parametrize(
    ("evidence", "err", "causes", "result", "alone"),
    [
        (9.0, 2e-3, (), "setup", "setup"),
        (9.0, 0.5e-3, (), "there", "there"),
        (14.0, 2e-3, (), "there", "setup"),
        (9.0, 2e-3, ("tilt",), "there", "setup"),
        (9.0, 0.5e-3, ("tilt",), "there", "setup"),
    ],
)
def test_without_causes_the_better_of_two_fits_of_the_set_up_counts(
    evidence, err, causes, result, alone
):
    def at(evidence, err):
        return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)

    fits = {"setup": at(10.0, 1e-3), "there": at(evidence, err)}
    found = Search(fits["there"], causes, (), None)
    found, setup = joint_explanation._one_minimum(found, fits["setup"])
    assert found.at is fits[result] and setup is fits[alone]


@pytest.mark.parametrize(
    ("plain", "laws", "added", "least"),
    [
        (20e-3, 4e-3, True, 0.2e-3),  # a late start makes most of what the plain model misses
        (20e-3, 30e-3, True, 1e-3),
        (20e-3, 4e-3, False, 1e-3),  # nothing is asked that an effect would have to answer
        (1.2e-3, 4e-3, True, 0.1e-3),
    ],
)
def test_an_effect_must_do_more_than_mend_the_law_of_another(
    monkeypatch, plain, laws, added, least
):
    monkeypatch.setattr(joint_explanation, "_err_without_laws", lambda *_: laws)
    found = SimpleNamespace(causes=(SimpleNamespace(start=object() if added else None),))
    setup = SimpleNamespace(mean_err=1e-3)
    prepared = SimpleNamespace(plain_err=plain, recordings=())
    assert joint_explanation._nameable_err(found, setup, prepared, 0.0) == pytest.approx(least)


@pytest.mark.slow
def test_clamps_camera_and_time_have_no_law_that_could_be_another():
    """A clamp that is turned, of a rod that is as it should be, leaves the noise alone."""
    at, recordings = fitted_set_up()
    err = joint_explanation._err_without_laws(at, recordings)
    assert err < 1.2 * at.mean_err
    # Where the whole set-up is as it should be, most of the error is back. A tilt and the camera
    # do nearly all that the clamp alone does.
    bare = at.model.without([n for n in at.model.names if n.startswith("effects.")])
    held = joint_explanation._err_without_laws(evaluate(bare, recordings), recordings)
    assert held > 2.0 * err


@pytest.mark.slow
def test_a_fit_that_has_left_the_shapes_is_taken_where_it_comes_near_them(monkeypatch):
    """Errors that stay are cheap, where a motion tells more; what they may not explain is left."""
    fitted, recordings = fitted_set_up()
    given = fitted.model.settings
    theta = fitted.model.theta()
    theta[fitted.model.index("young_modulus")] += 0.3
    strayed = evaluate(fitted.model.at(theta), recordings, fitted.variances)
    assert strayed.mean_err > 5.0 * fitted.mean_err
    near = joint_explanation._near_shapes(strayed, recordings, given)
    assert near.mean_err < 0.5 * strayed.mean_err
    assert joint_explanation._near_shapes(fitted, recordings, given) is fitted
    # A later fit to the same shapes does not leave them either.
    monkeypatch.setattr(joint_learning, "fit", lambda *_, **__: strayed)
    assert joint_learning.refitted(fitted, recordings).mean_err < 1.01 * fitted.mean_err


def test_dampings_are_no_causes_beside_a_model_that_lacks_something():
    """The loss or delay by any missing law looks like a damping."""
    parameters = [
        SimpleNamespace(name="air_drag", effect=""),
        SimpleNamespace(name="effects.point_mass.mass", effect="point_mass"),
    ]
    at = SimpleNamespace(model=SimpleNamespace(parameters=parameters))
    mass = Cause("point_mass", ("effects.point_mass.mass",), {}, 9.0, 5e-3, 0.0)
    drag = Cause("air_drag", ("air_drag",), {}, 9.0, 5e-3, 0.0)
    assert without_dampings((mass, drag), at) == (mass,)
