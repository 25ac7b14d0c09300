# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Evidence for a measured course: how evenly it bends, and how long it is.

A DLO's curvature changes slowly along it. A course that changes over to another strand where both
meet, and back again, bends to and fro in between, however smooth each link of it is.
"""

from __future__ import annotations

import math

import numpy as np

from dlo_ros.parameters import RodParameters
from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.material_coordinates import length_log_likelihood
from dlo_ros.vision.fit.spline_fit import SplineFit
from dlo_ros.vision.segmentation.picture_strip import resample

STEPS = 2  # points of the course in a width
BEND = 10.0  # [widths] of a DLO along which changes of curvature are one observation
LEAST_CHANGE = 0.005
"""[rad per width squared] Change of curvature that the errors of a measured course fake."""


def evidence(fit: SplineFit, rod: RodParameters) -> float:
    """Log likelihood of a measured course, up to a constant.

    Args:
        fit: the fitted spline of the course.
        rod: parameters of the DLO.
    """
    length = length_log_likelihood(fit.seen_length, rod.length, rod.length_std)
    return bending_evidence(fit.curve, fit.width) + float(length)


def chance_length(
    seen: float, limits: tuple[float, float], length: float, length_std: float
) -> bool:
    """Whether a course that is not the DLO is likelier to have a length than the DLO.

    A course of pieces of several strands may have any length within the limits.

    Args:
        seen: length of the course [m].
        limits: shares of L by which it may be too short or too long.
        length: L [m].
        length_std: standard deviation of L [m]; 0: not known.
    """
    chance = -math.log(sum(limits) * length)
    return float(length_log_likelihood(seen, length, length_std)) < chance


def bending_evidence(course: FloatArray, width: float) -> float:
    """Log likelihood of a course's changes of curvature, up to a constant.

    They are taken as normally distributed; their variance, which depends on the DLO and on how it
    lies, is unknown and integrated out with the prior of a scale (Jeffreys, Theory of probability,
    1939, section 3.1): of n observations with the mean square m the likelihood is m to the power
    of -n / 2.

    Args:
        course: the measured course, bridged where nothing was seen, shape (m, 2), or in space
            (m, 3).
        width: width of the DLO, in the unit of the points.
    """
    line = resample(course, width / STEPS)
    if len(line) < 2 * STEPS:
        return 0.0
    tangent = _unit(np.gradient(line, axis=0))
    curvature = np.gradient(tangent, axis=0) * STEPS
    change = np.gradient(curvature, axis=0) * STEPS
    change -= np.sum(change * tangent, axis=1, keepdims=True) * tangent
    square = float(np.mean(np.sum(change**2, axis=1))) + LEAST_CHANGE**2
    return -0.5 * len(line) / (BEND * STEPS) * math.log(square)


def _unit(vectors: FloatArray) -> FloatArray:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(size, 1e-12))
