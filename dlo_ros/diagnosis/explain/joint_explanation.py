# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Explanation of recordings by the joint model: the set-up within tolerances, and causes beyond."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp
from dlo_ros.diagnosis.explain.candidate_trials import LOWERS, NEAR, Step, Trial, fitted, gains
from dlo_ros.diagnosis.explain.cause_search import (
    INDISPENSABLE,
    Offer,
    Search,
    best_peg,
    linear_loss,
    offered,
    ranked_proposals,
    search,
    without,
)
from dlo_ros.diagnosis.explain.certainty import (
    SCALES,
    beyond_for_certain,
    certain,
    is_beyond,
    nameable,
    strains,
)
from dlo_ros.diagnosis.explain.far_starts import best_far_start
from dlo_ros.diagnosis.explain.measurement_error import OWN, material_err, own_err
from dlo_ros.diagnosis.proposals.candidate_effects import starts
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.effects import Scene, Start
from dlo_ros.effects.start import Block
from dlo_ros.inference.joint import Evaluation, evaluate, simulate
from dlo_ros.inference.joint_fit import settled
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import Parameter, ParametricModel, split_name
from dlo_ros.inference.priors import believed, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

NAMED = 5.0
"""Loss of log evidence without a cause, from which it is named: 150 to one. Of one that is no part
of every set-up, but one of K effects that were tried, ln K more."""
FAR = 0.4
"""ERR over that without a cause, below which it is named whatever little of the log evidence is
lost: errors that die out over time hold slow errors for cheap, however large they are."""
RIVAL = 3.0
"""Log evidence by which a rival may be worse."""
MENDS = 0.05
"""Share of the plain model's ERR beyond the measurement's own error, up to which an effect may only
compensate for the law of another one, such as a segment for that of a gradient: true causes have
taken away a tenth and more, such effects a thirtieth."""
RIVAL_FITS = 2

Bares = dict[str, Evaluation | None]
"""Fits without single causes, by the causes' labels; None where nothing could be simulated."""


@dataclass(frozen=True)
class Cause:
    """A cause that the data show for certain.

    Args:
        effect: name of the effect.
        names: names of the effect's parameters.
        rivals: effects that explain the data as well in its place, with the values of their keys.
        evidence: log evidence that is lost without it.
        err: ERR without it [m].
    """

    effect: str
    names: tuple[str, ...]
    rivals: Mapping[str, Block]
    evidence: float
    err: float


@dataclass(frozen=True)
class Explanation:
    """The recordings explained by the joint model.

    Args:
        setup: the set-up within tolerance, fitted.
        at: the same with all causes.
        causes: the causes that are certain.
        own_err: ERR that the measurement alone has [m].
        material_err: ERR [m] below which nothing is left to explain.
        nameable_err: ERR [m] that an effect which has been added must take away to be named.
        proposals: all that the search has added or freed, certain or not.
        trace: every candidate of every step.
        stiffness_shifts: change of ln(E / mu) where an added effect is left out, by its name.
    """

    setup: Evaluation
    at: Evaluation
    causes: tuple[Cause, ...]
    own_err: float
    material_err: float
    nameable_err: float
    proposals: tuple[Proposal, ...]
    trace: tuple[Step, ...]
    stiffness_shifts: Mapping[str, float] = field(default_factory=dict)

    @property
    def stiffness_doubt(self) -> float:
        """Largest change of ln(E / mu) by what the model contains although it is no certain
        cause.
        """
        named = {c.effect for c in self.causes}
        shifts = self.stiffness_shifts.items()
        return max((abs(shift) for effect, shift in shifts if effect not in named), default=0.0)


@dataclass(frozen=True)
class Prepared:
    """Recordings with the joint model's set-up fitted to them, before any cause is looked for.

    Args:
        recordings: recordings to learn from.
        scene: properties of the recordings on which priors and searches depend.
        plain_err: ERR of the plain model [m].
        meant: the model with the set-up at neutral.
        setup: the fit.
    """

    recordings: Sequence[Recording]
    scene: Scene
    plain_err: float
    meant: ParametricModel
    setup: Evaluation


def prepare(recordings: Sequence[Recording], plain: Settings, given: Settings) -> Prepared:
    """Fit the set-up within its tolerances.

    Args:
        recordings: recordings to learn from.
        plain: settings of the plain model's fit, from where the fit starts.
        given: the parameter file, whose material the priors lie around.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    names = imposed_names(r.manipulation for r in recordings)
    here = scene(plain, names, [r.observed for r in recordings])
    model = _believing(joint_model(plain, given, here))
    at = settled(evaluate(model, recordings), recordings)
    bare = simulate(ParametricModel(plain, ()), recordings, ())
    return Prepared(recordings, here, bare.mean_err, model, at)


def _believing(model: ParametricModel) -> ParametricModel:
    """The model with what was measured beforehand kept near its value, see `believed`.

    A fit that pushes it further does the work of a cause that nobody names.
    """

    def near(p: Parameter) -> Parameter:
        low, high = believed(p)
        return replace(p, lower=low, upper=high)

    return model.with_prior([near(p) for p in model.parameters if not p.effect and not p.guessed])


def explain(
    prepared: Prepared, given: Settings, pegs: Sequence[PegBesideSetUp] = ()
) -> Explanation:
    """Look for causes beyond a set-up.

    Args:
        given: the parameter file.
        pegs: pegs that the DLO may have hit.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    recordings = prepared.recordings
    begun = starts(prepared.scene)
    enough = material_err(0.0, given)
    setup, first = _beginning(prepared, begun, pegs, enough)
    found = search(setup, prepared.meant, recordings, begun, enough, first)
    found, bares, pruned = _without_needless(found, recordings, begun)
    # Judged in the end: what a cause does to a DLO looks like an error of the camera before.
    own = own_err(found.at, recordings)
    matters = material_err(own, given)
    missed = LOWERS * (setup.mean_err - own)
    least = max(missed, MENDS * (prepared.plain_err - own))
    causes, shifts = _named(found, bares, recordings, begun, OWN * own, least)
    return Explanation(
        setup, found.at, causes, own, matters, least, found.causes, found.trace, pruned | shifts
    )


def still_certain(
    found: Explanation, final: Evaluation, covariance: FloatArray
) -> Explanation:  # fmt: skip
    """The explanation with those causes alone that a fit to more data shows for certain, too.

    What only compensated for another law in the recordings learned from, others may deny.

    Args:
        final: the model with all causes, fitted to all recordings.
        covariance: that is reported of its parameters, shape (P, P).
    """
    groups = [*found.proposals, *freed(final.model)]
    may_be = {g.label for g in nameable(final, found.proposals)}
    sure = {p.name for g in groups if _still(final, g, covariance, may_be) for p in g.parameters}
    return replace(found, causes=tuple(c for c in found.causes if sure & set(c.names)))


def _still(
    final: Evaluation, group: Proposal, covariance: FloatArray, may_be: Collection[str]
) -> bool:
    """Whether a group is a cause with the values of a fit to more data, and their uncertainty.

    Args:
        may_be: labels of groups of the set-up, see `nameable`.
    """
    if group.start is None and beyond_for_certain(final, group, covariance):
        return True
    tolerated = group.start is None and all(p.effect for p in group.parameters)
    if tolerated and group.label not in may_be:
        return False
    return certain(final, group, SCALES, covariance)


def _beginning(
    prepared: Prepared, begun: Sequence[Start], pegs: Sequence[PegBesideSetUp], enough: float
) -> tuple[Evaluation, Trial | None]:
    """The set-up, and the cause that no derivative tells of, with which the search begins."""
    setup, recordings = prepared.setup, prepared.recordings
    firsts = [best_peg(setup, recordings, pegs)]
    if setup.mean_err > enough:
        far = best_far_start(setup, prepared.meant, recordings, begun, prepared.plain_err)
        bare = without(*far, recordings) if far is not None else None
        if far is not None and bare is not None and not gains(far, bare):
            # The cause was the way to another minimum, in which the set-up needs none.
            setup, far = bare, None
        firsts.append(far)
    found = [f for f in firsts if f is not None and gains(f, setup)]
    return setup, max(found, key=lambda f: f[0].posterior.evidence, default=None)


def _without_needless(
    found: Search, recordings: Sequence[Recording], begun: Sequence[Start]
) -> tuple[Search, Bares, dict[str, float]]:
    """The result without added effects that the data do not show for certain.

    Beside an effect that may or may not act, another one of which the data are certain would not be
    needed either, where each can do the other's work: neither would be named.

    Returns:
        The result, fits of it without single causes as far as they were made, and the change of
        ln(E / mu) without each effect that is left out.
    """
    at, causes, shifts = found.at, found.causes, {}
    bares: Bares = {}
    for cause in reversed(found.causes):
        if cause.start is None or linear_loss(at, cause, wholly=True) > INDISPENSABLE:
            continue
        bare = without(at, cause, recordings, wholly=True)
        if bare is None or _needed(at, bare, cause, begun):
            bares[cause.label] = bare
            continue
        shifts[cause.effect] = _log_ratio(bare) - _log_ratio(at)
        at, causes = bare, tuple(c for c in causes if c is not cause)
        bares = {}
    return replace(found, at=at, causes=causes), bares, shifts


def _loss(at: Evaluation, bare: Evaluation) -> float:
    """Log evidence that is lost without a cause."""
    return at.posterior.evidence - bare.posterior.evidence


def _needed(at: Evaluation, bare: Evaluation, group: Proposal, begun: Sequence[Start]) -> bool:
    """Whether the best model without a cause is clearly worse, see `NAMED` and `FAR`.

    Args:
        bare: the fit without it.
    """
    tried = len({s.effect for s in begun}) if group.start is not None else 1
    loss = _loss(at, bare)
    far = at.mean_err < FAR * bare.mean_err
    return loss >= NAMED + float(np.log(tried)) or (far and loss > 0.0)


def _named(
    found: Search, bares: Bares, recordings: Sequence[Recording], begun: Sequence[Start],
    material: float, least: float,
) -> tuple[tuple[Cause, ...], dict[str, float]]:  # fmt: skip
    """The causes without which the best model is clearly worse, numbers of the set-up among them,
    and the change of ln(E / mu) without each effect that was added.

    What lies within its tolerance, or is no part of every set-up, is none where all that it
    explains is immaterial, or takes away less than `least` [m] of ERR: beside a cause whose true
    law is another than the model's, a further effect mends that law a little. Where the set-up must
    leave its tolerance to do a cause's work, ERR does not tell how much that is.
    """
    at, offer = found.at, found.offer
    result, shifts = [], {}
    for group in (*found.causes, *nameable(at, found.causes)):
        if not certain(at, group, SCALES):
            continue
        # Linearly, the rest may do the work of what was added by moves that no set-up makes.
        if group.start is None and linear_loss(at, group, wholly=True) < NAMED:
            continue
        known = group.label in bares
        bare = bares[group.label] if known else without(at, group, recordings, wholly=True)
        if bare is None:
            continue
        if group.start is not None:
            shifts[group.effect] = _log_ratio(bare) - _log_ratio(at)
        nearer = at.mean_err <= (1.0 - LOWERS) * bare.mean_err
        if not nearer or not _needed(at, bare, group, begun):
            continue
        if group.start is not None or not is_beyond(at, group):
            little = bare.mean_err - at.mean_err < least and not strains(bare, at)
            if bare.mean_err < material or (little and group.from_nothing):
                continue
        offer = offer or offered(at, recordings, begun)
        rivals = _rivals(at, bare, group, recordings, offer)
        names_ = tuple(p.name for p in group.parameters)
        result.append(Cause(group.effect, names_, rivals, _loss(at, bare), bare.mean_err))
    return _merged(result), shifts


def _log_ratio(at: Evaluation) -> float:
    """ln(E / mu) of a model."""
    rod = at.model.settings.rod
    return float(np.log(rod.young_modulus / rod.density))


def _merged(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Causes with one entry for each effect, the clearest first."""
    by_effect: dict[str, list[Cause]] = {}
    for cause in sorted(causes, key=lambda c: -c.evidence):
        by_effect.setdefault(cause.effect, []).append(cause)
    return tuple(
        Cause(
            effect, tuple(n for c in same for n in c.names),
            {r: v for r, v in same[0].rivals.items() if all(r in c.rivals for c in same)},
            same[0].evidence, max(c.err for c in same),
        )
        for effect, same in by_effect.items()
    )  # fmt: skip


def _rivals(
    at: Evaluation, bare: Evaluation, group: Proposal, recordings: Sequence[Recording],
    offer: Offer,
) -> dict[str, Block]:  # fmt: skip
    """Effects that explain the data as well where a group is at neutral, with their values."""
    missing = at.posterior.evidence - bare.posterior.evidence - RIVAL
    result: dict[str, Block] = {}
    fits = 0
    for predicted in ranked_proposals(bare, offer, smooth=True):
        effect = predicted.proposal.effect
        if effect == group.effect or effect in result or predicted.gain < NEAR * missing:
            continue
        if fits >= RIVAL_FITS:
            break
        fits += 1
        there = fitted(predicted.model, recordings)
        if there and there.posterior.evidence - bare.posterior.evidence >= missing:
            values = there.model.settings.effects.get(effect, {})
            fitted_ = {split_name(p.name)[1] for p in predicted.proposal.parameters if p.effect}
            result[effect] = {key: v for key, v in values.items() if key in fitted_}
    return result
