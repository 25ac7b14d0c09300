# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Moments of an event, such as a slip, that each recording has of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np
from scipy.optimize import minimize

from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import Start, quantities
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import (
    OWN,
    Parameter,
    ParametricModel,
    acts_in,
    number_of,
    split_name,
    value_of,
    with_values,
)
from dlo_ros.spline import FloatArray

MOMENT_TRIALS = 25
"""Moments of a recording that are simulated: no derivative leads to them from far away."""


def has_common_moments(cause: Proposal) -> bool:
    """Whether numbers of a cause say when it happens in all recordings alike."""
    return any(OWN not in p.name and _says_when(p) for p in cause.parameters)


def with_own_moments(model: ParametricModel, recordings: Sequence[Recording]) -> ParametricModel:
    """The model in which what happens once does so in each recording at a moment of its own.

    Recordings that have one keep it; others begin at that of all.
    """
    names = list(dict.fromkeys(r.name for r in recordings))
    settings, parameters = model.settings, list[Parameter]()
    for p in model.parameters:
        number = number_of(p.name)
        if not _says_when(p):
            parameters.append(p)
        elif all(number_of(other.name) != number for other in parameters):
            common = value_of(model.settings, number)
            own = [f"{number}{OWN}{recording}" for recording in names]
            settings = with_values(settings, {n: model.settings.own.get(n, common) for n in own})
            parameters += [replace(p, name=name) for name in own]
    return ParametricModel(settings, tuple(parameters))


def nearest_moments(
    model: ParametricModel, recordings: Sequence[Recording], starts: Iterable[Start]
) -> ParametricModel:
    """The model with own moments: those of some that come nearest to each recording's shapes.

    Where something happens, it does at once: no derivative leads there from far away.

    Args:
        starts: beginnings of the effect that happens, whose moments are tried beside the model's.
    """
    tried = [model]
    for start in starts:
        theta = model.theta()
        for k, p in enumerate(model.parameters):
            if p.effect == start.effect and _says_when(p) and p.key in start.block:
                theta[k] = p.inner(cast(float, start.block[p.key]))
        tried.append(model.at(theta))
    errs = np.full((len(tried), len(recordings)), np.inf)
    for k, other in enumerate(tried):
        with suppress(SimulationError):
            errs[k] = [float(e.mean()) for e in simulate(other, recordings, ()).err]
    nearest = np.argmin(errs, axis=0)
    theta = model.theta()
    for recording, best in zip(recordings, nearest, strict=True):
        there = tried[best].theta()
        for k, p in enumerate(model.parameters):
            if OWN in p.name and acts_in(p.name, recording.name):
                theta[k] = there[k]
    return model.at(theta)


def refined_moments(model: ParametricModel, recordings: Sequence[Recording]) -> ParametricModel:
    """The model with each recording's own moments where they come nearest to its shapes.

    Derivatives hold no farther than the event takes, which may be one picture.
    """
    theta = model.theta()
    for recording in recordings:
        places = [
            k for k, p in enumerate(model.parameters)
            if OWN in p.name and acts_in(p.name, recording.name)
        ]  # fmt: skip
        if not places:
            continue

        def err(moments: FloatArray, places: list[int] = places, r: Recording = recording) -> float:
            moved = theta.copy()
            moved[places] = moments
            try:
                return float(simulate(model.at(moved), [r], ()).err[0].mean())
            except SimulationError:
                return model.settings.rod.length  # farther off than what can be simulated

        steps = np.diag([model.parameters[k].step for k in places])
        simplex = theta[places] + np.vstack([np.zeros(len(places)), steps])
        found = minimize(
            err, theta[places], method="Nelder-Mead",
            options={"maxfev": MOMENT_TRIALS, "initial_simplex": simplex},
        )  # fmt: skip
        theta[places] = found.x
    return model.at(theta)


def of_model(cause: Proposal, model: ParametricModel) -> Proposal:
    """The cause with the parameters that its numbers have in a model, see `with_own_moments`."""
    numbers = {number_of(p.name) for p in cause.parameters}
    own = tuple(p for p in model.parameters if number_of(p.name) in numbers)
    return replace(cause, parameters=own)


def for_recordings(model: ParametricModel, recordings: Sequence[Recording]) -> ParametricModel:
    """A model that was fitted to other recordings, with moments of these where it has such."""
    return with_own_moments(model, recordings) if model.settings.own else model


def _says_when(p: Parameter) -> bool:
    """Whether a parameter says when something happens, see `Quantity.once`."""
    return bool(p.effect) and quantities(p.effect)[split_name(p.name)[1]].once
