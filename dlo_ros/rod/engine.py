"""Compiled motion of the rod through a series of instants, with control of the error.

Every step is made by `stepping`, its sensitivities by `variation`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod.stepping import (
    DONE,
    NO_CONVERGENCE,
    NO_DIRECTION,
    SMALLEST_STEP,
    Moving,
    step,
)
from dlo_ros.rod.variation import vary

FIRST_STEP = 1e-3  # [s]


@njit(cache=True, nogil=True)
def _next_stop(times, now, stop):
    """The next corner of the imposed motion, or the stop itself."""
    after = np.searchsorted(times, now + 1e-9, side="right")
    if after < times.size and now + 1e-9 < times[after] < stop - 1e-9:
        return times[after]
    return stop


@njit(cache=True, nogil=True)
def march(system, imposed, state, stops, tolerance, newton, variants, varying, shapes,
          derivatives):  # fmt: skip
    """Integrate to a series of times.

    Args:
        system, imposed, state: the rod, its command, where it is.
        stops: times [s] from the command's start, growing, (S,).
        tolerance: error that one step may add [m], in the mean over the rod.
        newton: error that Newton's method may leave, of L.
        variants, varying: what P sensitivities need, see `variation`; P = 0 carries none.
        shapes: output, (S, n, d).
        derivatives: output, (S, P, n, d).

    Returns:
        Status, the state at the end (where it failed: the last good one), its sensitivities, and
        the steps taken.
    """
    steps = 0
    for k in range(stops.size):
        while state.time < stops[k] - 1e-12:
            limit = _next_stop(imposed.times, state.time, stops[k])
            remaining = limit - state.time
            proposal = state.next_step if state.next_step > 0.0 else FIRST_STEP
            pieces = max(1.0, np.ceil(remaining / proposal * 0.999))
            h = remaining / pieces
            while True:
                steps += 1
                status, error, new = step(system, imposed, state, h, newton)
                if status == NO_DIRECTION:
                    return status, state, varying, steps
                if status == DONE and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                    break
                if status == DONE:
                    h *= max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0))
                else:
                    h *= 0.25
                if h < SMALLEST_STEP:
                    return NO_CONVERGENCE, state, varying, steps
            if variants.step.size > 0:
                varying = vary(system, imposed, state, new, variants, varying)
            longer = 2.0
            if error > 0.0:
                longer = min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
            # A step cut short by a stop says nothing against a longer one.
            wanted = max(h * longer, min(proposal, h * 10.0) * 0.2)
            reached = limit if h >= remaining * (1.0 - 1e-12) else new.time
            state = _proposing(new, reached, wanted)
        shapes[k] = state.q
        for a in range(variants.step.size):
            derivatives[k, a] = varying.q[a]
    return DONE, state, varying, steps


@njit(cache=True, nogil=True)
def _proposing(s, time, next_step):
    """The state with an exact time and the step that the error control proposes."""
    return Moving(
        time, s.last_step, next_step, s.q, s.velocity, s.acceleration, s.auxiliary, s.reference,
        s.frames, s.stretch, s.stretch_before, s.other, s.other_before, s.history,
    )  # fmt: skip
