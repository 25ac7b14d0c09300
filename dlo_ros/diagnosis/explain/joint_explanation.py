# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Explanation of recordings by the joint model: the set-up within tolerances, and causes beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp
from dlo_ros.diagnosis.explain.cause_search import (
    LOWERS,
    Offer,
    Search,
    Step,
    best_peg,
    fitted,
    linear_loss,
    offered,
    promised,
    search,
    without,
)
from dlo_ros.diagnosis.proposals.candidate_effects import starts
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.effects import Scene, Start, quantities
from dlo_ros.inference.joint import Evaluation, evaluate, settled, simulate
from dlo_ros.inference.measured import Recording, spline_space
from dlo_ros.inference.parameter import Parameter, ParametricModel, split_name
from dlo_ros.inference.priors import SLAB, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import FEWEST_FRAMES, Variances
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

NAMED = 5.0
"""Loss of log evidence without a cause, from which it is named: 150 to one. Of one that is no part
of every set-up, but one of K effects that were tried, ln K more."""
RIVAL = 3.0
"""Log evidence by which a rival may be worse."""
CERTAIN = 3.0
"""Standard deviations from neutral, from which a cause is named."""
SCALES = ("young_modulus", "density")
"""Parameters to which the size of a cause is proportional: their uncertainty makes its presence no
less certain. A force on a DLO that was not weighed is known as a share of the weight, a
mass on one of unknown stiffness likewise."""
BEYOND = 2.0
"""Tolerances from neutral, from which a number of the set-up may be a cause."""
NOTABLE = 0.2
"""Tolerances from neutral, from which a number of the set-up is off by more than two programs that
simulate the same DLO differ by."""
MENDS = 0.05
"""Share of the plain model's ERR beyond the measurement's own error, up to which an effect may only
compensate for the law of another one, such as a segment for that of a gradient: true causes have
taken away a tenth and more, such effects a thirtieth."""
OWN = 1.3
"""ERR over that of the measurement itself, up to which nothing is left to explain."""
LARGEST_STAYING = 0.01
"""Largest error over the length that stays and counts as the measurement's own: no calibration that
deserves the name errs more."""
STILL = 0.1
"""Share of the error that stays which counts as the measurement's where the DLO does not move:
there nothing tells it from an error of the model."""
RIVAL_FITS = 2


@dataclass(frozen=True)
class Cause:
    """A cause that the data show for certain.

    Args:
        effect: its name.
        names: of its parameters.
        rivals: effects that explain the data as well in its place.
        evidence: log evidence that is lost without it.
        err: ERR without it [m].
    """

    effect: str
    names: tuple[str, ...]
    rivals: tuple[str, ...]
    evidence: float
    err: float


@dataclass(frozen=True)
class Explanation:
    """The recordings explained by the joint model.

    Args:
        setup: the set-up within tolerance, fitted.
        at: the same with all causes.
        causes: those that are certain.
        own_err: ERR that the measurement alone has [m].
        material_err: ERR [m] below which nothing is left to explain.
        nameable_err: ERR [m] that an effect which has been added must take away to be named.
        proposals: all that the search has added or freed, certain or not.
        trace: every candidate of every step.
    """

    setup: Evaluation
    at: Evaluation
    causes: tuple[Cause, ...]
    own_err: float
    material_err: float
    nameable_err: float
    proposals: tuple[Proposal, ...]
    trace: tuple[Step, ...]


@dataclass(frozen=True)
class Prepared:
    """Recordings with the joint model's set-up fitted to them, before any cause is looked for.

    Args:
        recordings: to learn from.
        scene: what the recordings look like.
        plain_err: ERR of the plain model [m].
        setup: the fit.
    """

    recordings: Sequence[Recording]
    scene: Scene
    plain_err: float
    setup: Evaluation


def prepare(recordings: Sequence[Recording], plain: Settings, given: Settings) -> Prepared:
    """Fit the set-up within its tolerances.

    Args:
        recordings: to learn from.
        plain: settings of the plain model's fit, from where the fit starts.
        given: the parameter file, whose material the priors lie around.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    names = imposed_names(r.manipulation for r in recordings)
    here = scene(plain, names, [r.observed for r in recordings])
    model = joint_model(plain, given, here)
    at = settled(evaluate(model, recordings), recordings)
    bare = simulate(ParametricModel(plain, ()), recordings, ())
    return Prepared(recordings, here, bare.mean_err, at)


def explain(
    prepared: Prepared, given: Settings, pegs: Sequence[PegBesideSetUp] = ()
) -> Explanation:
    """Look for causes beyond a set-up.

    Args:
        given: the parameter file.
        pegs: those that the DLO may have hit.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    recordings = prepared.recordings
    begun = starts(prepared.scene)
    first_peg = best_peg(prepared.setup, recordings, pegs)
    found = search(prepared.setup, recordings, begun, material_err(0.0, given), first_peg)
    # Judged in the end: what a cause does to a DLO looks like an error of the camera before.
    own = own_err(found.at, recordings)
    matters = material_err(own, given)
    missed = LOWERS * (prepared.setup.mean_err - own)
    least = max(missed, MENDS * (prepared.plain_err - own))
    causes = _named(found, recordings, begun, matters, least)
    return Explanation(
        prepared.setup, found.at, causes, own, matters, least, found.causes, found.trace
    )


def material_err(own: float, given: Settings) -> float:
    """ERR [m] from which it matters, where the measurement itself has `own` [m]."""
    return max(OWN * own, given.diagnosis.material_err * given.rod.length)


def own_err(at: Evaluation, recordings: Sequence[Recording]) -> float:
    """ERR of the measurement alone [m]: noise, and errors that stay while the DLO moves.

    The latter are taken as each recording shows them, since few numbers cause them: their
    variance is that of all recordings together. The error of u that measured points leave open
    counts as each recording shows it, too.
    """
    found = []
    most = (LARGEST_STAYING * at.model.settings.rod.length) ** 2
    for variances, s, recording, predicted in zip(
        at.variances, at.spectra, recordings, at.predicted, strict=True
    ):
        staying = np.minimum(_staying(variances, s), most)
        moved = recording.observed - recording.observed.mean(axis=0)
        still = np.mean(np.sum(moved**2, axis=2)) < np.sum(staying)
        own = (STILL if still else 1.0) ** 2 * staying
        variance = _noise(variances, recording) + own
        if recording.beyond is not None:
            variance[1] += min(_along(recording, predicted, at.model.settings), most)
        found.append(mean_length(np.sqrt(variance)))
    return float(np.mean(found))


def _staying(variances: Variances, s: Spectrum) -> FloatArray:
    """Mean square of the errors that stay, in each direction, as far as the data tell [m^2]."""
    still = s.still * (variances.lasting[s.part] * s.share + variances.rough[s.part] * s.white)
    weight = still / variances.of(s)
    squares = weight**2 * s.sum_of_squares + s.count * (1.0 - weight) * still
    return np.bincount(s.part, squares) / s.frames


def _along(recording: Recording, predicted: FloatArray, settings: Settings) -> float:
    """Mean square by which a recording's splines lie along the DLO from a simulation [m^2].

    Residuals of measured points hold next to nothing of it: a camera sees u where it sees an end,
    and counts it from where a clamp should be.
    """
    seen, n = recording.observed[-len(predicted) :], predicted.shape[1]
    along = spline_space(seen, settings)[:, n : 2 * n]
    return float(
        np.mean(np.sum(np.einsum("fknc,fnc->fk", along, seen - predicted[..., :3]) ** 2, axis=1))
    )


def _noise(variances: Variances, recording: Recording) -> FloatArray:
    """Variance of the noise in each direction [m^2]; of a few frames, that of the rough residual.

    Otherwise every error of the model in a few frames would count as noise.
    """
    noise = variances.white + variances.nodal
    if len(recording.times) >= FEWEST_FRAMES:
        return noise
    scattered = np.sum(recording.noise.reshape(len(noise), -1) ** 2, axis=1)
    return np.asarray(np.minimum(noise, scattered))


def mean_length(sizes: FloatArray) -> float:
    """Mean length of a normal vector with the given standard deviations."""
    drawn = np.random.default_rng(0).normal(size=(20_000, len(sizes)))
    return float(np.mean(np.linalg.norm(drawn * sizes, axis=1)))


def _named(
    found: Search, recordings: Sequence[Recording], begun: Sequence[Start], material: float,
    least: float,
) -> tuple[Cause, ...]:  # fmt: skip
    """The causes without which the best model is clearly worse, numbers of the set-up among them.

    What lies within its tolerance, or is no part of every set-up, is none where all that it
    explains is immaterial, or takes away less than `least` [m] of ERR: beside a cause whose true
    law is another than the model's, a further effect mends that law a little.
    """
    at, offer = found.at, found.offer
    result = []
    for group in (*found.causes, *beyond(at)):
        if not certain(at, group, SCALES):
            continue
        if group.from_nothing and linear_loss(at, group, wholly=True) < NAMED:
            continue
        bare = without(at, group, recordings, wholly=True)
        if bare is None:
            continue
        loss = at.posterior.evidence - bare.posterior.evidence
        tried = len({s.effect for s in begun}) if group.start is not None else 1
        if loss < NAMED + np.log(tried) or at.mean_err > (1.0 - LOWERS) * bare.mean_err:
            continue
        if group.start is not None or not _beyond(at, group):
            little = bare.mean_err - at.mean_err < least
            if bare.mean_err < material or (little and group.from_nothing):
                continue
        offer = offer or offered(at, recordings, begun)
        rivals = _rivals(at, bare, group, recordings, offer)
        names_ = tuple(p.name for p in group.parameters)
        result.append(Cause(group.effect, names_, rivals, loss, bare.mean_err))
    return _merged(result)


def _merged(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Causes with one entry for each effect, the clearest first."""
    by_effect: dict[str, list[Cause]] = {}
    for cause in sorted(causes, key=lambda c: -c.evidence):
        by_effect.setdefault(cause.effect, []).append(cause)
    return tuple(
        Cause(
            effect, tuple(n for c in same for n in c.names),
            tuple(r for r in same[0].rivals if all(r in c.rivals for c in same)),
            same[0].evidence, max(c.err for c in same),
        )
        for effect, same in by_effect.items()
    )  # fmt: skip


def beyond(at: Evaluation) -> list[Proposal]:
    """Groups of the set-up of which a number lies beyond its tolerance."""
    return [
        replace(g, parameters=tuple(p for p in at.model.parameters if p.name in g.columns))
        for g in freed(at.model)
        if _beyond(at, g)
    ]


def _beyond(at: Evaluation, group: Proposal, tolerances: float = BEYOND) -> bool:
    """Whether a size of a group, with the priors of a cause, lies so many tolerances off."""
    if not group.from_nothing:
        return False
    off = dict(zip(at.model.names, at.model.offset(), strict=True))
    return any(
        abs(off[p.name]) > tolerances * p.std / SLAB
        for p in group.parameters
        if p.name in off and not _geometric(p)
    )


def _geometric(p: Parameter) -> bool:
    """Whether a parameter is a place, of which none is neutral."""
    return bool(p.effect) and quantities(p.effect)[split_name(p.name)[1]].geometric


def certain(at: Evaluation, group: Proposal, held: Sequence[str] = ()) -> bool:
    """Whether a group is away from neutral by more than its uncertainty (Wald).

    Args:
        held: parameters of which what is not known does not count.
    """
    linear = [n for n in group.columns if n in at.model.names]
    if not linear or not group.from_nothing:
        return group.start is not None
    k = [at.model.index(n) for n in linear]
    off = at.model.offset()[k]
    h = [at.model.index(n) for n in held if n in at.model.names]
    # With some parameters held, the rest of the inverse covariance stays as it is.
    covariance = at.posterior.covariance[np.ix_([*k, *h], [*k, *h])]
    information = np.linalg.inv(covariance)[: len(k), : len(k)]
    return float(off @ information @ off) > CERTAIN**2 * len(k)


def departures(at: Evaluation, causes: Sequence[Proposal] = ()) -> int:
    """Number of causes and notable parts of the set-up that are away from neutral for certain.

    Args:
        at: the joint model.
        causes: that have been added to it or freed.
    """
    acting = [c for c in causes if c.start is not None]
    tolerated = replace(
        at.model,
        parameters=tuple(replace(p, tolerated=bool(p.effect)) for p in at.model.parameters),
    )
    own = {p.name for c in acting for p in c.parameters}
    parts = [g for g in freed(tolerated) if g.parameters[0].effect and not own & set(g.columns)]
    return len(acting) + sum(certain(at, g) and _beyond(at, g, NOTABLE) for g in parts)


def _rivals(
    at: Evaluation, bare: Evaluation, group: Proposal, recordings: Sequence[Recording],
    offer: Offer,
) -> tuple[str, ...]:  # fmt: skip
    """Effects that explain the data as well where a group is at neutral."""
    missing = at.posterior.evidence - bare.posterior.evidence - RIVAL
    result: list[str] = []
    fits = 0
    for promise in promised(bare, offer, smooth=True):
        effect = promise.proposal.effect
        if effect == group.effect or effect in result or promise.gain < missing:
            continue
        if fits >= RIVAL_FITS:
            break
        fits += 1
        there = fitted(promise.model, recordings)
        if there and there.posterior.evidence - bare.posterior.evidence >= missing:
            result.append(effect)
    return tuple(result)
