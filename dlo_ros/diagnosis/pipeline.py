# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The pipeline of the diagnosis: from recordings to model errors, their causes, and the gain."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp, contacts_beside_set_up
from dlo_ros.diagnosis.explain.measurement_error import material_err
from dlo_ros.diagnosis.findings.diagnosis_outcome import Diagnosis
from dlo_ros.diagnosis.findings.joint_learning import (
    Learned,
    TrainingSet,
    all_learned_from,
    learn,
    nearer,
    surprising,
    training_set,
    with_names,
)
from dlo_ros.diagnosis.findings.joint_outcome import joint_outcome
from dlo_ros.diagnosis.findings.measured_force_scale import with_forces
from dlo_ros.diagnosis.proposals.time_steps import with_short_steps
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.offline.drafts import drafts
from dlo_ros.identification.offline.initial_fit import Beginning, begin, finer, fitted
from dlo_ros.identification.offline.recording_identification import Progress
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.joint import Evaluation, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.thresholds import CLEARLY_LESS
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)


def diagnose(
    recordings: Sequence[Manipulation],
    settings: Settings,
    holdout: Sequence[Manipulation] = (),
    *,
    progress: Progress = lambda text, share: None,
) -> Diagnosis:
    """Find what the model gets wrong.

    Args:
        recordings: recordings to learn from; without `holdout` one of them, or the end of the only
            one, is held out for the measured gain.
        settings: initial guess, what is known beforehand, and effects that are known already.
        holdout: recordings that are only predicted.
        progress: function that is called with the name of the present step and the fraction of it
            that is done.

    Raises:
        InputError: no usable recording.
        SimulationError: the plain model cannot be simulated with any starting value.
    """
    if not recordings:
        raise InputError("no recording to diagnose; give at least one bag")
    given = searchable(settings)
    count = len(recordings)
    progress("fitting the plain model", 0.0)
    beginning = _begun([*recordings, *holdout], given)
    plain, found = _explained(beginning, count, given, progress)
    better = _better_plain_model(plain, found, beginning)
    if better is not None:
        progress("fitting the plain model anew", 0.0)
        beginning = _begun([*recordings, *holdout], given, better)
        whole = found.explanation.at.mean_err < found.explanation.material_err
        plain, found = _explained(beginning, count, given, progress, found if whole else None)
    beginning, plain, found = _refined(beginning, plain, found, count, given, progress)
    progress("naming the causes", 1.0)
    named = with_names(found, beginning.recordings)
    if named.explanation.at is not found.explanation.at:  # a rival has come nearer than a cause
        beginning, plain, found = _refined(beginning, plain, named, count, given, progress)
        named = with_names(found, beginning.recordings)
    progress("measuring the gain", 1.0)
    outcome = joint_outcome(beginning, plain, named, given)
    outcome = replace(
        outcome, left_out=_left_out(beginning), given_err=_given_err(given, beginning.recordings)
    )
    return with_forces(outcome, recordings, given)


def _begun(
    recordings: Sequence[Manipulation], given: Settings, better: ParametricModel | None = None
) -> Beginning:
    """The initial fit, with time steps that are short enough for what may be added to it."""
    found = begin(recordings, given, better)
    return replace(found, recordings=with_short_steps(found.recordings, found.at))


def _given_err(given: Settings, recordings: Sequence[Recording]) -> float | None:
    """ERR of the parameter file as it stands [m]; None where it cannot be simulated."""
    try:
        return simulate(ParametricModel(given, ()), recordings, ()).mean_err
    except SimulationError as err:
        LOG.info("the parameter file as it stands: %s", err)
        return None


def _explained(
    beginning: Beginning, count: int, given: Settings, progress: Progress,
    before: Learned | None = None,
) -> tuple[Evaluation, Learned]:  # fmt: skip
    """The plain model fitted to the first `count` recordings, and their explanation.

    It is learned from all of them where the one that is held out shows what the others do not.

    Args:
        before: what was learned with a coarser simulation or from another plain model; None:
            nothing.
    """
    learned = beginning.recordings[:count]
    plain = _learned(beginning, count)
    rough = cache(partial(drafts, learned, plain))

    begin_with = partial(training_set, beginning, count, plain.model.settings, given)

    def explained(begun: TrainingSet, known: Learned | None) -> Learned:
        contacts = partial(_met, rough, plain, begun, given, progress)
        return learn(begun, given, contacts, None if known is None else known.explanation)

    progress("fitting the joint model", 0.0)
    begun = begin_with(all_of_them=before is not None and all_learned_from(before))
    found = explained(begun, before)
    if not surprising(begun, found):
        return plain, found
    progress("fitting the joint model to all recordings", 0.3)
    try:
        again = explained(begin_with(all_of_them=True), found)
    except SimulationError as err:
        LOG.info("not learned from all recordings: %s", err)
        return plain, found
    return plain, again if nearer(again, found) else found


def _met(
    rough: Callable[[], Sequence[Recording]], plain: Evaluation, begun: TrainingSet,
    given: Settings, progress: Progress,
) -> list[ContactBesideSetUp]:  # fmt: skip
    """Pegs and walls that the DLO may have hit, where the set-up alone leaves so much that other
    causes are looked for: what an impact leaves may look like an error that stays.

    Args:
        rough: function that gives the recordings with a coarse simulation.
    """
    if begun.prepared.setup.mean_err < material_err(0.0, given):
        return []
    progress("looking for what was hit", 0.0)
    model = joint_model(plain.model.settings, given, begun.prepared.scene)
    return contacts_beside_set_up(rough(), given, model)


def _learned(beginning: Beginning, count: int) -> Evaluation:
    """The plain model fitted to the first `count` recordings, from which all may be learned.

    The initial fit has seen the others, too: from all recordings a starting point is found that
    each of them can be simulated from.
    """
    if count == len(beginning.recordings):
        return beginning.at
    learned = beginning.recordings[:count]
    return fitted(beginning.at.model, learned)


def _better_plain_model(
    plain: Evaluation, found: Learned, beginning: Beginning
) -> ParametricModel | None:
    """A plain model that does better than the fitted one, whose fit had ended in a wrong minimum.

    The material and damping of an explanation may lead out of that minimum.
    """
    there, here = found.explanation.at.model.settings, plain.model.settings
    rod = replace(here.rod, young_modulus=there.rod.young_modulus, density=there.rod.density)
    model = replace(plain.model, settings=replace(here, rod=rod, damping=there.damping))
    recordings = beginning.recordings[: len(plain.err)]
    try:
        at = simulate(model, recordings, ())
    except SimulationError:
        return None
    return model if at.mean_err < CLEARLY_LESS * plain.mean_err else None


def _refined(
    beginning: Beginning, plain: Evaluation, found: Learned, count: int, given: Settings,
    progress: Progress,
) -> tuple[Beginning, Evaluation, Learned]:  # fmt: skip
    """The explanation with a finer simulation, where it comes so near that it needs one."""
    progress("refining the simulation", 0.0)
    sharper = _sharper(plain, found, beginning)
    if sharper is None:
        return beginning, plain, found
    return sharper, *_explained(sharper, count, given, progress, found)


def _sharper(plain: Evaluation, found: Learned, beginning: Beginning) -> Beginning | None:
    """The initial fit with simulations that are fine enough for an explanation.

    They were made fine enough for what the plain model leaves over. What remains beside an
    explanation that comes nearer may be their own error, which effects would be fitted to.

    Returns:
        None where the simulation is fine enough, or cannot be finer.
    """
    near = replace(plain.model, settings=found.explanation.at.model.settings)
    try:
        return finer(beginning, near, found.drafts)
    except SimulationError as err:
        LOG.info("not refined: %s", err)
        return None


def _left_out(beginning: Beginning) -> str:
    """A sentence on the pictures that do not count; empty where all do."""
    pairs = zip(beginning.recordings, beginning.left_out, strict=False)
    wrong = {r.name: number for r, number in pairs if number}
    if not wrong:
        return ""
    count = sum(wrong.values())
    total = count + sum(len(r.times) for r in beginning.recordings)
    where = ", ".join(f"{name} {number}" for name, number in wrong.items())
    verb = "does" if count == 1 else "do"
    return (
        f"{count} of {total} pictures ({where}) {verb} not count: the observed shape is grossly "
        "wrong there."
    )
