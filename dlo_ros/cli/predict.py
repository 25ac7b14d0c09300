# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`predict --params FILE --output OUT.mcap BAG`: simulates a bag's commands.

With `--command FILE` instead of a bag it simulates a motion that nobody has made yet.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dlo_ros.cli.loading import (
    add_model_arguments,
    load_information,
    load_recordings,
    load_settings,
    prepare,
)
from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import estimate_covariance, stated_covariance
from dlo_ros.inference.forecast import borne_from, forecast, warn_of_instability
from dlo_ros.inference.lost_time import stated_stamps
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.command_file import read_command_file
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    command_message,
    float_message,
    load_messages,
    spline_message,
)
from dlo_ros.recordings.write import BagWriter, copy_topics
from dlo_ros.rod.loads.extreme_loads import Extremes
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.motion_rehearsal import NO_LOADS, at_rest, rehearse, stamps_of
from dlo_ros.spline import FloatArray

WRITTEN_TOPICS = (topics.PREDICTED, *topics.LOADS, topics.ERR)
"""Topics that the tool writes itself, and does not copy from its input."""
ONE_SHAPE = "loads: none, since one observed shape from which a simulation starts tells none"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "bag", type=Path, nargs="?", metavar="BAG", help="recording with commands and shapes"
    )
    add_model_arguments(parser)
    parser.add_argument(
        "--command", type=Path, metavar="FILE",
        help="instead of BAG: a motion to try, YAML or CSV; the DLO hangs at rest where it begins",
    )  # fmt: skip
    parser.add_argument(
        "--estimate", type=Path, metavar="FILE",
        help="estimate.json of identify, for the band of --command; default: as --params states",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, required=True, metavar="OUT.mcap", help="bag to write"
    )
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Predict; returns the exit status.

    Raises:
        DloError: an input or the output is unusable, or the motion cannot be simulated.
    """
    if (arguments.bag is None) == (arguments.command is None):
        raise InputError("give either a BAG or --command FILE")
    if arguments.command is None and arguments.estimate is not None:
        raise InputError("--estimate is for the band of --command; BAG has none")
    if arguments.command is not None and arguments.start is not None:
        raise InputError("--start is for BAG; with --command the DLO starts at rest")
    bags = [] if arguments.bag is None else [arguments.bag]
    settings = load_settings(arguments, bags)
    return _try(arguments, settings) if arguments.bag is None else _follow(arguments, settings)


def _follow(arguments: argparse.Namespace, settings: Settings) -> int:
    """Predict a recording."""
    bag, output = arguments.bag, arguments.output
    if output.exists() and bag.exists() and output.resolve() == bag.resolve():
        raise InputError(f"{output}: is the input; give the output another name")
    # The output is tried before the work is done.
    with BagWriter(output, force=arguments.force) as writer:
        (manipulation,) = load_recordings(arguments, [bag], settings)
        prepare()
        found = forecast(manipulation, settings, loads=True)
        warn_of_instability(found, manipulation.name)
        copy_topics(bag, writer, exclude=(*WRITTEN_TOPICS, *_images()))
        # A recording goes on with its own stamps, also where they lack time.
        stamps = stated_stamps(found.stamps, manipulation.gaps)
        first = borne_from(manipulation, settings)
        for k, stamp in enumerate(int(stamp) for stamp in stamps):
            borne = found.loadings[k : k + 1] if k >= first else ()
            _write(writer, settings, stamp, found.predicted[k], borne)
            writer.write(topics.ERR, float_message(BAG_MESSAGES, float(found.err[k])), stamp)
    own = 1e3 * found.resolution_error * settings.rod.length
    accuracy = "" if np.isnan(own) else f" (the simulation's own error is {own:.2g} mm)"
    print(
        f"{output}: {len(found.stamps)} predicted splines; mean distance from the observed "
        f"ones: ERR {1e3 * found.err.mean():.2f} mm averaged over time, "
        f"{1e3 * found.err.max():.2f} mm at most{accuracy}"
    )
    times = (found.stamps - found.stamps[0]) / NANOSECONDS
    lines = [ONE_SHAPE if found.loadings else NO_LOADS]
    if found.loadings[first:]:
        lines = Extremes(found.loadings[first:], times[first:]).sentences(settings.limits)
    for line in lines:
        print(line)
    return 0


def _try(arguments: argparse.Namespace, settings: Settings) -> int:
    """Predict a motion from a file."""
    command = read_command_file(arguments.command, settings)
    if arguments.estimate is None:
        covariance = stated_covariance(settings)
    else:
        covariance = estimate_covariance(settings, load_information(arguments.estimate))
    stamps = stamps_of(command, command.stamp, settings.simulation.rate)
    with BagWriter(arguments.output, force=arguments.force) as writer:
        prepare()
        try:
            began = time.process_time()
            simulation = at_rest(settings, command, covariance, stamps[-1])
            found = rehearse(simulation, stamps, covariance)
            took = time.process_time() - began
        except SimulationError as err:
            raise SimulationError(f"{arguments.command}: {err}") from err
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, command), stamps[0])
        for k, stamp in enumerate(stamps):
            _write(writer, settings, stamp, found.shapes[k], found.loadings[k : k + 1])
    seconds = (stamps[-1] - stamps[0]) / NANOSECONDS
    print(
        f"{arguments.output}: {len(stamps)} predicted splines of {seconds:.2f} s, "
        f"in {took:.2f} s of computing"
    )
    for line in found.sentences(settings.limits):
        print(line)
    return 0


def _write(
    writer: BagWriter, settings: Settings, stamp: int, shape: FloatArray,
    loadings: Sequence[Loading],
) -> None:  # fmt: skip
    """Write a predicted spline (n, 4) at a stamp [ns], and what the DLO and its grips bear.

    Args:
        loadings: at most one load of DLO and grips; none where the rod model does not compute
            loads.
    """
    message = spline_message(BAG_MESSAGES, stamp, settings.frame_id, shape)
    writer.write(topics.PREDICTED, message, stamp)
    for loading in loadings:
        messages = load_messages(
            BAG_MESSAGES, stamp, settings.frame_id, tension=loading.tension,
            bend_radius=loading.bend_radius, wrenches=loading.wrenches,
        )  # fmt: skip
        for topic, load in messages.items():
            writer.write(topic, load, stamp)


def _images() -> tuple[str, ...]:
    return (topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO)
