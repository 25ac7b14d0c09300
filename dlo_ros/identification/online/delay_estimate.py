# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Live estimate of the delay between commands and pictures, as where two clocks differ.

A turned clamp and another material fit a delayed motion, too. So the delay is that of the joint
model with all of its set-up open within tolerance, as in `identify`, and far from the estimate that
model is not linear: it is linearised again until the delay stays what it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlo_ros.effects.measurement.command_delay import CommandDelay
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.gradual_simulation import simulated
from dlo_ros.identification.online.accumulated_information import fitted_variances
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import measured
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LINEARISATIONS = 8
"""Linearisations at a time; the next time goes on from there. 0.1 s takes up to a dozen."""
UNCHANGED = 0.3
"""Step of the delay, over its std, from which on it is found: the steps halve, so that what is left
is less than the std."""


class DelayEstimate:
    """Posterior of the time by which the DLO is seen to move later than commanded.

    Args:
        given: the parameter file, which states the set-up.

    Attributes:
        found: posterior mean and std of the delay [s]; None: not found (yet), stated in the
            parameter file, or shapes that leave the plane.
    """

    def __init__(self, given: Settings) -> None:
        self.found: tuple[float, float] | None = None
        self._given = given
        self._theta: FloatArray | None = None  # where the model was linearised last

    def compute(self, past: Manipulation, settings: Settings, spans: int) -> Pieces[None]:
        """Linearise anew, piece by piece.

        Args:
            past: commands and observations from the start of the simulation on.
            settings: settings with the estimate.
            spans: knot spans of the simulation.

        Raises:
            SimulationError: the motion cannot be simulated.
        """
        recording = replace(measured(past, settings), spans=spans)
        view = scene(settings, imposed_names([past]), [recording.observed])
        model, name = joint_model(settings, self._given, view), CommandDelay.parameter("delay")
        if not recording.planar or name not in model.names:
            return
        k, theta, self._theta = model.index(name), self._theta, None
        for _ in range(LINEARISATIONS):
            model = model if theta is None else model.at(theta)
            ((residual, jacobian),) = (yield from simulated(model, recording, model.names)).fields
            yield LONG
            bins = spectrum(residual, jacobian, settings.rod.control_points)
            prior = model.offset(), model.precision()
            _, posterior = yield from fitted_variances(bins, *prior, settings.rod.length)
            theta = model.theta() + posterior.step
            variance, prior_std = float(posterior.covariance[k, k]), model.parameters[k].std
            self.found = None
            if abs(posterior.step[k]) < UNCHANGED * np.sqrt(variance):
                # The error of the simulation is no noise that more pictures average out.
                off = settings.simulation.tolerance * settings.rod.length
                speed = max(float(np.sqrt(np.mean(jacobian[:, k] ** 2))), off / prior_std)
                shift = (1.0 - variance / prior_std**2) * off / speed
                self.found = float(theta[k]), float(np.hypot(np.sqrt(variance), shift))
                break
        self._theta = theta
