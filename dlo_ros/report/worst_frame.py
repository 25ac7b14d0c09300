# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The frame of a recording at which a simulation is most wrong, gross errors of measurement aside.

A simulation moves on from one picture to the next, and so does its error. A single picture whose
ERR is far above that of both of its neighbours was measured wrongly.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from dlo_ros.spline import FloatArray

NEIGHBOURS = 3
"""Frames whose median is the lasting ERR of the one in their middle."""


def lasting_err(err: FloatArray) -> FloatArray:
    """ERR without that of single frames that stand out from both of their neighbours, shape (F,).

    Args:
        err: ERR of each frame, shape (F,).
    """
    if len(err) < NEIGHBOURS:
        return err
    return np.asarray(median_filter(err, NEIGHBOURS, mode="mirror"))


def worst_err(err: FloatArray) -> float:
    """Largest ERR that lasts, of frames of shape (F,)."""
    return float(lasting_err(err).max())


def is_lasting(err: FloatArray) -> np.ndarray:
    """Whether each frame is no more wrong than frames are for more than an instant, shape (F,)."""
    return np.asarray(err <= worst_err(err))


def worst_frame(err: FloatArray) -> int:
    """Index of the frame that is most wrong among those whose error lasts."""
    return int(np.argmax(np.where(is_lasting(err), err, -np.inf)))
