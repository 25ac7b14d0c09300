# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Well-formed messages, of which tests make malformed ones."""

from __future__ import annotations

import copy

import recordings_samples as samples

from dlo_ros.recordings import (
    BAG_MESSAGES,
    camera_info_message,
    command_message,
    image_message,
    points_message,
    spline_message,
)

TEMPLATES = {
    "command": command_message(BAG_MESSAGES, samples.command()),
    "spline": spline_message(BAG_MESSAGES, samples.START, "board", samples.control_points()),
    "points": points_message(BAG_MESSAGES, samples.START, "board", samples.centreline()),
    "image": image_message(BAG_MESSAGES, samples.START, "c", samples.picture()),
    "info": camera_info_message(BAG_MESSAGES, samples.START, samples.INFO),
}


def fresh(name: str):
    return copy.deepcopy(TEMPLATES[name])
