# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sources of knowledge of each parameter (data, prior, guess), in numbers and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.identification.estimate import (
    COMBINATIONS,
    Estimate,
    bounded,
    correlations,
    inverse,
    known_information,
    std_along,
)
from dlo_ros.inference.thresholds import CLEARLY_LESS, IDENTIFIED
from dlo_ros.spline import FloatArray

WORDS = {
    "specific_modulus": "E/mu",
    "young_modulus": "E",
    "density": "mu",
    "specific_drag": "c/mu",
    "air_drag": "air drag c",
    "relaxation_time": "relaxation time t_r",
}
"""Names of `COMBINATIONS` for people."""


@dataclass(frozen=True)
class Knowledge:
    """The source and the uncertainty of one quantity.

    Args:
        name, words: names of the quantity for programs and for people.
        source: `data`: the recordings determine it, with the known forces; `prior`: it is known
            beforehand, and the recordings add little; `guess`: nobody knows it.
        data_std: relative standard deviation from the recordings alone, without anything known
            beforehand; None where they leave it open.
        std: standard deviation with all information; None where it is open.
    """

    name: str
    words: str
    source: str
    data_std: float | None
    std: float | None


def knowledge(estimate: Estimate, information: FloatArray) -> list[Knowledge]:
    """Source and uncertainty of E/mu, E, mu, c/mu, c and t_r.

    Args:
        estimate: estimate of the parameters.
        information: information of the data on the logarithms of `MATERIAL`, shape (4, 4).
    """
    settings = estimate.settings
    forces = known_information(settings, weighed=False)
    everything = known_information(settings, weighed=True)
    result = []
    for name, c in COMBINATIONS.items():
        alone, helped, full, before = (
            std_along(inverse(known), c)
            for known in (information, information + forces, information + everything, forces)
        )
        if name == "relaxation_time" and not settings.damping.relaxation_time > 0.0:
            continue
        source = "guess"
        if helped < IDENTIFIED and helped < CLEARLY_LESS * before:
            source = "data"
        elif full < IDENTIFIED:
            source = "prior"
        result.append(Knowledge(name, WORDS[name], source, bounded(alone), bounded(full)))
    return result


def sentences(estimate: Estimate, information: FloatArray) -> list[str]:
    """Sentences on what the recordings determine, and what would settle the rest."""
    known = knowledge(estimate, information)
    determined = [
        f"{k.words} to {rounded(100.0 * k.std)} %" for k in known if k.source == "data" and k.std
    ]
    before = [k.words for k in known if k.source == "prior"]
    open_ = [k.words for k in known if k.source == "guess"]
    result = [f"The recordings determine {enumerated(determined)}." if determined else
              "The recordings determine none of the parameters."]  # fmt: skip
    if before:
        result.append(
            f"{enumerated(before)}: known from what was given beforehand, not from the data."
        )
    if open_:
        result.append(f"{enumerated(open_)}: not known; the numbers are guesses that fit as well.")
    found = estimate.identifiable
    if found["specific_modulus"] and not found["density"]:
        result.append(
            "The shapes determine E/mu only: E and mu change together without changing any shape. "
            "To know them apart, weigh the DLO and give density_std, measure the forces at a grip "
            "(dlo/wrench_start, dlo/wrench_end), hang a known mass on it and state it as "
            "effects.point_mass, or give the air drag with its standard deviation."
        )
    if not found["specific_modulus"]:
        result.append(
            "These recordings do not determine E/mu to 25 %. A shape in which stiffness competes "
            "with weight is more informative, such as a free end of about twice (B/w)^(1/3); "
            "`design` finds one for this DLO."
        )
    found_ = correlations(estimate.covariance)
    return result + [
        f"{WORDS[a]} and {WORDS[b]} are traded against each other (correlation "
        f"{found_[a, b]:+.3f}): the data fix a combination of them far better than each."
        for a, b in estimate.traded
    ]


def rounded(number: float) -> str:
    """Two digits, as people write them: without an exponent."""
    return str(np.format_float_positional(float(f"{number:.2g}"), trim="-"))


def enumerated(words: Sequence[str]) -> str:
    """Words as a sentence names them: a, b and c."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
