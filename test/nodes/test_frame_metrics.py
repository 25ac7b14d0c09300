# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How images arrive: rate, latency, and what got lost on the way."""

import math

import numpy as np

from dlo_ros.nodes.image_statistics import ImageStatistics

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def arrive(frames, numbers, rate=30.0, start=START):
    for k in numbers:
        frames.arrived(start + round(k * SECOND / rate))


def test_rate_and_lost_images():
    frames = ImageStatistics()
    assert math.isnan(frames.rate)
    arrive(frames, range(40))
    assert abs(frames.rate - 30.0) < 0.1 and frames.dropped == 0
    arrive(frames, [40, 43, 44, 46])  # 41, 42 and 45 are missing
    assert frames.dropped == 3


def test_jitter_pauses_and_restarts_lose_nothing():
    frames = ImageStatistics()
    jitter = np.random.default_rng(0).uniform(-0.15, 0.15, 60)
    arrive(frames, np.arange(60) + jitter)
    assert frames.dropped == 0
    arrive(frames, range(30), start=START + 60 * SECOND)  # the camera was off for a minute
    arrive(frames, range(30))  # a recording begins anew
    frames.reset()
    arrive(frames, range(30), start=START + 30 * SECOND)
    assert frames.dropped == 0


def test_latency_is_that_of_the_usual_image():
    frames = ImageStatistics()
    for value in (0.02, 0.02, 0.5):
        frames.worked_off(value)
    assert frames.latency == 0.02
