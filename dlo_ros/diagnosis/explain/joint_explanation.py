# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Explanation of recordings by the joint model: the set-up within tolerances, and causes beyond."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp
from dlo_ros.diagnosis.explain.cause_naming import (
    Cause,
    beside_contact,
    named,
    without_dampings,
    without_needless,
)
from dlo_ros.diagnosis.explain.cause_search import Search, leaves_something, search
from dlo_ros.diagnosis.explain.certainty import departures
from dlo_ros.diagnosis.explain.contact_beside_causes import with_contact
from dlo_ros.diagnosis.explain.contact_trials import Contact, best_contact
from dlo_ros.diagnosis.explain.exact_setup import beside_exact_set_up
from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.diagnosis.explain.far_starts import best_far_start
from dlo_ros.diagnosis.explain.left_out import without
from dlo_ros.diagnosis.explain.measurement_error import material_err, own_err, own_errs
from dlo_ros.diagnosis.explain.own_moments import for_recordings
from dlo_ros.diagnosis.explain.peg_instead import with_peg_or_wall
from dlo_ros.diagnosis.explain.peg_size import best_sized
from dlo_ros.diagnosis.explain.second_beginning import best_of_beginnings
from dlo_ros.diagnosis.explain.segment_place import with_segment_elsewhere
from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS, Trial, fitted, gains
from dlo_ros.diagnosis.explain.turned_walls import with_turned_wall
from dlo_ros.effects import Scene, Start, effects, starts
from dlo_ros.effects.base import ROD
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed, evaluate, rejudged, simulate
from dlo_ros.inference.joint_fit import approached, best_settled, fit, nearest_err
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import believed, joint_model
from dlo_ros.inference.scene import scene_of
from dlo_ros.inference.thresholds import (
    CLEARLY_LESS,
    FEW_DEPARTURES,
    FEWEST_FRAMES,
    LOWERS,
    MOST_LEFT,
    MOST_LEFT_BY_MANY,
    OWN,
    SMALL_SHARE,
    WORTH,
)
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

EXCHANGES = 3
"""Causes in whose place a rival may be put one after the other: each time it explains more."""


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
    here = scene_of(plain, recordings)
    model = believed(joint_model(plain, given, here))
    at = best_settled(evaluate(model, recordings), recordings)
    bare = simulate(ParametricModel(plain, ()), recordings, ())
    return Prepared(recordings, here, bare.mean_err, model, at)


def explain(
    prepared: Prepared, given: Settings, contacts: Sequence[ContactBesideSetUp] = ()
) -> Explanation:
    """Look for causes beyond a set-up.

    Args:
        given: the parameter file.
        contacts: pegs and walls that the DLO may have hit.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    recordings = prepared.recordings
    begun = starts(prepared.scene)
    enough = material_err(0.0, given)
    contact = best_contact(prepared.setup, recordings, contacts)
    setup, first = _beginning(prepared, begun, contact, enough)
    found = search(setup, prepared.meant, recordings, begun, enough, first)
    found = best_of_beginnings(found, setup, prepared.meant, recordings, begun, enough)
    hit = contact.trial if contact is not None and contact.trial[1] in found.causes else None
    found, beside = with_contact(
        found, given, prepared.meant, recordings, begun, enough, shown=hit is not None
    )
    precise = beside_exact_set_up(found, prepared.meant, recordings, begun, enough, hit)
    exact = precise is not None
    return _concluded(prepared, given, precise or found, setup, beside or contact, exact=exact)


def explain_again(prepared: Prepared, given: Settings, known: Explanation) -> Explanation | None:
    """The causes of an explanation that was found with other recordings or another simulation.

    Others are looked for beside them where they leave something that matters.

    Args:
        given: the parameter file.
        known: the explanation.

    Returns:
        None where the model does not come as near to these recordings as to those in which its
        causes were found, or where these explain no more than the set-up alone, which leaves
        something, or may be exact. Where it leaves nothing, it is the explanation.
    """
    recordings, enough = prepared.recordings, material_err(0.0, given)
    at = fitted(for_recordings(known.at.model, recordings), recordings, far=True)
    if at is None:
        return None
    in_vain = bool(known.proposals) and log_bayes_factor(at, prepared.setup) < WORTH
    if in_vain:
        at = prepared.setup
    near, before = nearest_err(at, recordings), known.at.mean_err
    LOG.info("known causes: %.3f mm, %.3f mm before", 1e3 * near, 1e3 * before)
    if near > max(OWN * before, enough):
        return None
    if in_vain and (known.exact or leaves_something(at, recordings, enough)):
        return None
    found = Search(at, () if in_vain else known.proposals, known.trace, None)
    if not in_vain:
        found = _with_more(prepared, found, enough)
    return _concluded(prepared, given, found, prepared.setup, known.contact, exact=known.exact)


def _with_more(prepared: Prepared, found: Search, enough: float) -> Search:
    """A search's result with further causes, where it leaves something that matters.

    Args:
        enough: ERR [m] below which no cause is looked for.
    """
    at, recordings = found.at, prepared.recordings
    if at.mean_err <= max(OWN * own_err(at, recordings), enough):
        return found
    begun = starts(prepared.scene)
    more = search(at, prepared.meant, recordings, begun, enough, present=found.causes)
    return replace(more, trace=(*found.trace, *more.trace))


def _concluded(
    prepared: Prepared, given: Settings, found: Search, setup: Evaluation, contact: Contact | None,
    *, exact: bool, exchanges: int = EXCHANGES,
) -> Explanation:  # fmt: skip
    """The explanation that a search has found, without needless causes; these are named later.

    Args:
        exchanges: causes in whose place a rival may still be put.
    """
    recordings, begun = prepared.recordings, starts(prepared.scene)
    found = with_segment_elsewhere(found, recordings, begun)
    found = with_turned_wall(found, recordings)
    found, contact = with_peg_or_wall(found, contact, recordings)
    found = replace(found, at=best_sized(found.at, recordings))
    judged, near = found.at, _near_shapes(found.at, recordings, given)
    complete = _is_complete(near, recordings, given)
    least = setup.posterior.evidence
    found, bares, pruned = without_needless(found, recordings, begun, least, complete=complete)
    found, setup = _one_minimum(found, setup)
    if not complete and not found.causes:  # it may be another minimum, with dampings far off
        found, bares, more = without_needless(found, recordings, begun, least, complete=False)
        setup, pruned = found.at, {**pruned, **more}
    if found.at is not judged:
        near = _near_shapes(found.at, recordings, given)
    LOG.info(
        "explained by %s: log evidence %.1f, %.3f mm",
        ", ".join(c.label for c in found.causes) or "the set-up",
        found.at.posterior.evidence, 1e3 * near.mean_err,
    )  # fmt: skip
    # Judged in the end: what a cause does to a DLO looks like an error of the camera before.
    owns = own_errs(near, recordings)
    own = float(np.mean(owns))
    material = material_err(own, given)
    nameable = _nameable_err(found, setup, prepared, own)

    # A result that is the set-up alone stays the set-up.
    unnamed = Explanation(
        near if setup is found.at else setup, near, (), own, material, nameable, found.causes,
        found.trace, pruned, exact, contact,
    )  # fmt: skip

    def naming() -> Explanation:
        whole = near.mean_err < material
        causes, shifts, better = named(
            found, setup, bares, recordings, begun, owns, nameable, exact=exact, complete=whole,
            exchange=exchanges > 0,
        )  # fmt: skip
        if better is not None:
            more = _with_more(prepared, better, material_err(0.0, given))
            again = _concluded(
                prepared, given, more, setup, contact, exact=exact, exchanges=exchanges - 1
            )
            return again.with_names()
        causes = beside_contact(causes, contact, complete=whole)
        if not whole:
            causes = _no_stand_ins(causes, replace(found, at=near), prepared)
        if near.mean_err >= OWN * material:
            causes = without_dampings(causes, near)
        return replace(unnamed, causes=causes, shifts={**pruned, **shifts})

    return replace(unnamed, naming=naming)


def _is_complete(at: Evaluation, recordings: Sequence[Recording], given: Settings) -> bool:
    """Whether a model leaves nothing that matters."""
    return at.mean_err < material_err(own_err(at, recordings), given)


def _near_shapes(at: Evaluation, recordings: Sequence[Recording], given: Settings) -> Evaluation:
    """The model nearer to the shapes, where its fit has left them by more than what matters.

    Errors of the measurement that stay are cheap, however large: where no law of the model is
    quite right, a fit follows a motion more closely at the cost of shapes that are off all the
    time, by more than any measurement errs.
    """
    if _is_complete(at, recordings, given):
        return at
    near = approached(at, recordings)
    if near.mean_err > CLEARLY_LESS * at.mean_err:
        return at
    LOG.info(
        "the fit lies %.3f mm off, and may lie %.3f mm off", *(1e3 * x.mean_err for x in (at, near))
    )
    try:
        return evaluate(near.model, recordings)
    except SimulationError:
        return at


def _nameable_err(found: Search, setup: Evaluation, prepared: Prepared, own: float) -> float:
    """ERR [m] that an added effect must take away to be named.

    That is a share of what the set-up leaves, and of what the rod's laws are needed for: an effect
    that takes less away may only mend one of them. Clamps, camera and time have no law that could
    be another: their errors are none that an effect mends.

    Args:
        own: the measurement's own error [m].
    """
    missed, plain = LOWERS * (setup.mean_err - own), prepared.plain_err
    if missed < SMALL_SHARE * (plain - own) and any(c.start is not None for c in found.causes):
        plain = min(plain, _err_without_laws(setup, prepared.recordings))
    return max(missed, SMALL_SHARE * (plain - own))


def _err_without_laws(setup: Evaluation, recordings: Sequence[Recording]) -> float:
    """ERR [m] to which the set-up can come where the rod is as it should be."""
    of_rod = [
        p for p in setup.model.parameters if p.tolerated and ROD in effects()[p.effect].acts_on
    ]
    model = setup.model.at_centres([p.name for p in of_rod])
    try:
        bare = rejudged(borrowed(setup, model, recordings))
    except SimulationError as err:
        LOG.info("the rod as it should be: %s", err)
        return float("inf")
    return nearest_err(fit(bare, recordings, FIT_ITERATIONS), recordings)


def _one_minimum(found: Search, setup: Evaluation) -> tuple[Search, Evaluation]:
    """The result and the fit of the set-up; where no cause is left, they are the better of both.

    A fit from where a cause was left out may end in another minimum than that of the set-up alone,
    a worse one or a better one.
    """
    if found.causes:
        return found, setup
    if found.at.mean_err <= setup.mean_err:
        return found, found.at
    likely = setup.posterior.evidence > found.at.posterior.evidence - WORTH
    return (replace(found, at=setup) if likely else found), setup


def _no_stand_ins(
    causes: tuple[Cause, ...], found: Search, prepared: Prepared
) -> tuple[Cause, ...]:
    """The causes that are no stand-ins for an unknown one where something is left unexplained.

    Of a few shapes each of many effects explains most: what is told is that one of them acts.
    """
    many = departures(found.at, found.causes) > FEW_DEPARTURES
    if not many and all(len(r.times) < FEWEST_FRAMES for r in prepared.recordings):
        return tuple(c for c in causes if c.rivals)
    most = MOST_LEFT_BY_MANY if many else MOST_LEFT
    return () if found.at.mean_err > most * prepared.plain_err else causes


def _beginning(
    prepared: Prepared, begun: Sequence[Start], contact: Contact | None, enough: float
) -> tuple[Evaluation, Trial | None]:
    """The set-up, and the cause that no derivative tells of, with which the search begins.

    Args:
        contact: what may have been hit; None: nothing.
    """
    setup, recordings = prepared.setup, prepared.recordings
    firsts = [contact.trial if contact is not None else None]
    if setup.mean_err > enough:
        far = best_far_start(setup, prepared.meant, recordings, begun)
        bare = without(*far, recordings) if far is not None else None
        if far is not None and bare is not None and not gains(far, bare):
            # The cause was the way to another minimum, in which the set-up needs none.
            setup, far = bare, None
        firsts.append(far)
    found = [f for f in firsts if f is not None and gains(f, setup)]
    return setup, max(found, key=lambda f: f[0].posterior.evidence, default=None)
