# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Suspected causes in the present motion, by the joint model linearised at the live estimate.

The set-up is open within its tolerances, as in `diagnose`, so that a clamp that is a degree off is
no reason to warn. Nothing is fitted, and the work is done in short pieces, so that no other
callback waits.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import plausible_pegs
from dlo_ros.diagnosis.contact.peg_places import sight
from dlo_ros.diagnosis.explain.certainty import beyond, certain
from dlo_ros.diagnosis.explain.measurement_error import material_err
from dlo_ros.diagnosis.proposals.linear_evidence import (
    Proposal,
    added,
    columns,
    joined,
    linear_prior,
    proposal_of,
    simulated_together,
    with_proposals,
)
from dlo_ros.effects import Scene, starts
from dlo_ros.errors import DloError
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.gradual_simulation import simulated
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.joint import (
    Evaluation,
    Field,
    judged,
    least,
    linearly_fitted,
    moved,
)
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model, material_priors
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.thresholds import LOWERS, NAMED
from dlo_ros.inference.variances import fit_variances
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

AT_ONCE = 3
"""Pictures in a piece of work."""
AT_MOST = 4
"""Beginnings of an effect without a useful derivative where it does nothing."""
SHOWN = 3
"""Suspects that are reported."""
WEIGHED = 12
"""Models that are weighed by their evidence, those that leave least."""


@dataclass(frozen=True)
class Suspects:
    """Errors of a motion that E, mu and damping leave, and effects that would explain them.

    Args:
        err: mean distance that E, mu and damping leave [m].
        setup_err: error that a set-up within its tolerances leaves [m].
        material: error below which nothing needs to be explained [m].
        found: names of effects with the share of `err` that each would explain, best first; a
            number of the set-up far beyond its tolerance is one, too.
    """

    err: float
    setup_err: float
    material: float
    found: tuple[tuple[str, float], ...]

    @property
    def wrong(self) -> bool:
        """Whether a cause is suspected."""
        return bool(self.found) or self.setup_err > self.material

    def __str__(self) -> str:
        return ", ".join(f"{name} ({100.0 * share:.0f} %)" for name, share in self.found)


@dataclass(frozen=True)
class Hypothesis:
    """A model of the motion, linearised at the estimate.

    Args:
        effect: name of the effect that the model adds; empty: none.
        fields: residuals and derivatives.
        offset, precision: prior means minus the present values, and inverse prior variances, shape
            (P,) each.
        step: step of the parameters by least squares, as if errors were white.
        err: mean distance that this leaves [m].
    """

    effect: str
    fields: tuple[Field, ...]
    offset: FloatArray
    precision: FloatArray
    step: FloatArray
    err: float

    @classmethod
    def of(
        cls, effect: str, fields: tuple[Field, ...], offset: FloatArray, precision: FloatArray
    ) -> Hypothesis:
        """With its fit."""
        return cls(effect, fields, offset, precision, *least(fields, offset, precision))

    def evidence(self, settings: Settings) -> float:
        """Log marginal likelihood, with correlated errors."""
        n, length = settings.rod.control_points, settings.rod.length
        spectra = [spectrum(r, j, n) for r, j in moved(self.fields, self.step)]
        _, found = fit_variances(spectra, self.offset - self.step, self.precision, length)
        return found.evidence


def suspects(past: Manipulation, settings: Settings, spans: int, noise: float) -> Pieces[Suspects]:
    """Effects that the present motion makes suspect.

    A suspect does clearly better than a set-up within its tolerances, alone or beside it.

    Args:
        past: commands and observations from the start of the simulation on.
        settings: settings with the estimated parameters.
        spans: knot spans of the simulation.
        noise: noise of a picture, as a mean distance along the DLO [m].

    Raises:
        DloError: the joint model cannot be simulated.
    """
    recording = replace(measured(past, settings), spans=spans)
    view = scene(settings, imposed_names([past]), [recording.observed])
    model = _model(recording, settings, view)
    yield LONG
    at = judged((yield from simulated(model, recording, model.names, AT_ONCE)))
    yield LONG
    plain, joint = _bare(at)
    fitted = linearly_fitted(at)
    yield LONG
    shares = _far_off(fitted)
    if plain.err > material_err(0.0, settings):
        found = yield from _added(at, recording, view, noise, (plain, joint))
        known = max(plain.evidence(settings), joint.evidence(settings))
        for other in sorted(found, key=lambda h: h.err)[:WEIGHED]:
            yield LONG
            if other.err < (1.0 - LOWERS) * joint.err and other.evidence(settings) > known + NAMED:
                share = 1.0 - other.err / plain.err
                shares[other.effect] = max(shares.get(other.effect, 0.0), share)
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:SHOWN]
    return Suspects(plain.err, joint.err, material_err(noise, settings), tuple(ranked))


def _model(recording: Recording, settings: Settings, view: Scene) -> ParametricModel:
    """The joint model around the estimate; in space the set-up is taken as exact."""
    if recording.planar:
        return joint_model(settings, settings, view)
    return ParametricModel(settings, material_priors(settings))


def _bare(at: Evaluation) -> tuple[Hypothesis, Hypothesis]:
    """Hypotheses without an effect: E, mu and damping alone, and with the set-up open."""
    offset, precision = at.model.offset(), at.model.precision()
    own = [k for k, p in enumerate(at.model.parameters) if not p.effect]
    fields = tuple((r, j[:, own]) for r, j in at.fields)
    return (
        Hypothesis.of("", fields, offset[own], precision[own]),
        Hypothesis.of("", at.fields, offset, precision),
    )


def _far_off(at: Evaluation) -> dict[str, float]:
    """Numbers of the set-up far beyond their tolerance, with the share that each explains."""
    shares = {}
    for group in beyond(at):
        held = at.model.with_prior([p.held() for p in group.parameters])
        _, without = least(at.fields, held.offset(), held.precision())
        if certain(at, group) and at.mean_err < (1.0 - LOWERS) * without:
            shares[group.effect] = 1.0 - at.mean_err / without
    return shares


def _added(
    at: Evaluation, recording: Recording, view: Scene, noise: float, bare: Sequence[Hypothesis]
) -> Pieces[list[Hypothesis]]:
    """Every effect beside what there may be without it."""
    result: list[Hypothesis] = []
    for together in simulated_together(_proposals(at, recording, view, noise)):
        model, names = with_proposals(at.model, together)
        try:
            extra = columns(at, together, (yield from simulated(model, recording, names, AT_ONCE)))
        except DloError as err:
            LOG.info("%s: %s", ", ".join(p.label for p in together), err)
            continue
        for proposal in together:
            yield LONG
            offset, precision = linear_prior(at.model.settings, proposal)
            for there in bare:
                fields = joined(there.fields, extra[id(proposal)])
                full = Hypothesis.of(
                    proposal.effect, fields, np.append(there.offset, offset),
                    np.append(there.precision, precision),
                )  # fmt: skip
                if proposal.from_nothing or full.step[-1] > 0.0:
                    result.append(full)
    return result


def _proposals(at: Evaluation, recording: Recording, view: Scene, noise: float) -> list[Proposal]:
    """Effects at the places where they are sought, and pegs beside outlier frames.

    What separates these from undisturbed ones lies between the noise and the largest error, as in
    `undisturbed`.
    """
    size = np.linalg.norm(at.fields[0][0], axis=1)
    wrong = size > np.sqrt(noise * size.max())
    seen = sight(at.model.settings.rod, [recording.observed], at.predicted, [wrong])
    pegs = [proposal_of(at.model.settings, start) for start in plausible_pegs(seen)]
    result: list[Proposal] = []
    for p in (*added(at.model, starts(view)), *pegs):
        if p.from_nothing or sum(p.effect == other.effect for other in result) < AT_MOST:
            result.append(p)
    return result
