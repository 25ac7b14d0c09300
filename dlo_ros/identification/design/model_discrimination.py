# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Expected log evidence by which a planned manipulation separates rival explanations.

Each explanation is the plain model with one effect of a given size. The plan is simulated with each
of them; then every other one is fitted to these shapes, with E, mu, damping, the numbers of its
effect and those of the set-up open under the priors of `diagnose`. What it cannot imitate counts
against the observer's errors, whose variances are as unknown as in a real recording. The score of a
plan is the least log evidence for the true explanation over a fitted one, over all pairs and both
directions (Atkinson and Fedorov, The design of experiments for discriminating between two rival
models, 1975; Box and Hill, Discrimination among mechanistic models, 1967).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from dlo_ros.effects import Scene, Start, quantities
from dlo_ros.identification.design.expected_information import (
    Noise,
    Plan,
    is_reliable,
    mean_response,
    observer_variances,
    recorded,
)
from dlo_ros.identification.design.plausible_explanations import AssumedEffect
from dlo_ros.inference.forecast import Forecast, forecast
from dlo_ros.inference.joint import Simulated, field, with_variances
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import CorrelatedLoss
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.parameter import ParametricModel, split_name
from dlo_ros.inference.priors import cause_priors, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import fit_variances, posterior
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

REFITS, SEARCH_REFITS = 10, 1
"""Steps by which a rival is fitted at most, and while a manipulation is searched."""


@dataclass(frozen=True)
class Discrimination:
    """The separation of rival explanations that a plan promises.

    Args:
        plan: the plan.
        effects: names of the effects, K of them.
        evidence: expected log evidence for the explanation of the row, if it is the true one, over
            that of the column, fitted instead; shape (K, K), 0 on the diagonal.
        forecast: shapes with the true explanation of the pair that is hardest to separate.
        imitation: control points of its rival, fitted to them [m], shape (F, n, 4).
        reliable: whether no explanation brings the DLO near a snap-through, or folds it more
            sharply than the simulation follows within its tolerance.
    """

    plan: Plan
    effects: tuple[str, ...]
    evidence: FloatArray
    forecast: Forecast
    imitation: FloatArray
    reliable: bool

    @property
    def gain(self) -> float:
        """Log evidence for the true explanation over any other; 0 of what cannot be relied on."""
        return max(float(self.evidence[self._hardest]), 0.0) if self.reliable else 0.0

    @property
    def pair(self) -> tuple[str, str]:
        """The true effect and its rival that are hardest to separate."""
        true, rival = self._hardest
        return self.effects[true], self.effects[rival]

    @property
    def _hardest(self) -> tuple[int, int]:
        return hardest(self.evidence)


def hardest(evidence: FloatArray) -> tuple[int, int]:
    """Row and column of the least log evidence off the diagonal."""
    apart = evidence + np.diag(np.full(len(evidence), np.inf))
    true, rival = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return int(true), int(rival)


def discriminate(
    plan: Plan,
    settings: Settings,
    explanations: Sequence[AssumedEffect],
    noise: Noise = Noise(),  # noqa: B008 - frozen
    *,
    spans: int | None = None,
    refits: int = REFITS,
) -> Discrimination:
    """The separation of rival explanations that a plan promises.

    Args:
        plan: the plan.
        settings: settings of the plain model with what else is known; effects of the explanations
            in it are left out.
        explanations: rival explanations, two or more.
        noise: measurement noise of the observer.
        spans: knot spans of the simulation; default: as simulation.tolerance asks.
        refits: steps by which each rival is fitted at most.

    Raises:
        SimulationError: one of the explanations cannot be simulated.
    """
    names = {e.effect for e in explanations}
    plain = settings.with_effects({k: v for k, v in settings.effects.items() if k not in names})
    plain = _with_same_spans(plain, explanations)
    recording = plan.manipulation()
    bare = forecast(recording, plain, spans=spans)
    spans = bare.spans  # of all explanations, see `_with_same_spans`
    view = scene(plain, imposed_names([recording]), [bare.predicted[:, :, :3]])

    models = [_model(e, explanations, plain, view) for e in explanations]
    found = Threads().map(
        lambda m: forecast(recording, m.settings, parameters=m.names, spans=spans), models
    )
    seen = [replace(recorded(recording, f, settings), spans=spans) for f in found]
    pairs = list(permutations(range(len(models)), 2))
    fits = Threads().map(
        lambda pair: _evidence_lost(seen[pair[0]], models[pair[1]], found[pair[1]], noise, refits),
        pairs,
    )
    evidence = np.zeros((len(models), len(models)))
    for pair, lost in zip(pairs, fits, strict=True):
        evidence[pair] = lost[0]
    pair = hardest(evidence)
    resolved = not bare.resolution_error > settings.simulation.tolerance  # NaN: not judged
    reliable = resolved and all(is_reliable(f, mean_response(f, settings)) for f in found)
    return Discrimination(
        plan, tuple(e.effect for e in explanations), evidence, found[pair[0]],
        fits[pairs.index(pair)][1], reliable,
    )  # fmt: skip


def _with_same_spans(plain: Settings, explanations: Sequence[AssumedEffect]) -> Settings:
    """The plain model with the knot spans that one of the explanations needs.

    Where a grip gives, spans beside it are short. It gives by nothing in all models then: errors of
    the discretisation would separate what nothing else does.
    """
    for e in explanations:
        if plain.with_effects({e.effect: dict(e.block)}).gives and not plain.gives:
            neutral = {key: quantities(e.effect)[key].neutral for key in e.block}
            return plain.with_effects({**plain.effects, e.effect: neutral})
    return plain


def _model(
    explanation: AssumedEffect, rivals: Sequence[AssumedEffect], plain: Settings, view: Scene
) -> ParametricModel:
    """The set-up within its tolerances with an explanation, without what its rivals change."""
    compared = {(e.effect, key) for e in rivals for key in e.block}
    model = joint_model(plain, plain, view)
    tolerated = [p.name for p in model.parameters if p.effect]
    model = model.without([n for n in tolerated if split_name(n)[:2] in compared])
    start = Start(explanation.effect, explanation.block, (), tuple(explanation.block))
    causes, _ = cause_priors(plain, start)
    return model.extended(explanation.effect, dict(explanation.block), causes)


def _evidence_lost(
    seen: Recording, model: ParametricModel, begin: Forecast, noise: Noise, refits: int
) -> tuple[float, FloatArray]:
    """Log evidence that a model loses since it cannot imitate shapes, and its imitation.

    The loss is that over a model of the same freedom that is right from the beginning. The noise
    adds its expected squares. Variances are fitted, as those of a recording are, or the observer's
    where these are likelier: fits keep away from noise far below the largest error.

    Args:
        seen: the shapes, without noise.
        model: the model where its fit begins.
        begin: its forecast there, with derivatives.
        noise: measurement noise of the observer.
        refits: see `discriminate`.

    Returns:
        The loss, and control points [m], shape (F, n, 4).
    """
    here = field(seen, begin.predicted, begin.sensitivity, model.chain())
    parts = here[0].shape[1] // seen.observed.shape[1]
    known = (observer_variances(model.settings, noise, parts),)
    begun = Simulated(model, (here,), (begin.err,), (begin.predicted,), (seen.motion,))
    found = with_variances(begun, known)
    found = fit(found, [seen], refits, loss=CorrelatedLoss(known=known), draft=True)
    (bins,) = found.spectra
    offset, precision = found.model.offset(), found.model.precision()

    def evidence(bins: Spectrum, offset: FloatArray) -> float:
        length = model.settings.rod.length
        _, fitted = fit_variances((bins,), offset, precision, length, known)
        return max(fitted.evidence, posterior((bins,), known, offset, precision).evidence)

    squares = bins.count * known[0].of(bins)
    right = replace(bins, sum_of_squares=squares, gradient=0.0 * bins.gradient)
    wrong = replace(bins, sum_of_squares=bins.sum_of_squares + squares)
    return evidence(right, 0.0 * offset) - evidence(wrong, offset), found.predicted[0]
