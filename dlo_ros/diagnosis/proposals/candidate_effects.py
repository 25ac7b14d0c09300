# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The starting values at which every effect of the registry is tried on recordings.

Each effect names its own (`Effect.starts`): an effect whose derivative at its neutral value is
useful starts there, at several places where it has a place; others (yield, friction) start with a
few plausible sizes. Pegs are found by `contact_search`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.effects import Quantity, Scene, Start, effects, quantities
from dlo_ros.spline import FloatArray


def starts(scene: Scene, present: Sequence[str] = ()) -> list[Start]:
    """Starting values of all effects that the model does not contain yet."""
    result: list[Start] = []
    for name, effect in effects().items():
        if name not in present:
            result += effect.starts(scene)
    return result


def moved(start: Start, amounts: Sequence[float]) -> Start:
    """A start whose screened numbers are changed by amounts in the units of the fit.

    Args:
        amounts: amounts in the order of the block's keys; of the logarithm where that is fitted.
    """
    left = list(amounts)
    return _changed(start, lambda q, v: q.restored(q.transformed(v) + left.pop(0)))


def shrunk(start: Start, share: float) -> Start:
    """A start whose screened numbers lie between neutral (share 0) and their present value (1)."""

    def part(q: Quantity, value: float) -> float:
        neutral = q.transformed(q.neutral)
        return q.restored(neutral + share * (q.transformed(value) - neutral))

    return _changed(start, part)


def within_range(start: Start, amounts: FloatArray) -> FloatArray:
    """Amounts of `moved` with which every number stays in its range, shape (P,)."""
    keys = quantities(start.effect)
    lower, upper = [], []
    for key in start.screened:
        q = keys[key]
        for value in np.atleast_1d(np.asarray(start.block[key])):
            here = q.transformed(float(value))
            lower.append(q.transformed(q.lower) - here)
            upper.append(q.transformed(q.upper) - here)
    return np.asarray(np.clip(amounts, lower, upper))


def _changed(start: Start, change: Callable[[Quantity, float], float]) -> Start:
    """A start in which every screened number is changed."""
    block, keys = dict(start.block), quantities(start.effect)
    for key in start.screened:
        value, q = block[key], keys[key]
        if isinstance(value, tuple):
            block[key] = tuple(change(q, v) for v in value)
        else:
            block[key] = change(q, value)
    return replace(start, block=block)
