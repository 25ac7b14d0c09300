# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces at the grips while the DLO moves: the common scale of E, mu and drag."""

from __future__ import annotations

import logging
from collections import deque

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import LONG, SHORT, Pieces
from dlo_ros.identification.force_scale import borne_along, scale_of
from dlo_ros.identification.information import diameter_error
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.identification.online.observed_window import ObservedWindow
from dlo_ros.inference.forecast import Manipulation, predictions_at
from dlo_ros.inference.thresholds import FEWEST, SMALL_SHARE
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

MOST_SAMPLES = 60_000
"""Messages of an end that are remembered: a minute at 1 kHz."""
GROWTH = 1.3
"""Growth of the window after which they are looked at again, as after a change of ln(E/mu)."""
MU = MATERIAL.index("density")


class Forces:
    """Measured forces, and the scale that they determine.

    Args:
        settings: the parameter file.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._rows: dict[str, deque[tuple[int, FloatArray, FloatArray]]] = {}
        self.fold()

    def add(self, measured: Wrenches) -> None:
        """Add the wrenches measured at an end."""
        rows = self._rows.setdefault(measured.end, deque(maxlen=MOST_SAMPLES))
        values = np.hstack([measured.force, measured.torque])
        rows.extend(zip(measured.stamps.tolist(), values, measured.axes, strict=True))

    def fold(self) -> None:
        """A new window begins, which has not weighed the forces yet."""
        self._used, self._ratio, self._weighed = 0, np.nan, False

    def weigh(self, run: Run, past: ObservedWindow, prior: PriorInformation) -> Pieces[None]:
        """Estimate the scale of all forces from those of the window, where that is due.

        Args:
            run: run of the model along the observations of the window.
            past: the window.
            prior: prior information, to which the result is added.
        """
        ratio = float(run.at.theta[0] - run.at.theta[1])
        same = abs(ratio - self._ratio) < SMALL_SHARE
        if not self._rows or run.used < FEWEST or (same and run.used < GROWTH * self._used):
            return
        self._used, self._ratio = run.used, ratio
        theta, seen, twin = run.at.theta, tuple(past.observations), run.simulation
        try:
            yield LONG
            simulation = yield from past.started(twin.settings, twin.basis.even_spans, loads=True)
            stamps = [o.stamp for o in seen if o.stamp >= simulation.stamp]
            loadings: list[Loading] = []
            for stamp in stamps:
                yield SHORT
                found = predictions_at(simulation, [stamp])
                loadings += [p.loading for p in found if p.loading is not None]
        except SimulationError as err:
            LOG.warning("measured forces are not used for now: %s", err)
            return
        live = Manipulation("live", tuple(past.motion.commands), seen, self._wrenches())
        borne = borne_along(live, loadings, stamps, self._settings)
        diameter = diameter_error(self._settings.rod)
        scale = yield from scale_of(borne, self._settings, diameter_std=diameter)
        if scale is None or (not self._weighed and scale.information < prior.forces[MU, MU]):
            return  # an earlier window has more information
        self._weighed = True
        prior.forces = np.zeros_like(prior.forces)
        prior.forces[MU, MU] = scale.information
        prior.force_centre = theta.copy()
        prior.force_centre[MU] += scale.log

    def _wrenches(self) -> tuple[Wrenches, ...]:
        """Measured wrenches of each end."""
        result = []
        for end, rows in self._rows.items():
            table = {stamp: (values, axes) for stamp, values, axes in rows}
            stamps = sorted(table)
            values, axes = (np.array([table[s][k] for s in stamps]) for k in (0, 1))
            result.append(
                Wrenches(end, np.array(stamps, dtype=np.int64), values[:, :3], values[:, 3:], axes)
            )
        return tuple(result)
