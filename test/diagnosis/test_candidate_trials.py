# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals that are tried: which is added, why the others are not, and where fits begin."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.explain import candidate_trials, trial_beginnings
from dlo_ros.diagnosis.explain import trials as trials_module
from dlo_ros.diagnosis.proposals.linear_evidence import PredictedGain, proposal_of, with_proposals
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint_fit
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors
from dlo_ros.inference.thresholds import INDISPENSABLE


def evaluation(evidence, err):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


def best_of(
    monkeypatch,
    fits,
    ends=None,
    promised=None,
    least=np.inf,
    near=None,
    vitals=(),
    begun=(),
    own=0.0,
    apart=1.1,
    freed=(),
):
    """The cause that is added, and what became of each, by name.

    Args:
        fits: evidence and ERR [m] of short fits.
        ends: the same of those that are fitted to the end, where that is not where they began.
        promised: predicted gains, of which the first come nearest; default: all gain alike.
        least: see `best_trials`.
        near: ERR [m] to which fits can come, by their evidence; default: that of the fits.
        vitals: names of those on which E depends.
        begun: names of those whose fits have begun already.
        own: ERR of the measurement alone [m].
        apart: ERR with which one begins over that of the one before.
        freed: names of numbers of the set-up.
    """
    promised = promised or dict.fromkeys(fits, 10.0)
    proposals = {
        name: SimpleNamespace(
            label=name, start=None if name in freed else object(), effect=name.partition(" (")[0]
        )
        for name in fits
    }
    promises = [
        SimpleNamespace(proposal=proposals[name], gain=gain, model=name)
        for name, gain in promised.items() if name not in begun
    ]  # fmt: skip
    names = list(promised)

    def beginning(_, predicted, __):
        err = 1e-3 * apart ** names.index(predicted.model)
        vital = predicted.model in vitals or predicted.gain > INDISPENSABLE
        return trial_beginnings.TrialBeginning(predicted, err, vital)

    def short(model, *_, **__):
        return evaluation(*fits[model])

    def long(found, *_, **__):
        name = next(n for n, (gain, _) in fits.items() if gain == found.posterior.evidence)
        return evaluation(*(ends or {}).get(name, fits[name]))

    def approached(at, _):
        evidence = at.posterior.evidence
        return evaluation(evidence, (near or {}).get(evidence, at.mean_err))

    monkeypatch.setattr(joint_fit, "approached", approached)
    monkeypatch.setattr(candidate_trials, "has_common_moments", lambda p: "sudden" in p.label)
    monkeypatch.setattr(trials_module, "own_err", lambda *_: own)
    monkeypatch.setattr(candidate_trials, "beginning", beginning)
    monkeypatch.setattr(candidate_trials, "fitted", short)
    monkeypatch.setattr(candidate_trials, "fit", long)
    at = evaluation(0.0, 2e-3)
    trials = [(evaluation(*fits[name]), proposals[name]) for name in begun]
    best, trace = candidate_trials.best_trials(1, at, [(at, promises)], (), least, trials)
    return best[0][1].label if best else None, {step.name: step.outcome for step in trace}


def test_what_gains_most_is_added(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 1.5e-3)})
    assert added == "tilt"
    assert told == {"tilt": "added", "mass": "fitted, but another gains more"}


def test_of_what_gains_alike_the_nearest_to_the_shapes_is_added(monkeypatch):
    fits = {"creep": (1000.0, 1.5e-3), "damping": (995.0, 1.0e-3), "segment": (950.0, 0.5e-3)}
    assert best_of(monkeypatch, fits)[0] == "damping"


@pytest.mark.parametrize(("gain", "added"), [(58.0, "tilt"), (56.9, "force")])
def test_of_what_evidence_does_not_tell_apart_the_set_up_is_named(monkeypatch, gain, added):
    """An even force does nearly what a tilted board does, and has numbers of its own."""
    fits = {"force": (60.0, 0.8e-3), "tilt": (gain, 0.82e-3), "drag": (59.5, 0.81e-3)}
    assert best_of(monkeypatch, fits, freed=("tilt",))[0] == added
    # One that is added is no likelier than another.
    assert best_of(monkeypatch, fits)[0] == "force"


def test_what_moves_predictions_away_from_the_shapes_is_not(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 4e-3)})
    assert added == "mass"
    assert told == {"tilt": "makes matters worse", "mass": "added"}
    added, told = best_of(monkeypatch, {"tilt": (20.0, 4e-3)})
    assert added is None and told == {"tilt": "makes matters worse"}


def test_what_leaves_nothing_but_the_measurement_s_error_may_lie_farther_from_the_shapes(
    monkeypatch,
):
    """A creep beside a friction gained 2852: 1.04 mm instead of 0.89, where a camera errs 0.90."""
    fits = {"drag": (200.0, 1.9e-3), "creep": (2852.0, 2.3e-3)}
    assert best_of(monkeypatch, fits, own=1.9e-3)[0] == "creep"
    assert best_of(monkeypatch, fits, own=1.7e-3)[0] == "drag"


def test_a_fit_that_can_come_nearer_to_the_shapes_may_have_left_them(monkeypatch):
    """While other causes are missing, it holds slow errors for noise."""
    fits = {"hysteresis": (9.0, 1e-3), "creep": (500.0, 2.5e-3)}
    assert best_of(monkeypatch, fits, near={500.0: 1.5e-3, 0.0: 1.9e-3})[0] == "creep"
    assert best_of(monkeypatch, fits, near={500.0: 1.95e-3, 0.0: 1.9e-3})[0] == "hysteresis"


def test_a_fit_that_has_only_begun_may_lie_farther_from_the_shapes(monkeypatch):
    fits = {"mass": (9.0, 1e-3), "friction": (20.0, 2.1e-3)}
    added, told = best_of(monkeypatch, fits, {"friction": (24.0, 0.7e-3)})
    assert added == "friction"
    assert told == {"friction": "added", "mass": "fitted, but another gains more"}


def test_of_fits_that_have_only_begun_and_gain_alike_all_go_on(monkeypatch):
    """A friction gained 960 and a creep 942; in the end they were 960 and 1038."""
    fits = {"friction": (960.0, 1e-3), "creep": (942.0, 1e-3), "mass": (500.0, 1e-3)}
    ends = {"creep": (1038.0, 1e-3), "mass": (2000.0, 1e-3)}
    assert best_of(monkeypatch, fits, ends)[0] == "creep"
    assert best_of(monkeypatch, fits, ends, begun=["creep"])[0] == "creep"


def test_one_trial_is_that_of_the_largest_predicted_gain(monkeypatch):
    fits = {f"mass {k}": (9.0 + k, 1e-3) for k in range(4)} | {"friction": (20.0, 1e-3)}
    promised = dict.fromkeys(fits, 60.0) | {"friction": 190.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "friction"
    near = {"mass 2": "others come nearer", "mass 3": "others come nearer"}
    assert near.items() <= told.items() and len(told) == len(fits)


def test_of_those_that_begin_equally_near_the_likeliest_are_fitted(monkeypatch):
    """A few steps tell nothing of two that do the same, such as a tilt and an even force."""
    fits = {name: (9.0 + k, 1e-3) for k, name in enumerate(("creep", "mass", "force", "tilt"))}
    promised = {"creep": 40.0, "mass": 10.0, "force": 13.0, "tilt": 30.0}
    _, told = best_of(monkeypatch, fits, promised=promised, apart=1.001)
    assert told["mass"] == "others come nearer"
    _, told = best_of(monkeypatch, fits, promised=promised, apart=1.1)
    assert told["force"] == "others come nearer"


def test_trials_are_those_of_different_effects(monkeypatch):
    """Starts of one effect that come near do not leave another one untried."""
    creep = {f"creep ({k})": (20.0 + k, 1e-3) for k in range(3)}
    added, told = best_of(monkeypatch, creep | {"friction": (90.0, 1e-3)})
    assert added == "friction"
    assert told["creep (2)"] == "others come nearer"


def test_of_an_effect_the_likeliest_start_is_fitted_beside_the_nearest(monkeypatch):
    """A stiffer stretch of 153, and the softer rest beside it of 120, that began nearer."""
    fits = {"segment (2)": (83.0, 1e-3), "creep": (9.0, 1e-3), "mass (1)": (8.0, 1e-3)}
    fits |= {"segment (1)": (330.0, 1e-3), "segment (3)": (7.0, 1e-3), "mass (2)": (6.0, 1e-3)}
    promised = dict.fromkeys(fits, 120.0) | {"segment (1)": 153.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "segment (1)"
    assert told["segment (2)"] == "fitted, but another gains more"
    assert told["segment (3)"] == told["mass (2)"] == "others come nearer"


def test_what_seems_to_go_on_may_have_happened_at_once(monkeypatch):
    """At moments that are not the right one, a sudden slip is predicted to gain little."""
    fits = {
        "slip (even)": (100.0, 1.5e-3), "slip (sudden)": (900.0, 0.5e-3), "slip (later, sudden)": (
            990.0, 0.4e-3),
    }  # fmt: skip
    promised = {"slip (even)": 100.0, "slip (sudden)": 20.0, "slip (later, sudden)": 10.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "slip (sudden)"
    assert told["slip (even)"] == "fitted, but another gains more"
    assert told["slip (later, sudden)"] == "predicted to gain less"  # its moment is tried later


def test_a_small_gain_is_no_cause(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (2.0, 1e-3)})
    assert added is None and told == {"mass": "gains too little"}


def test_nothing_is_fitted_where_no_proposal_comes_near_enough(monkeypatch):
    fits = {"mass": (9.0, 1e-3), "tilt": (20.0, 1e-3)}
    assert best_of(monkeypatch, fits, least=1e-3)[0] == "tilt"  # the first steps lead to 1 mm
    added, told = best_of(monkeypatch, fits, least=0.9e-3)
    assert added is None
    assert told == dict.fromkeys(fits, "takes too little")
    # A creep gains so much however little of ERR it takes; on another effect E depends.
    assert best_of(monkeypatch, fits, promised={"mass": 10.0, "tilt": 80.0}, least=0.9e-3)[0]
    added, told = best_of(monkeypatch, fits, least=0.9e-3, vitals=["mass"])
    assert added == "mass"
    assert told == {"mass": "added", "tilt": "takes too little"}


def test_the_best_start_of_each_effect_is_simulated(monkeypatch):
    """A creep is predicted to gain too little: it acts otherwise when it is large."""
    fits = {f"slip ({k})": (20.0, 1e-3) for k in range(12)} | {"creep": (90.0, 1e-3)}
    promised = {name: 100.0 - k for k, name in enumerate(fits)} | {"creep": 5.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "creep"
    less = {name for name, outcome in told.items() if outcome == "predicted to gain less"}
    assert less == {"slip (9)", "slip (10)", "slip (11)"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("least", "most"), [(0.0, np.inf), (0.0, 6.1), (2.96, 4.48)])
def test_the_size_of_what_begins_at_a_finite_one_is_looked_for(monkeypatch, least, most):
    """A yield at one and a half times the curvature from which it is looked for.

    Args:
        least, most: yield curvatures between which alone anything can be simulated.
    """
    keys = ("yield_curvature", "hardening")
    start = Start("plasticity", {keys[0]: 4.0, keys[1]: 0.35}, keys, keys, neutral=False)
    begin, _ = with_proposals(
        ParametricModel(PAPER, material_priors(PAPER)), [proposal := proposal_of(PAPER, start)]
    )

    def simulate(model, *_):
        curvature = model.settings.effects["plasticity"]["yield_curvature"]
        if not least <= curvature <= most:
            raise SimulationError("it does not converge")
        off = np.log(curvature / 6.0)
        return SimpleNamespace(mean_err=1e-3 * (1.0 + off**2))

    monkeypatch.setattr(trial_beginnings, "simulate", simulate)
    promise = PredictedGain(proposal, 10.0, begin, begin)
    found = trial_beginnings._nearest_size(promise, ()).settings.effects["plasticity"]
    # Where the range ends, few trials come as near as that.
    assert found["yield_curvature"] == pytest.approx(
        min(6.0, most), rel=0.05 if most > 6.0 else 0.12
    )
    assert found["hardening"] == 0.35


def test_the_place_of_what_the_dlo_hits_is_looked_for(monkeypatch):
    """A table that leans, 2 cm above where it is looked for."""
    keys = ("offset", "angle")
    start = Start("wall", {keys[0]: -0.20, keys[1]: 0.0}, keys, keys, neutral=False, form="table")
    begin, _ = with_proposals(
        ParametricModel(PAPER, material_priors(PAPER)), [proposal := proposal_of(PAPER, start)]
    )

    def simulate(model, *_):
        wall = model.settings.effects["wall"]
        off = (wall["offset"] + 0.18) / 0.05, (wall["angle"] - 0.04) / 0.1
        return SimpleNamespace(mean_err=1e-3 * (1.0 + np.hypot(*off)))

    monkeypatch.setattr(trial_beginnings, "simulate", simulate)
    found = trial_beginnings._nearest_size(PredictedGain(proposal, 10.0, begin, begin), ())
    wall = found.settings.effects["wall"]
    assert wall["offset"] == pytest.approx(-0.18, abs=5e-3)
    assert wall["angle"] == pytest.approx(0.04, abs=0.01)


def test_what_has_no_size_is_simulated_where_it_is_promised():
    peg = {"x": 0.1, "z": -0.1, "radius": 0.01}
    for start in (
        Start("obstacle", peg, (), tuple(peg), neutral=False),
        Start("wall", {"offset": -0.2, "angle": 0.0}, ("offset",), ("offset",), neutral=False),
        Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",)),
    ):
        assert trial_beginnings._size(proposal_of(PAPER, start)) is None


@pytest.mark.parametrize(
    ("gains", "errs", "nearest", "taken"),
    [
        # Gains alike, and both can come as near: the evidence decides, wherever the fits lie.
        ((1078.0, 1107.0), (0.91e-3, 1.29e-3), (0.605e-3, 0.597e-3), "trial"),
        ((1107.0, 1078.0), (1.29e-3, 0.91e-3), (0.605e-3, 0.597e-3), "first"),
        ((1078.0, 1107.0), (0.91e-3, 1.29e-3), (0.5e-3, 0.6e-3), "first"),  # clearly nearer
        ((500.0, 1107.0), (0.91e-3, 1.29e-3), (0.5e-3, 0.6e-3), "trial"),  # gains less
        ((1.0, 2.0), (0.91e-3, 1.29e-3), (0.5e-3, 0.6e-3), None),
        ((1107.0, None), (0.91e-3, None), (0.5e-3, None), "first"),
    ],
)
def test_a_cause_found_from_afar_competes_by_how_near_it_can_come(
    monkeypatch, gains, errs, nearest, taken
):
    """A plug that was fitted 1.29 mm off was taken for a mass, found from afar, at 0.91 mm."""
    trials = [
        None if gain is None else (evaluation(gain, err), name)
        for gain, err, name in zip(gains, errs, ("first", "trial"), strict=True)
    ]
    reached = {id(t[0]): near for t, near in zip(trials, nearest, strict=True) if t is not None}
    monkeypatch.setattr(trials_module, "nearest_err", lambda at, _: reached[id(at)])
    found = trials_module.best_with(*trials, evaluation(0.0, 9e-3), ())
    assert (found and found[1]) == taken
