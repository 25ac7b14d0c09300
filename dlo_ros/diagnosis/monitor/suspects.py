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
    predicted_gains,
    proposal_of,
    simulated_together,
    with_proposals,
)
from dlo_ros.effects import Scene, starts
from dlo_ros.errors import DloError
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.gradual_simulation import simulated
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.joint import Evaluation, Simulated, least, linearly_fitted
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model, material_priors
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.thresholds import LOWERS, NAMED
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

AT_ONCE = 3
"""Pictures in a piece of work."""
AT_MOST = 4
"""Beginnings of an effect without a useful derivative where it does nothing."""
SHOWN = 3
"""Suspects that are reported."""


@dataclass(frozen=True)
class Suspects:
    """Errors of a motion that E, mu and damping leave, and effects that would explain them.

    Args:
        err: root mean square distance that E, mu and damping leave [m].
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


def suspects(past: Manipulation, settings: Settings, spans: int, noise: float) -> Pieces[Suspects]:
    """Effects that the present motion makes suspect.

    A suspect does clearly better than a set-up within its tolerances, alone or beside it.

    Args:
        past: commands and observations from the start of the simulation on.
        settings: settings with the estimated parameters.
        spans: knot spans of the simulation.
        noise: noise of a picture, root mean square along the DLO [m].

    Raises:
        DloError: the joint model cannot be simulated.
    """
    recording = replace(measured(past, settings), spans=spans)
    view = scene(settings, imposed_names([past]), [recording.observed])
    model = _model(recording, settings, view)
    yield LONG
    at = yield from simulated(model, recording, model.names, AT_ONCE)
    yield LONG
    plain, joint = _bare(at)
    yield LONG
    shares = _far_off(joint)
    if plain.mean_err > material_err(0.0, settings):
        found = yield from _explaining(at, (plain, joint), recording, view, noise)
        for effect, left in found:
            shares[effect] = max(shares.get(effect, 0.0), 1.0 - left / plain.mean_err)
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:SHOWN]
    material = material_err(noise, settings)
    return Suspects(plain.mean_err, joint.mean_err, material, tuple(ranked))


def _model(recording: Recording, settings: Settings, view: Scene) -> ParametricModel:
    """The joint model around the estimate; in space the set-up is taken as exact."""
    if recording.planar:
        return joint_model(settings, settings, view)
    return ParametricModel(settings, material_priors(settings))


def _bare(at: Simulated) -> tuple[Evaluation, Evaluation]:
    """Linear fits without an effect: of E, mu and damping alone, and with the set-up open."""
    own = [k for k, p in enumerate(at.model.parameters) if not p.effect]
    material = replace(at.model, parameters=tuple(at.model.parameters[k] for k in own))
    fields = tuple((r, j[:, own]) for r, j in at.fields)
    return linearly_fitted(replace(at, model=material, fields=fields)), linearly_fitted(at)


def _far_off(at: Evaluation) -> dict[str, float]:
    """Numbers of the set-up far beyond their tolerance, with the share that each explains."""
    shares = {}
    for group in beyond(at):
        held = at.model.with_prior([p.held() for p in group.parameters])
        _, without = least(at.fields, held.offset(), held.precision())
        if certain(at, group) and at.mean_err < (1.0 - LOWERS) * without:
            shares[group.effect] = 1.0 - at.mean_err / without
    return shares


def _explaining(
    at: Simulated, bare: Sequence[Evaluation], recording: Recording, view: Scene, noise: float
) -> Pieces[list[tuple[str, float]]]:
    """Effects that do better than the set-up alone, each with the root mean square distance
    that it leaves [m].

    Args:
        at: the joint model at the estimate.
        bare: what an effect is added to, see `_bare`; the last with the set-up open.
    """
    result: list[tuple[str, float]] = []
    known = max(b.posterior.evidence for b in bare)
    proposals = _proposals(at, recording, view, noise)
    for together in simulated_together(at.model.settings, proposals):
        model, names = with_proposals(at.model, together)
        try:
            extra = columns(at, together, (yield from simulated(model, recording, names, AT_ONCE)))
        except DloError as err:
            LOG.info("%s: %s", ", ".join(p.label for p in together), err)
            continue
        for proposal in together:
            own = linear_prior(at.model.settings, proposal)
            for there in bare:
                yield LONG
                fields = joined(there.fields, extra[id(proposal)])
                offset, precision = there.model.offset(), there.model.precision()
                _, left = least(fields, np.append(offset, own[0]), np.append(precision, own[1]))
                if left > (1.0 - LOWERS) * bare[-1].mean_err:
                    continue
                yield LONG
                for found in predicted_gains(there, [proposal], extra):
                    if there.posterior.evidence + found.gain > known + NAMED:
                        result.append((proposal.effect, left))
    return result


def _proposals(at: Simulated, recording: Recording, view: Scene, noise: float) -> list[Proposal]:
    """Effects at the places where they are sought, and pegs beside outlier frames.

    What separates these from undisturbed ones lies between the noise and the largest error, as in
    `undisturbed`.
    """
    size = np.linalg.norm(at.fields[0][0], axis=1)
    wrong = size > np.sqrt(noise * size.max())
    seen = sight(at.model.settings, [recording.observed], at.predicted, [wrong])
    pegs = [proposal_of(at.model.settings, start) for start in plausible_pegs(seen)]
    result: list[Proposal] = []
    for p in (*added(at.model, starts(view)), *pegs):
        if p.from_nothing or sum(p.effect == other.effect for other in result) < AT_MOST:
            result.append(p)
    return result
