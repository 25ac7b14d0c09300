# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""An effect of the size and place that a cause may have, where nothing says how large it is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dlo_ros.effects import Quantity, Scene, effects, quantities
from dlo_ros.effects.start import Block, Value
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.design.expected_information import (
    Plan,
    is_reliable,
    mean_response,
)
from dlo_ros.inference.err import shape_errors
from dlo_ros.inference.forecast import Forecast, forecast
from dlo_ros.inference.parallel import Threads
from dlo_ros.parameters import Settings, tolerance
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

TOLERANCES = 3.0
"""Size of an effect that is a small error of every set-up, in tolerances; from two on it is named
as a cause."""


@dataclass(frozen=True)
class AssumedEffect:
    """An effect of a given size, as one explanation of what the plain model misses.

    Args:
        effect: name of the effect.
        block: values of its keys; all of them are fitted where it is the rival of another one.
    """

    effect: str
    block: Block


def plausible_explanation(
    effect: str,
    settings: Settings,
    seen: Scene,
    block: Block | None = None,
    plans: Sequence[Plan] = (),
) -> AssumedEffect:
    """An effect of a size that a cause may have.

    The size is that of one of the starts from which `diagnose` looks for it, or some tolerances
    where it is a small error of every set-up. Not every start makes sense in every manipulation: a
    wall may stand where a grip is, a grip may give way when all is over. So the starts are
    simulated in the manipulations. Of those that can be relied on and show in the most of them,
    the one of middle displacement is taken; where none does, or without manipulations, the middle
    one of all.

    Args:
        effect: name of the effect.
        settings: settings of the plain model.
        seen: scene of the manipulations.
        block: values of its keys; None: nothing says how large it is.
        plans: the manipulations.

    Raises:
        ParameterError: there is no such effect.
        InputError: nothing says how large it may be, or it adds to a damping that is only guessed.
    """
    known = quantities(effect)
    for q in known.values():
        if q.adds_to and q.adds_to not in seen.known:
            raise InputError(
                f"effects.{effect}: damping.{q.adds_to} is only a guess, which every explanation "
                f"fits anyway; state damping.{q.adds_to}_std to compare it with other effects"
            )
    if block:
        return AssumedEffect(effect, block)
    blocks = _plausible_blocks(effect, settings, seen)
    if not blocks:
        raise InputError(
            f"effects.{effect}: nothing says how large it may be; state its values in the "
            "parameter file"
        )
    if len(blocks) == 1 or not plans:
        return AssumedEffect(effect, _middle(blocks))
    moved = _displacements([AssumedEffect(effect, b) for b in blocks], settings, plans)
    shown = np.isfinite(moved).sum(axis=1)  # manipulations in which each of them shows
    best = np.flatnonzero((shown == shown.max()) & (shown > 0))
    best = best[np.argsort([np.nanmean(moved[k]) for k in best], kind="stable")]
    return AssumedEffect(effect, _middle([blocks[k] for k in best] or blocks))


def _middle(blocks: Sequence[Block]) -> Block:
    return blocks[len(blocks) // 2]


def _plausible_blocks(effect: str, settings: Settings, seen: Scene) -> list[Block]:
    """Values of sizes that a cause may have, for each start that opens most of the keys."""
    known, kind = quantities(effect), effects()[effect]

    def enlarged(neutral: Block, keys: Iterable[str]) -> Block:
        sizes = {k: _sized(known[k], neutral[k], settings, effect) for k in keys}
        return {**neutral, **sizes}

    setup = kind.setup(seen)
    if setup:
        return [enlarged(setup, setup)]
    starts = kind.starts(seen)
    most = max((len(s.fitted) for s in starts), default=0)
    return [
        enlarged(s.block, s.screened if s.neutral else ()) for s in starts if len(s.fitted) == most
    ]


def _sized(q: Quantity, value: Value, settings: Settings, effect: str) -> Value:
    """A neutral value, replaced by one that a cause may have."""
    known = tolerance(settings, f"{effect}.{q.name}")
    size = (
        q.restored(q.transformed(q.neutral) + TOLERANCES * known)
        if known
        else q.plausible_for(settings.scale, 1.0)
    )
    return (size,) * len(value) if isinstance(value, tuple) else size


def _displacements(
    explanations: Sequence[AssumedEffect], settings: Settings, plans: Sequence[Plan]
) -> FloatArray:
    """Mean displacement by each explanation in each manipulation, over L.

    Returns:
        Shape (explanations, plans); NaN where the explanation cannot be simulated or relied on, or
        does not move the DLO by more than the simulation's tolerance.
    """
    result = np.full((len(explanations), len(plans)), np.nan)
    for k, plan in enumerate(plans):
        plain = _simulated(plan, settings, None)
        if plain is not None:
            moved = partial(_displacement, settings=settings, plan=plan, plain=plain)
            result[:, k] = Threads().map(moved, explanations)
    return result


def _displacement(
    explanation: AssumedEffect, settings: Settings, plan: Plan, plain: Forecast
) -> float:
    """See `_displacements`; `plain` is the forecast without the effect."""
    effects_with = {**settings.effects, explanation.effect: explanation.block}
    found = _simulated(plan, settings.with_effects(effects_with), plain.spans)
    if found is None or not is_reliable(found, mean_response(found, settings)):
        return np.nan
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    moved = shape_errors(found.predicted, plain.predicted, basis) / basis.length
    return float(moved.mean()) if moved.max() > settings.simulation.tolerance else np.nan


def _simulated(plan: Plan, settings: Settings, spans: int | None) -> Forecast | None:
    """A manipulation with derivatives by E; None where it cannot be simulated."""
    try:
        return forecast(plan.manipulation(), settings, parameters=MATERIAL[:1], spans=spans)
    except SimulationError:
        return None
