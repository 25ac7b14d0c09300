# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The live estimator on whole recordings."""

import numpy as np

from dlo_ros.identification import OnlineEstimator


def live_estimate(recording, settings):
    """The last estimate of a live estimator that does all work as soon as it is due."""
    estimator = OnlineEstimator(settings, budget=np.inf)
    for command in recording.commands:
        estimator.set_command(command)
    for observation in recording.observations:
        estimator.observe(observation)
    return estimator.estimate
