# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings for the tools and their commands, as a user types them."""

from dlo_ros.cli.main import main
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message, spline_message


def write_bag(path, manipulation):
    with BagWriter(path) as writer:
        for imposed in manipulation.commands:
            message = command_message(BAG_MESSAGES, imposed)
            writer.write("dlo/command", message, imposed.stamp)
        for observation in manipulation.observations:
            message = spline_message(
                BAG_MESSAGES, observation.stamp, "board", observation.control_points
            )
            writer.write("dlo/observed", message, observation.stamp)


def run(*words):
    return main([str(w) for w in words])
