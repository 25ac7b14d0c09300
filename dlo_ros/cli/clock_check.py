# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Warnings where what is seen moves much later, or earlier, than commanded: clocks that differ."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace

from dlo_ros.effects.measurement.command_delay import CommandDelay
from dlo_ros.inference.apparent_delay import ApparentDelay, apparent_delay
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.thresholds import LEAST_DELAY
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.boundary.shape_orientation import turned_round

LOG = logging.getLogger(__name__)

MANY = 0.25
"""Share of images in which no DLO is found, from which the commands are doubted: the observer
looks for it between the commanded clamps."""


def tell_delay(manipulation: Manipulation, settings: Settings) -> bool:
    """Warn where the observed ends follow the commands late or early; returns whether they do.

    Args:
        manipulation: commands and observed shapes.
        settings: parameter file; a delay that it states is none to be told of.
    """
    found = apparent_delay(manipulation, settings.rod.length)
    if found is None or abs(found.seconds - settings.command_delay) < LEAST_DELAY:
        return False
    LOG.warning("%s: %s", manipulation.name, _words(found))
    return True


def _words(found: ApparentDelay) -> str:
    mend = "correct the stamps by that"
    (delay,) = CommandDelay.quantities()
    if abs(found.seconds) < delay.upper:
        mend += f", or state {CommandDelay.parameter(delay.name)}: {found.seconds:.2f}"
    return (
        f"the ends of the observed shapes move {abs(found.seconds):.2f} s "
        f"{'later' if found.seconds > 0.0 else 'earlier'} than the commands say (which explain "
        f"{100.0 * found.explained:.0f} % of their motion with that delay, and "
        f"{100.0 * max(found.undelayed, 0.0):.0f} % without it): the clocks of camera and robot "
        f"differ, or stamps are not those of the instants; {mend}"
    )


def many_missed(missed: int, found: int) -> bool:
    """Whether so many images show no DLO between the commanded clamps that these are doubted.

    Args:
        missed, found: numbers of images in which none, and one, was found.
    """
    return missed > 0 and missed >= MANY * (missed + found)


def tell_delay_of_images(
    manipulation: Manipulation,
    settings: Settings,
    missed: int,
    uncommanded: Callable[[], Iterable[Observation]],
) -> None:
    """Where many images show no DLO, see `many_missed`, look for it without the commands.

    Args:
        manipulation: commands, and the shapes that were found with them.
        settings: parameter file.
        missed: number of images in which none was found.
        uncommanded: function that observes the images anew, without the commands.
    """
    if not (many_missed(missed, len(manipulation.observations)) and manipulation.commands):
        return
    shapes = tuple(uncommanded())
    turned = tuple(turned_round(o, settings.rod.length) for o in shapes)
    for seen in (shapes, turned):  # without a command nobody knows which end is the start
        if seen and tell_delay(replace(manipulation, observations=seen), settings):
            return
