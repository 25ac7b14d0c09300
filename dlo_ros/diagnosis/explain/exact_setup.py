# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes beside a set-up that is as precise as the data tell, such as that of a simulation.

A set-up that is open within its tolerances does the work of a weak cause, and pays nothing for it:
all of its numbers are free anyway. One that is held at neutral has no such numbers, and the log
evidence tells whether a cause or two explain the data without them.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.explain.candidate_trials import best_trials
from dlo_ros.diagnosis.explain.cause_search import Search, search
from dlo_ros.diagnosis.explain.offered_effects import offered, ranked_proposals
from dlo_ros.diagnosis.explain.trials import Trial
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import Start, effects
from dlo_ros.effects.base import MEASUREMENT
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate
from dlo_ros.inference.joint_fit import settled
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.thresholds import CERTAIN, FEWEST_FRAMES, MUCH_LARGER, WORTH
from dlo_ros.inference.variances import posterior

LOG = logging.getLogger(__name__)

TIGHT = 1e-4
"""Prior standard deviation of such a set-up's numbers, in tolerances: less than shapes tell."""
SHARED = 0.3
"""Error that all measured points share, over the std of a single one: a threshold or a shade on the
DLO shifts them alike, in rendered pictures by a third of it and less."""


def exact(model: ParametricModel, recordings: Sequence[Recording] = ()) -> ParametricModel:
    """The model with its set-up held at neutral.

    Args:
        recordings: recordings whose points hold the camera no better than they tell.
    """
    shared = SHARED * _points_std(recordings)
    tight = [
        p.tightened(max(TIGHT, _seen_as(p, shared, model.settings.rod.length)))
        for p in model.parameters if p.tolerated
    ]  # fmt: skip
    return model.centred([p.name for p in tight]).with_prior(tight)


def opened(at: Evaluation) -> Evaluation:
    """A fit whose set-up is open within its tolerances, at the values of another fit."""
    model = at.model.with_prior([p.tightened(1.0) for p in at.model.parameters if p.tolerated])
    found = posterior(at.spectra, at.variances, model.offset(), model.precision())
    return replace(at, model=model, posterior=found)


def _points_std(recordings: Sequence[Recording]) -> float:
    """Median std of single measured points [m]; 0 where only splines were measured."""
    observations = [o for r in recordings for o in r.manipulation.observations]
    stds = [np.median(o.points.std) for o in observations if o.points is not None]
    return float(np.median(stds)) if stds else 0.0


def _of_camera(p: Parameter) -> bool:
    """Whether a part of the set-up changes how a DLO is seen, and not what it does."""
    return MEASUREMENT in effects()[p.effect].acts_on


def _seen_as(p: Parameter, error: float, length: float) -> float:
    """Tolerances of the camera by which all points seem to be shifted; 0 of all but the camera.

    Args:
        error: the shift [m].
        length: length of the DLO [m].
    """
    if not _of_camera(p):
        return 0.0
    sizes = {"m": error, "rad": error / length, "": error / length}
    return sizes.get(p.unit, 0.0) * p.tightness / p.std


def beside_exact_set_up(
    found: Search, meant: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], enough: float, contact: Trial | None,
) -> Search | None:  # fmt: skip
    """Causes beside an exact set-up, where they explain the data better than those beside another.

    Those that are known already are enough where they leave nothing but white errors.

    Args:
        found: causes beside a set-up that is open within its tolerances.
        meant: model from where a fit without causes starts.
        begun, enough: see `cause_search.search`.
        contact: what was hit, if anything was.

    Returns:
        None where the data tell of no such set-up; errors that are not white can only be told
        where there are several frames.
    """
    separable = all(len(r.times) >= FEWEST_FRAMES for r in recordings)
    if not separable or _coloured(found.at) > MUCH_LARGER:
        return None
    try:
        there = replace(found, at=_fitted(found.at.model, recordings), offer=None, passed=())
        if not _white(there.at):
            known = None if contact is None else contact[1]
            alone = there.at
            if known is None or len(found.causes) > 1:
                alone = _fitted(meant if contact is None else contact[0].model, recordings)
            wanted = found.at.posterior.evidence + WORTH
            there = _searched(alone, recordings, begun, enough, known, wanted)
            there = replace(there, trace=(*found.trace, *there.trace))
    except SimulationError as err:
        LOG.info("with an exact set-up: %s", err)
        return None
    gain = log_bayes_factor(there.at, found.at)
    LOG.info("with an exact set-up: %+.1f in evidence", gain)
    return there if gain >= WORTH else None


def _fitted(model: ParametricModel, recordings: Sequence[Recording]) -> Evaluation:
    """The fit beside an exact set-up, with a camera that is off as far as points are in common;
    with one that is held where that does not suffice.
    """
    at = settled(evaluate(exact(model, recordings), recordings), recordings)
    off = zip(at.model.parameters, at.model.offset(), strict=True)
    suffices = all(abs(x) <= CERTAIN * p.std for p, x in off if p.tolerated and _of_camera(p))
    if suffices or not _points_std(recordings):
        return at
    return settled(evaluate(exact(model), recordings), recordings)


def _searched(
    alone: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start], enough: float,
    known: Proposal | None, wanted: float,
) -> Search:  # fmt: skip
    """A search beside an exact set-up.

    A first cause is looked for however little is left, and another one in its place where its
    explanation leaves more than white errors.

    Args:
        alone: the fit without causes but that which is known already.
        known: that cause; None: there is none.
        wanted: log evidence without which it is in vain, see `search`.
    """

    def beside(at: Evaluation, cause: Proposal) -> Search:
        return search(at, alone.model, recordings, begun, enough, present=(cause,), wanted=wanted)

    if known is not None:
        return beside(alone, known)
    ranked = ranked_proposals(alone, offered(alone, recordings, begun))
    trials, trace = best_trials(1, alone, [(alone, ranked)], recordings)
    if not trials:
        return Search(alone, (), tuple(trace), None)
    there = beside(*trials[0])
    trace += there.trace
    if len(there.causes) == 1 and not _white(there.at):
        others = [p for p in ranked if p.proposal.effect != there.causes[0].effect]
        trials, steps = best_trials(1, there.at, [(alone, others)], recordings)
        trace += steps
        if trials:
            there = beside(*trials[0])
            trace += there.trace
    return replace(there, trace=tuple(trace))


def _white(at: Evaluation) -> bool:
    """Whether nothing but noise is left."""
    return _coloured(at) <= 1.0 / MUCH_LARGER


def _coloured(at: Evaluation) -> float:
    """Errors of the measurement that are not white over those that are, root mean squares."""
    white = sum(float(np.sum(v.white)) for v in at.variances)
    other = sum(float(np.sum(v.nodal + v.fading + v.lasting + v.rough)) for v in at.variances)
    return float(np.sqrt(other / white))
