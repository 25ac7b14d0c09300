# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where the fit of a proposal begins: a few steps from what its linear prediction promises."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from dlo_ros.diagnosis.explain.certainty import has_other_stiffness
from dlo_ros.diagnosis.proposals.linear_evidence import PredictedGain, Proposal, joined
from dlo_ros.effects import effects, quantities
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, Simulated, borrowed, simulate, with_variances
from dlo_ros.inference.joint_fit import approached
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.thresholds import INDISPENSABLE
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

SHARES = (1.0, 0.5)
"""Shares of the way to the predicted model that are simulated, of an effect that begins at a finite
size."""
SIZES, SIZE_TRIALS = 2.2, 6
"""Factor up to which the size of an effect that begins at a finite one may be larger or smaller
where its fit begins, and number of sizes that are simulated: no derivative tells of it."""
PLACE_TRIALS = 25
"""Places that are simulated of something that the DLO hits: no derivative leads to them."""


@dataclass(frozen=True, eq=False)
class TrialBeginning:
    """The beginning of a proposal's fit.

    Args:
        predicted: the proposal, and the model with which its fit begins.
        err: ERR of that model [m].
        vital: whether it is fitted however little of ERR it takes away.
    """

    predicted: PredictedGain
    err: float
    vital: bool

    @property
    def label(self) -> str:
        """See `Proposal.label`."""
        return self.predicted.proposal.label

    @property
    def gain(self) -> float:
        """The predicted gain in log evidence."""
        return self.predicted.gain


def beginning(
    at: Evaluation, predicted: PredictedGain, recordings: Sequence[Recording]
) -> TrialBeginning:
    """Where the fit of a proposal begins.

    Gains are predicted linearly, for correlated errors: the step to the predicted model is often
    too long, and what it gains may be but the rapid part of the residuals. A few steps with the
    same derivatives tell how near to the shapes the proposal leads.

    Args:
        at: the model without the proposal.

    Raises:
        SimulationError: it cannot be simulated there.
    """
    smooth = predicted.proposal.from_nothing
    begin = _with_columns(at, predicted)
    if not smooth:
        begin = borrowed(begin, _nearest_size(predicted, recordings), recordings)
    model = _held(begin.model, {*at.model.names, *(predicted.proposal.columns if smooth else ())})
    found = approached(replace(begin, model=model), recordings)
    # Effects on which E depends are fitted, too.
    vital = predicted.gain >= INDISPENSABLE or has_other_stiffness(predicted.model, at, 1.0)
    begins = replace(predicted, model=predicted.begin.at(found.model.theta()))
    return TrialBeginning(begins, found.mean_err, vital)


def _with_columns(at: Evaluation, predicted: PredictedGain) -> Evaluation:
    """The model with a proposal at its first values, and the derivatives that are known there."""
    names, fields, model = at.model.names, at.fields, predicted.begin
    if predicted.columns and predicted.proposal.from_nothing:
        names, fields = (*names, *predicted.proposal.columns), joined(fields, predicted.columns)
    # A column of zeros behind the others stands for derivatives that are not known yet.
    place = [names.index(n) if n in names else len(names) for n in model.names]
    known = tuple((r, np.pad(j, ((0, 0), (0, 1), (0, 0)))[:, place]) for r, j in fields)
    return with_variances(Simulated(model, known, at.err, at.predicted, at.motions), at.variances)


def _held(model: ParametricModel, known: Collection[str]) -> ParametricModel:
    """The model with those parameters held of which no derivative is known.

    Their priors alone would say where they go: places to the middle of their range.
    """
    pairs = zip(model.parameters, model.theta(), strict=True)
    return model.with_prior([p.held(float(x)) for p, x in pairs if p.name not in known])


def _nearest_size(predicted: PredictedGain, recordings: Sequence[Recording]) -> ParametricModel:
    """The model on the way to the predicted one, of the size that comes nearest to the shapes.

    What the DLO hits has a place instead, to which no derivative leads.

    Raises:
        SimulationError: none can be simulated.
    """
    begin, end = predicted.begin.theta(), predicted.model.theta()
    found: list[tuple[float, ParametricModel]] = []

    def tried(theta: FloatArray) -> float:
        model = predicted.begin.at(theta)
        try:
            err = simulate(model, recordings, ()).mean_err
        except SimulationError as reason:
            LOG.info("%s: %s", predicted.proposal.label, reason)
            return model.settings.rod.length  # farther off than anything that can be simulated
        found.append((err, model))
        return err

    for share in SHARES:
        tried(begin + share * (end - begin))
    if not found:
        raise SimulationError("no beginning can be simulated")
    here = min(found, key=lambda row: row[0])[1]
    size = _size(predicted.proposal)
    if size is not None:
        k, most = here.index(size.name), float(np.log(SIZES))
        value = size.outer(here.theta()[k])

        def resized(factor: float) -> float:
            theta = here.theta()
            theta[k] = size.inner(value * float(np.exp(factor)))
            return tried(theta)

        minimize_scalar(
            resized, bounds=(-most, most), method="bounded", options={"maxiter": SIZE_TRIALS}
        )
    elif not effects()[predicted.proposal.effect].differentiable:
        parameters = predicted.proposal.parameters
        places = [here.index(p.name) for p in parameters]
        corners = np.vstack([np.zeros(len(places)), np.diag([p.step for p in parameters])])

        def placed(moves: FloatArray) -> float:
            theta = here.theta()
            theta[places] += moves
            return tried(theta)

        minimize(
            placed, corners[0], method="Nelder-Mead",
            options={"maxfev": PLACE_TRIALS, "initial_simplex": corners},
        )  # fmt: skip
    return min(found, key=lambda row: row[0])[1]


def _size(proposal: Proposal) -> Parameter | None:
    """The size of an effect that begins at a finite value; None where it has no size, as a peg."""
    start = proposal.start
    if start is None or start.neutral or not start.screened:
        return None
    key = start.screened[0]
    if quantities(start.effect)[key].geometric:
        return None
    return next((p for p in proposal.parameters if p.key == key), None)
