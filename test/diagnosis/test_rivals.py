# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rivals of a cause: what explains the data as well in its place."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
from cause_fits import more_evidence
from rods import PAPER

from dlo_ros.diagnosis.explain import rivals
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of
from dlo_ros.effects import Start


@pytest.fixture(autouse=True)
def evidence_decides(monkeypatch):
    monkeypatch.setattr(rivals, "tells_apart", more_evidence)
    monkeypatch.setattr(rivals, "strained", lambda *_: [])


@dataclass(frozen=True)
class Fit:
    """A fit of a model."""

    model: Any
    posterior: Any


def evaluation(evidence, effects=None):
    """A fit, of a model with effects."""
    settings = SimpleNamespace(effects=effects or {})
    posterior = SimpleNamespace(evidence=evidence)
    return SimpleNamespace(posterior=posterior, model=SimpleNamespace(settings=settings))


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ((30.0, 38.0), ["constant_force"]),  # of 40; at first and in the end
        ((30.0, 36.0), []),
        ((28.0, 38.0), []),  # a fifth less than what it needs: it does not go on
    ],
)
def test_a_rival_does_nearly_as_well_whatever_the_linear_prediction(monkeypatch, gains, expected):
    force = Start("constant_force", {"x": 0.0}, ("x",), ("x",))
    other = Start("air_drag", {"coefficient": 0.0}, ("coefficient",), ("coefficient",))
    offers = [
        SimpleNamespace(proposal=proposal_of(PAPER, start), gain=predicted, model=start.effect)
        for start, predicted in ((force, 20.0), (other, 2.0))
    ]

    def gaining(gain):
        return evaluation(60.0 + gain, {"constant_force": {"x": 0.3}})

    def fitted(model, *_, **__):
        assert model == "constant_force"  # the other one promises far too little
        return gaining(gains[0])

    monkeypatch.setattr(rivals, "in_its_place", lambda *_: [])
    monkeypatch.setattr(rivals, "ranked_proposals", lambda *_: offers)
    monkeypatch.setattr(rivals, "fitted", fitted)
    monkeypatch.setattr(rivals, "fit", lambda *_: gaining(gains[1]))
    tilt = SimpleNamespace(effect="gravity_tilt", label="gravity_tilt")
    at, bare = evaluation(100.0), evaluation(60.0)
    found = rivals.rivals_of((at, tilt), bare, (), (), object(), complete=True)
    assert list(found) == expected
    assert not expected or found["constant_force"].values == {"x": 0.3}
    assert not expected or found["constant_force"].twin  # of a tilt no shapes tell it apart


@pytest.mark.parametrize(("complete", "gain", "expected"), [
    (True, 38.0, ["connector"]), (True, 34.0, []), (False, 34.0, ["connector"]), (False, 31.0, []),
])  # fmt: skip
def test_beside_a_missing_cause_a_plug_as_heavy_is_a_rival_of_a_mass(
    monkeypatch, complete, gain, expected
):
    """Evidence tells two apart no better than four fifths there."""
    plug = evaluation(60.0 + gain, {"connector": {"mass": 0.01}})
    parameter = SimpleNamespace(effect="connector", name="effects.connector.mass")
    proposal = SimpleNamespace(effect="connector", label="connector", parameters=(parameter,))
    monkeypatch.setattr(rivals, "in_its_place", lambda *_: [(plug, proposal)])
    monkeypatch.setattr(rivals, "ranked_proposals", lambda *_: [])
    at, bare = evaluation(100.0), evaluation(60.0)
    mass = SimpleNamespace(effect="point_mass", label="point_mass")
    found = rivals.rivals_of((at, mass), bare, (), (), object(), complete=complete)
    assert found == {name: (plug, proposal, {"mass": 0.01}, False) for name in expected}


@pytest.mark.parametrize(
    ("linear", "gain", "expected"),
    [(5.0, 38.0, ["gravity_tilt"]), (5.0, 36.0, []), (40.0, 38.0, [])],
)
def test_a_set_up_that_is_strained_without_a_cause_may_be_its_rival(
    monkeypatch, linear, gain, expected
):
    """A tilted board does what an even force does: within its tolerance it does part of it."""
    tilt = proposal_of(PAPER, Start("gravity_tilt", {"angle": 0.0}, ("angle",), ("angle",)))
    force = SimpleNamespace(effect="constant_force", label="constant_force")
    same = SimpleNamespace(effect="constant_force", parameters=None)  # no rival of its own
    model = SimpleNamespace(with_prior=lambda parameters: parameters)
    at, bare = Fit(model, SimpleNamespace(evidence=100.0)), evaluation(60.0)
    monkeypatch.setattr(rivals, "in_its_place", lambda *_: [])
    monkeypatch.setattr(rivals, "ranked_proposals", lambda *_: [])
    monkeypatch.setattr(rivals, "strained", lambda *_: [same, tilt])

    def loss(there, group, *, wholly):
        assert there.model is tilt.parameters and group is force and wholly
        return linear

    def without(there, group, _, *, wholly):
        # From the best model, with the prior of a cause.
        assert there.model is tilt.parameters and group is force and wholly
        return evaluation(60.0 + gain, {"gravity_tilt": {"angle": 0.17}})

    monkeypatch.setattr(rivals, "linear_loss", loss)
    monkeypatch.setattr(rivals, "without", without)
    found = rivals.rivals_of((at, force), bare, (), (), object(), complete=True)
    assert {name: rival.values for name, rival in found.items()} == {
        name: {"angle": 0.17} for name in expected
    }


@pytest.mark.parametrize(
    ("effect", "expected"), [("viscoelasticity", ["internal_damping"]), ("constant_force", [])]
)
def test_a_damping_may_be_the_rival_of_its_limit_whatever_derivatives_tell(
    monkeypatch, effect, expected
):
    """A creep that is over at once is a damping of a softer rod: no derivative leads there."""
    monkeypatch.setattr(rivals, "in_its_place", lambda *_: [])
    monkeypatch.setattr(rivals, "ranked_proposals", lambda *_: [])
    damping = SimpleNamespace(
        effect="internal_damping", label="internal_damping",
        parameters=(SimpleNamespace(effect="", name="relaxation_time"),),
    )  # fmt: skip
    monkeypatch.setattr(rivals, "strained", lambda *_: [damping])
    monkeypatch.setattr(rivals, "linear_loss", lambda *_, **__: 1e3)
    monkeypatch.setattr(rivals, "without", lambda *_, **__: evaluation(99.0))
    at = Fit(SimpleNamespace(with_prior=lambda parameters: None), SimpleNamespace(evidence=100.0))
    cause = SimpleNamespace(effect=effect, label=effect)
    found = rivals.rivals_of((at, cause), evaluation(60.0), (), (), object(), complete=True)
    assert list(found) == expected


@pytest.mark.parametrize(("complete", "expected"), [(True, ["connector"]), (False, [])])
def test_what_the_data_do_not_tell_apart_is_a_rival(monkeypatch, complete, expected):
    """Its log evidence is lower by 20 of 40, as chance alone may make it."""
    monkeypatch.setattr(rivals, "tells_apart", lambda *_: False)
    plug = evaluation(80.0, {"connector": {}})
    proposal = SimpleNamespace(effect="connector", label="connector", parameters=())
    monkeypatch.setattr(rivals, "in_its_place", lambda *_: [(plug, proposal)])
    monkeypatch.setattr(rivals, "ranked_proposals", lambda *_: [])
    mass = SimpleNamespace(effect="point_mass", label="point_mass")
    words = (evaluation(100.0), mass), evaluation(60.0), (), (), object()
    assert list(rivals.rivals_of(*words, complete=complete)) == expected
