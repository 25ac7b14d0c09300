# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Robust fits to those pictures that a model can explain, where others deviate far.

A DLO that hits something now and then is predicted well before and badly after. A fit to everything
settles between the two and is wrong throughout, so that nothing shows where it hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, Simulated, evaluate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WHITE, RobustLoss
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.thresholds import CERTAIN, UNDISTURBED

QUIET, LOUDER = 0.3, 1.5
"""Where fewer are right: share of the pictures that are taken for undisturbed, and the scale of the
loss over their deviation."""
ITERATIONS = 8
FIRST_PARTS = (1.0, 0.12, 0.25, 0.5)
"""Shares of each recording, from its beginning, to which a first fit is made, before a contact."""
LEAST_FRAMES = 5
PART_ITERATIONS = 6


def robust_loss(
    recordings: Sequence[Recording], scale: float = CERTAIN, *, redescending: bool = False
) -> RobustLoss:
    """The robust loss of recordings, see `RobustLoss`; pictures beyond its scale count ever less.

    Args:
        scale: in units of the noise.
    """
    return RobustLoss([r.noise for r in recordings], scale, redescending)


def consensus_fit(drafts: Sequence[Recording], at: Evaluation) -> tuple[Evaluation, float] | None:
    """The robust fit that explains most pictures, from several starts, and the scale of its loss.

    Args:
        drafts: the recordings with a coarse simulation.
        at: the plain model, fitted to all pictures.

    Returns:
        The fit to the drafts, and `scale` as in `robust_loss`; None where none can be simulated.
    """
    begun = Threads().map(partial(_begun, at, drafts), FIRST_PARTS)
    starts = [(s, b) for s, b in zip(FIRST_PARTS, begun, strict=True) if b is not None]
    scale, best = CERTAIN, at
    for _ in range(2):
        fits = Threads().map(partial(_robust, drafts, scale), starts)
        found = [f for f in fits if f is not None]
        if not found:
            return None
        best = min(found, key=robust_loss(drafts, scale, redescending=True).of_pictures)
        each = np.concatenate(robust_loss(drafts, 1.0).squares(best))
        if np.mean(each < scale**2) > UNDISTURBED:
            break
        # Something else is wrong all the time.
        scale = max(CERTAIN, LOUDER * float(np.sqrt(np.quantile(each, QUIET))))
    return best, scale


def _begun(at: Evaluation, drafts: Sequence[Recording], share: float) -> Evaluation | None:
    """The fit to the first part of each recording, on the whole of them."""
    model = at.model
    try:
        if share < 1.0:
            part = [d.until(max(LEAST_FRAMES, int(share * len(d.times)))) for d in drafts]
            model = fit(evaluate(model, part), part, PART_ITERATIONS, loss=WHITE, draft=True).model
        return evaluate(model, drafts)
    except SimulationError:
        return None


def _robust(
    drafts: Sequence[Recording], scale: float, start: tuple[float, Evaluation]
) -> Evaluation | None:
    """A robust fit that begins with the fit to a share of each recording."""
    share, begun = start
    try:
        if share == 1.0:
            begun = fit(begun, drafts, ITERATIONS, loss=robust_loss(drafts, scale))
        strict = robust_loss(drafts, scale, redescending=True)
        return fit(begun, drafts, ITERATIONS, loss=strict, draft=True)
    except SimulationError:
        return None


def outlier_frames(
    at: Simulated, recordings: Sequence[Recording], scale: float
) -> list[np.ndarray]:
    """Pictures whose deviation exceeds the scale, shape (F,) per recording."""
    return [o > 1.0 for o in robust_loss(recordings, scale).squares(at)]
