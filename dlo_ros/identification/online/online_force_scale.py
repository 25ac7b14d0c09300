# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces at the grips while the DLO moves: the common scale of E, mu and drag."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import LONG, SHORT, Pieces
from dlo_ros.identification.force_scale import borne_along, scale_of
from dlo_ros.identification.information import diameter_error
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.inference.forecast import Manipulation, predictions_at
from dlo_ros.inference.thresholds import FEWEST, SMALL_SHARE
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.protocol import RodSimulation
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

    def weigh(
        self, run: Run, past: Sequence[Observation], commands: Sequence[Command],
        prior: PriorInformation, begin: Callable[[], Pieces[RodSimulation]],
    ) -> Pieces[None]:  # fmt: skip
        """Estimate the scale of all forces from those of the window, where that is due.

        Args:
            run: run of the model along the observations of the window.
            past: the observations of the window.
            commands: commands that led the grips.
            prior: prior information, to which the result is added.
            begin: function that starts a simulation of the window with loads, as the run's.
        """
        ratio = float(run.at.theta[0] - run.at.theta[1])
        same = abs(ratio - self._ratio) < SMALL_SHARE
        if not self._rows or run.used < FEWEST or (same and run.used < GROWTH * self._used):
            return
        self._used, self._ratio = run.used, ratio
        theta = run.at.theta
        try:
            yield LONG
            simulation = yield from begin()
            stamps = [o.stamp for o in past if o.stamp >= simulation.stamp]
            loadings: list[Loading | None] = []
            for stamp in stamps:
                yield SHORT
                loadings += [p.loading for p in predictions_at(simulation, [stamp])]
        except SimulationError as err:
            LOG.warning("measured forces are not used for now: %s", err)
            return
        bearing = [x for x in loadings if x is not None]
        live = Manipulation("live", tuple(commands), tuple(past), self._wrenches())
        borne, diameter = borne_along(live, bearing, stamps), diameter_error(self._settings.rod)
        found = yield from scale_of(borne, self._settings, diameter_std=diameter)
        if found is None or (not self._weighed and found.information < prior.forces[MU, MU]):
            return  # an earlier window has more information
        self._weighed = True
        prior.forces = np.zeros_like(prior.forces)
        prior.forces[MU, MU] = found.information
        prior.force_centre = theta.copy()
        prior.force_centre[MU] += found.log

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
