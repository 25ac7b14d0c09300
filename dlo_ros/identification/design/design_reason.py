# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The reason why a manipulation is informative, in a sentence."""

from __future__ import annotations

import numpy as np

from dlo_ros.identification.design.expected_information import Outlook, displacement
from dlo_ros.identification.identifiability import rounded
from dlo_ros.inference.thresholds import IDENTIFIED, MUCH_LARGER
from dlo_ros.parameters import Settings


def length_over_scale(settings: Settings) -> float:
    """L/l with l = (B/w)^(1/3): length of the DLO over that at which it bends by its weight."""
    rod = settings.rod
    weight = rod.linear_density * float(np.linalg.norm(settings.gravity))
    return float(rod.length * (weight / rod.bending_stiffness) ** (1 / 3)) if weight else 0.0


def reason(found: Outlook, weakest: Outlook, settings: Settings) -> str:
    """Sentence on what a manipulation shows of E/mu, where and when, beside the weakest one.

    Args:
        found: the manipulation.
        weakest: the manipulation that it is compared with.
        settings: parameters of the rod.
    """
    length = settings.rod.length
    shift = displacement(found.forecast, settings)  # (F, U)
    times = (found.forecast.stamps - found.forecast.stamps[0]) * 1e-9
    at = float(np.argmax(shift.mean(axis=0))) / (shift.shape[1] - 1) * length
    course = shift.mean(axis=1)
    when = float(times[int(np.argmax(course))])
    mean = rounded(1e3 * 0.01 * found.response * length)
    words = [f"1 % more E/mu moves the DLO by {mean} mm on average"]
    if weakest is not found and weakest.response > 0.0:
        words.append(
            f"{rounded(found.response / weakest.response)} times as far as in the experiment "
            f"'{weakest.plan.name}'"
        )
    moving = float(course.max()) > MUCH_LARGER * float(np.median(course))
    words.append(f"most at u = {at:.2f} m" + (f" around {when:.1f} s" if moving else ""))
    sentence = ", ".join(words)
    result = f"so it determines E/mu to {rounded(100.0 * found.std['specific_modulus'])} %"
    density = found.std["density"]
    if found.information[1, 1] > 0.0 and density < IDENTIFIED and settings.damping.air_drag_std:
        result += f" and, by the known drag, mu to {rounded(100.0 * density)} %"
    return f"{sentence}; {result}."
