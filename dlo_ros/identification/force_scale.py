# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The common scale of all forces of a model that shapes have determined but for that scale.

E, mu, the drag and every force of an effect may be multiplied by one number without any shape being
another. Forces measured at the grips determine it without a further simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import Command
from dlo_ros.effects import quantities
from dlo_ros.effects.start import Block
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.estimate import bounded
from dlo_ros.identification.identifiability import rounded
from dlo_ros.inference.forecast import Manipulation, borne_from
from dlo_ros.inference.wrench import (
    WrenchField,
    WrenchInformation,
    from_change,
    from_mean,
    wrench_field,
    wrench_information,
)
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.spline import FloatArray

POWERS = {
    "kg": 1.0, "N/m": 1.0, "N m": 1.0, "N s/m^2": 1.0, "N s^2/m^3": 1.0, "rad/(N m)": -1.0,
}  # fmt: skip
"""Power of the scale with which a number of an effect goes, by its unit; others stay."""
ITERATIONS = 20
CLOSE = 1e-4
"""Change of the scale's logarithm at which the iteration ends."""
LONGEST_STEP = 2.0
LEAST = 1e-6
"""Information beforehand on the logarithm of the scale: next to none."""


@dataclass(frozen=True)
class GripForces:
    """Forces that were measured and predicted at one end.

    Args:
        name: recording and end, for people.
        measured: forces that the sensor measured.
        stamps: stamps of the shapes [ns], F of them.
        predicted: force and torque of the grip at these, shape (F, 6).
        commands: commands that led the grips.
        slope: derivative of the predicted by the logarithm of the scale of E, mu and drag, shape
            (F, 6); None: the predicted itself, as where nothing else bears on the DLO.
        columns: what else may be wrong with the predicted, in standard deviations, shape (F, 6)
            each.
    """

    name: str
    measured: Wrenches
    stamps: tuple[int, ...]
    predicted: FloatArray
    commands: tuple[Command, ...]
    slope: FloatArray | None = None
    columns: tuple[FloatArray, ...] = ()


@dataclass(frozen=True)
class Scale:
    """The common scale of all forces over the model's.

    Args:
        log: logarithm of the scale.
        information: information on that logarithm.
        std: standard deviation of the logarithm with all information; from how forces change alone;
            from their mean alone.
        left: root mean square residual of forces [N] and torques [N m], for each recording and end.
    """

    log: float
    information: float
    std: tuple[float, float, float]
    left: Mapping[str, tuple[float, float]]

    @property
    def relative(self) -> tuple[float | None, float | None, float | None]:
        """The three standard deviations; None where that leaves it unknown."""
        everything, change, mean = (bounded(s) for s in self.std)
        return everything, change, mean


def grip_wrenches(loadings: Sequence[Loading], end: str) -> FloatArray | None:
    """Force and torque of the grip at an end, shape (F, 6); None where it holds nothing."""
    grips = [getattr(loading, end) for loading in loadings]
    if not grips or any(g is None for g in grips):
        return None
    return np.array([np.concatenate([g.force, g.torque]) for g in grips])


def borne_along(
    recording: Manipulation, loadings: Sequence[Loading], stamps: Iterable[int],
    settings: Settings,
) -> list[GripForces]:  # fmt: skip
    """Measured forces at the ends of a recording, beside the predicted ones.

    Args:
        loadings: predicted loads at all compared instants.
        stamps: their stamps [ns].
        settings: settings of the simulation, whose start may shake the first of them.
    """
    first = borne_from(recording, settings)
    at = tuple(int(stamp) for stamp in stamps)[first:]
    result = []
    for measured in recording.wrenches:
        predicted = grip_wrenches(loadings[first:], measured.end)
        if predicted is not None:
            label = f"{recording.name}, {measured.end}"
            result.append(GripForces(label, measured, at, predicted, recording.commands))
    return result


def scale_of(
    borne: Sequence[GripForces],
    settings: Settings,
    *,
    known: float = 0.0,
    diameter_std: float = 0.0,
) -> Pieces[Scale | None]:
    """The scale of all forces, piece by piece; None where no force was measured near a shape.

    Args:
        settings: settings of the parameter file, by whose weight force offsets are judged.
        known: information beforehand on the logarithm of the scale, that it is 0.
        diameter_std: standard deviation of the DLO's diameter over the diameter.
    """
    log = 0.0
    fields: list[WrenchField] = []
    found: list[WrenchInformation] = []
    prior = np.array([[known + LEAST]])
    for _ in range(ITERATIONS):
        yield LONG
        fields = _fields(borne, settings, float(np.exp(log)), diameter_std)
        if not fields:
            return None
        found = []
        for one in fields:
            yield LONG
            found.append(wrench_information(one, np.array([-log]), prior))
        information = sum(float(f.information[0, 0]) for f in found)
        gradient = sum(float(f.gradient[0]) for f in found) - float(prior[0, 0]) * log
        step = gradient / (information + float(prior[0, 0]))
        log += float(np.clip(step, -LONGEST_STEP, LONGEST_STEP))
        if abs(step) < CLOSE:
            break
    parts = [information, 0.0, 0.0]
    left = {}
    for one, all_of_it in zip(fields, found, strict=True):
        yield LONG
        parts[1] += float(from_change(one, all_of_it.variance)[0, 0])
        parts[2] += float(from_mean(one, all_of_it.variance)[0, 0])
        sizes = [all_of_it.left[one.torque == kind] for kind in (False, True)]
        force, torque = (float(np.sqrt(np.mean(s**2))) if len(s) else 0.0 for s in sizes)
        left[one.name] = force, torque
    everything, change, mean = ((known + LEAST + max(i, 0.0)) ** -0.5 for i in parts)
    return Scale(log, information, (everything, change, mean), left)


def _fields(
    borne: Sequence[GripForces], settings: Settings, scale: float, diameter_std: float
) -> list[WrenchField]:
    """Measured and predicted forces with the derivative by the scale's logarithm."""
    result = []
    for b in borne:
        slope = b.predicted if b.slope is None else b.slope
        predicted, slope = b.predicted + (scale - 1.0) * slope, scale * slope
        found = wrench_field(
            b.name, b.measured, b.stamps, predicted, slope[:, :, None], settings, b.commands,
            [2.0 * diameter_std * slope, *(scale * c for c in b.columns)],
        )  # fmt: skip
        if found is not None:
            result.append(found)
    return result


def with_scale(settings: Settings, log: float) -> Settings:
    """The settings with all forces multiplied by exp(log): every shape stays as it is."""
    factor = float(np.exp(log))
    rod, damping = settings.rod, settings.damping
    effects = {name: scaled_block(name, block, log) for name, block in settings.effects.items()}
    return replace(
        settings.with_effects(effects),
        rod=replace(rod, young_modulus=factor * rod.young_modulus, density=factor * rod.density),
        damping=replace(damping, air_drag=factor * damping.air_drag),
    )


def scaled_block(effect: str, block: Block, log: float) -> dict[str, float | tuple[float, ...]]:
    """The parameters of an effect with all forces multiplied by exp(log)."""
    result: dict[str, float | tuple[float, ...]] = {}
    for key, value in block.items():
        by = float(np.exp(log * POWERS.get(quantities(effect)[key].unit, 0.0)))
        result[key] = tuple(by * v for v in value) if isinstance(value, tuple) else by * value
    return result


def words(std: tuple[float | None, float | None, float | None], messages: int) -> str:
    """A sentence on how well measured forces determine mu, and by what.

    Args:
        std: relative, with everything, from change alone, from the mean alone; None: unknown.
        messages: number of measured messages.
    """
    everything, change, mean = ("nothing" if s is None else f"{rounded(100.0 * s)} %" for s in std)
    return (
        f"The forces at the grips ({messages} messages) determine mu to {everything}: their "
        f"changes, whatever the sensor's offset, to {change}; their mean, as far as "
        f"wrench.force_bias_std goes, to {mean}."
    )
