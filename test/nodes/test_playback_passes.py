# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages of the pass before a looped recording's present one are told by their stamps."""

from __future__ import annotations

import pytest

from dlo_ros.nodes import playback_passes
from dlo_ros.nodes.pairing import Pairing
from dlo_ros.nodes.playback_passes import AHEAD, UNDER_WAY, PlaybackPasses

S = 1_000_000_000
START = 1000 * S


@pytest.fixture
def clock(monkeypatch):
    """Wall time [s], which the test sets."""
    now = [50.0]
    monkeypatch.setattr(playback_passes.time, "monotonic", lambda: now[0])
    return now


def looped(lead: int = 0) -> PlaybackPasses:
    """After a pass of three seconds, its stamps ahead of the clock by some nanoseconds."""
    one = PlaybackPasses()
    for k in range(30):
        now = START + k * S // 10
        assert not one.is_earlier(now + lead, now)
    one.went_back(START + 3 * S)
    return one


def test_nothing_is_earlier_before_time_goes_back():
    one = PlaybackPasses()
    assert not one.is_earlier(START + 9 * S, START)
    assert not one.is_earlier(START, 0)  # simulated time has not begun


def test_what_was_sent_before_the_jump_lies_ahead_of_the_clock(clock):
    one = looped()
    assert one.is_earlier(START + 29 * S // 10, START)
    assert not one.is_earlier(START, START)
    # A shape of now, where the clock itself comes a little late.
    assert not one.is_earlier(START + round((AHEAD - 0.01) * S), START)
    assert one.is_earlier(START + 2 * S, START + S)
    # The clock is where it was: what lies further ahead was not sent before.
    assert not one.is_earlier(START + 9 * S, START + 3 * S)


def test_stamps_that_always_lie_ahead_are_not_dropped(clock):
    one = looped(lead=2 * S)
    assert not one.is_earlier(START + 2 * S, START)
    assert one.is_earlier(START + 29 * S // 10 + 2 * S, START)


def test_no_message_is_under_way_for_ever(clock):
    one = looped()
    clock[0] += UNDER_WAY
    assert not one.is_earlier(START + 2 * S, START)


def test_predictions_of_the_pass_before_are_forgotten_without_the_new_ones():
    pairing = Pairing()
    pairing.predicted(START + 3 * S, "late")
    pairing.predicted(START, "first")
    pairing.observed(START + 3 * S, "late")
    pairing.forget_after(START + S // 2)
    pairing.observed(START, "seen")
    assert pairing.pairs() == [(START, "seen", "first")]
    pairing.observed(START + S // 10, "seen")
    assert pairing.pairs() == [] and pairing.missed == 0  # its prediction is still to come
