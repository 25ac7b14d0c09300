# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`predict --params FILE --output OUT.mcap BAG`: simulates a bag's commands."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dlo_ros.cli.loading import add_model_arguments, load_manipulation, load_settings, prepare
from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError
from dlo_ros.inference.forecast import forecast
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.building import (
    BAG_MESSAGES,
    float_message,
    load_messages,
    spline_message,
)
from dlo_ros.recordings.write import BagWriter, copy_topics
from dlo_ros.rod.extremes import Extremes
from dlo_ros.rod.reactions import Loading
from dlo_ros.spline import FloatArray

MADE = (topics.PREDICTED, *topics.LOADS, topics.ERR)
"""What the tool writes itself, and does not copy from its input."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="recording with commands")
    add_model_arguments(parser)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="OUT.mcap", help="bag to write"
    )
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Predict; returns the exit status.

    Raises:
        DloError: an input or the output is unusable, or the motion cannot be simulated.
    """
    settings = load_settings(arguments)
    bag, output = arguments.bag, arguments.output
    if output.exists() and bag.exists() and output.resolve() == bag.resolve():
        raise InputError(f"{output}: is the input; give the output another name")
    # The output is tried before the work is done.
    with BagWriter(output, force=arguments.force) as writer:
        manipulation = load_manipulation(bag, settings)
        prepare()
        found = forecast(manipulation, settings, loads=True)
        copy_topics(bag, writer, exclude=(*MADE, *_images()))
        for k, stamp in enumerate(int(stamp) for stamp in found.stamps):
            write_prediction(writer, settings, stamp, found.predicted[k], found.loadings[k])
            writer.write(topics.ERR, float_message(BAG_MESSAGES, float(found.err[k])), stamp)
    own = 1e3 * found.resolution_error * settings.rod.length
    accuracy = "" if np.isnan(own) else f" (the simulation's own error is {own:.2g} mm)"
    print(
        f"{output}: {len(found.stamps)} predicted splines; mean distance from the observed "
        f"ones: ERR {1e3 * found.err.mean():.2f} mm in the mean over time, "
        f"{1e3 * found.err.max():.2f} mm at most{accuracy}"
    )
    times = (found.stamps - found.stamps[0]) / NANOSECONDS
    for line in Extremes(found.loadings, times).sentences(settings.limits):
        print(line)
    return 0


def write_prediction(
    writer: BagWriter, settings: Settings, stamp: int, shape: FloatArray, loading: Loading
) -> None:
    """Write a predicted spline (n, 4) at a stamp [ns], and what the DLO and its grips bear."""
    message = spline_message(BAG_MESSAGES, stamp, settings.frame_id, shape)
    writer.write(topics.PREDICTED, message, stamp)
    messages = load_messages(
        BAG_MESSAGES, stamp, settings.frame_id, tension=loading.tension,
        bend_radius=loading.bend_radius, wrenches=loading.wrenches,
    )  # fmt: skip
    for topic, load in messages.items():
        writer.write(topic, load, stamp)


def _images() -> tuple[str, ...]:
    return (topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO)
