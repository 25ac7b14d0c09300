# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rival values of E/mu: far from the truth a shape may lie on another branch."""

from __future__ import annotations

import numpy as np

from dlo_ros.identification.batched_forecast import forecast_in_pieces
from dlo_ros.identification.cooperative_tasks import Pieces
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.identification.online.linearised_model import Run
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.thresholds import CLEARLY_LESS
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

RIVALS = (1 / 30, 1 / 8, 1 / 3, 3.0, 8.0, 30.0)  # of E/mu
AT_ONCE = 4  # observations in a piece of work


def best_rival(past: Manipulation, run: Run, initial: Settings) -> Pieces[FloatArray | None]:
    """Logarithms with another E/mu that explain the past better than a run; None if none do.

    Args:
        past: commands and observations of the window.
        run: run along the same observations, or more.
        initial: the guess, about which the rivals lie.
    """
    spans = 2 * (initial.rod.control_points - DEGREE)
    guess, thetas = logarithms(initial), []
    for factor in RIVALS:
        theta = run.at.theta.copy()
        theta[0] = guess[0] - guess[1] + theta[1] + np.log(factor)
        thetas.append(theta)
    sets = [with_logarithms(initial, theta) for theta in thetas]
    forecasts = yield from forecast_in_pieces(past, sets, spans, frames=AT_ONCE)
    best, least = None, run.sum_of_squares_until(past.observations[-1].stamp)
    for theta, rival in zip(thetas, forecasts, strict=True):
        sum_of_squares = np.inf if rival is None else float(np.sum(rival.residual**2))
        if sum_of_squares < CLEARLY_LESS**2 * least:
            best, least = theta, sum_of_squares
    return best
