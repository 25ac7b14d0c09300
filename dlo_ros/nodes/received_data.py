# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Data received from the live nodes: splines, ERR, estimates, diagnostics (no ROS here).

Whether the simulator had an estimate in time is told by the parameters that it is heard to take.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import itemgetter

from dlo_ros.inference.err import shape_error
from dlo_ros.inference.thresholds import IDENTIFIED
from dlo_ros.nodes.pairing import interpolated
from dlo_ros.rod.live_simulation import CORRECTION
from dlo_ros.spline import FloatArray, SplineBasis

YOUNG_MODULUS = "young_modulus"
DENSITY = "density"
SPECIFIC_MODULUS = "specific_modulus"
QUANTITIES = (YOUNG_MODULUS, DENSITY, SPECIFIC_MODULUS)

UNITS: Mapping[str, str] = {
    YOUNG_MODULUS: "Pa",
    DENSITY: "kg/m^3",
    SPECIFIC_MODULUS: "m^2/s^2",
}
BACKLOG = "splines waiting for the estimator"
"""Key of the identifier's diagnostics."""
SYMBOLS: Mapping[str, str] = {YOUNG_MODULUS: "E", DENSITY: "mu", SPECIFIC_MODULUS: "E/mu"}


@dataclass(frozen=True)
class EstimateSample:
    """The estimate at one instant.

    Args:
        stamp: time of the recording [ns].
        values: values by the names in `QUANTITIES`, SI units.
        std: standard deviations by the same names; infinite where unknown.
    """

    stamp: int
    values: Mapping[str, float]
    std: Mapping[str, float]


@dataclass
class ReceivedData:
    """All data received from the nodes so far, by the recording's time.

    Args:
        observed, predicted: control points, shape (n, 4), by stamp [ns].
        err: stamp [ns] and ERR [m], in the order of arrival.
        samples: the estimates, likewise.
        facts: the last key values of the identifier's diagnostics.
        warnings: texts of diagnostics above OK, each once.
        simulated: instants [ns] at which the simulator has taken other parameters, and E/mu from
            then on [m^2/s^2], in the order of arrival.
        now: the clock [ns]; 0 before the first tick.
        passes: number of times that the recording was played.
    """

    observed: dict[int, FloatArray] = field(default_factory=dict)
    predicted: dict[int, FloatArray] = field(default_factory=dict)
    err: list[tuple[int, float]] = field(default_factory=list)
    samples: list[EstimateSample] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    simulated: list[tuple[int, float]] = field(default_factory=list)
    now: int = 0
    passes: int = 1
    young_modulus: float = math.nan
    density: float = math.nan

    def estimate(self) -> EstimateSample | None:
        """The estimate as it stands, None before the first."""
        if not (math.isfinite(self.young_modulus) and math.isfinite(self.density)):
            return None
        values = {
            YOUNG_MODULUS: self.young_modulus,
            DENSITY: self.density,
            SPECIFIC_MODULUS: self.young_modulus / self.density,
        }
        return EstimateSample(self.now, values, {name: self._std(name) for name in QUANTITIES})

    def tick(self, now: int) -> None:
        """The clock [ns]; the first tick dates what was known before."""
        first = not self.now
        self.now = now
        if first and now:
            self._keep()

    def take_estimate(self, young_modulus: float | None, density: float | None) -> None:
        """A value of dlo/young_modulus or dlo/density; the other one stays."""
        self.young_modulus = self.young_modulus if young_modulus is None else young_modulus
        self.density = self.density if density is None else density
        self._keep()

    def take_diagnostics(self, facts: Mapping[str, str]) -> None:
        """Key values of the identifier's diagnostics."""
        self.facts.update(facts)
        self._keep()

    def identifiable(self, name: str) -> bool:
        """Whether the data determine a quantity."""
        said = self.facts.get(f"{name} identifiable", "")
        if said in ("yes", "no"):
            return said == "yes"
        sample = self.estimate()
        return sample is not None and sample.std[name] < IDENTIFIED * abs(sample.values[name])

    @property
    def waiting(self) -> int:
        """Number of observed splines that the estimator has not worked off."""
        said = self.facts.get(BACKLOG, "")
        return int(said) if said.isdecimal() else 0

    def in_time(self, stamp: int) -> bool:
        """Whether the simulator had the present estimate of E/mu at a stamp [ns], to its std.

        Where the data do not determine E/mu there is nothing that it should have.
        """
        sample = self.estimate()
        if sample is None or not self.identifiable(SPECIFIC_MODULUS):
            return True
        value, std = sample.values[SPECIFIC_MODULUS], sample.std[SPECIFIC_MODULUS]
        had = [ratio for at, ratio in self.simulated if at <= stamp]
        enough = max(CORRECTION, std / value if math.isfinite(std) else 0.0)
        return bool(had) and abs(math.log(had[-1] / value)) <= enough

    def predicted_at(self, stamp: int) -> FloatArray | None:
        """The predicted control points at a stamp [ns]; None where predictions are missing."""
        return interpolated(sorted(self.predicted.items(), key=itemgetter(0)), stamp)

    def errors(self, length: float) -> dict[int, float]:
        """ERR of eq. (10) [m] by the stamp [ns] of the observed spline, by growing stamp.

        As the identifier computes it; its dlo/err carries no stamp.

        Args:
            length: length of the DLO [m].
        """
        result = {}
        predictions = sorted(self.predicted.items(), key=itemgetter(0))
        for stamp in sorted(self.observed):
            predicted = interpolated(predictions, stamp)
            if predicted is not None:
                basis = SplineBasis(len(predicted), length)
                result[stamp] = shape_error(self.observed[stamp], predicted, basis)
        return result

    def _std(self, name: str) -> float:
        value = _number(self.facts.get(f"{name} std [{UNITS[name]}]"))
        return value if math.isfinite(value) else math.inf

    def _keep(self) -> None:
        """Record the estimate, the last state of each instant."""
        sample = self.estimate()
        if sample is None or not self.now:
            return
        if self.samples and self.samples[-1].stamp == sample.stamp:
            self.samples.pop()
        self.samples.append(sample)


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None else math.nan
    except ValueError:
        return math.nan
