# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Delays between commands and observed ends, as where two clocks differ; and what is no delay."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dlo_ros.cli.clock_check import tell_delay, tell_delay_of_images
from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.inference.apparent_delay import apparent_delay
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BagWriter, topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.rod.boundary.shape_orientation import turned_round
from dlo_ros.spline import SplineBasis

BEGIN, SECOND, L, N = 1_750_000_000 * 10**9, 10**9, 0.4, 8
SETTINGS = Settings.from_mapping(
    {
        "rod.length": L, "rod.diameter": 0.004, "rod.young_modulus": 1e7, "rod.density": 2000.0,
        "rod.control_points": N,
    }
)  # fmt: skip
TIMES = np.linspace(0.0, 3.0, 61)


def path(seconds, speed=1.0):
    """Places of the held start (k, 3) [m], and its angles [rad]; at rest before 0 and after 3 s."""
    t = np.clip(seconds, 0.0, 3.0)
    places = np.stack([0.1 * np.sin(1.7 * speed * t), 0.0 * t, 0.03 * t], axis=-1)
    return places, 0.4 * np.sin(2.3 * speed * t)


def command(*, moves=True, turns=True, name="start"):
    places, angles = path(TIMES)
    turned = Rotation.from_euler("y", turns * angles[:, None]).as_quat()
    return Command(
        BEGIN, (name,), TIMES, moves * places[:, None], turned[:, None],
        np.full((len(TIMES), 1, 3), np.nan), N,
    )  # fmt: skip


def seen(delay, *, moves=True, turns=True, noise=5e-4, speed=1.0, frames=90, seed=1):
    """Shapes of a DLO that is straight beyond its clamp, which hangs 5 mm beside the command."""
    draw = np.random.default_rng(seed)
    result = []
    for k in range(frames):
        at = k / 30.0 + delay
        places, angle = path(np.array(at - delay), speed)
        along = Rotation.from_euler("y", turns * float(angle)).apply([1.0, 0.0, 0.0])
        shape = np.zeros((N, 4))
        shape[:, :3] = moves * places + SplineBasis(N, L).greville[:, None] * along + 0.005
        shape[:, :3] += draw.normal(scale=noise, size=(N, 3))
        result.append(Observation(BEGIN + round(at * SECOND), shape))
    return tuple(result)


def manipulation(delay, own=None, **kinds):
    kept = {k: kinds[k] for k in ("moves", "turns") if k in kinds}
    return Manipulation("bag", (own or command(**kept),), seen(delay, **kinds))


@pytest.mark.parametrize("delay", [0.3, -0.4, 1.5, 3.0, 3600.0, -3600.0])
def test_a_delay_is_found_within_the_commands_and_far_from_them(delay):
    for kinds in ({}, {"moves": False}, {"turns": False}):
        found = apparent_delay(manipulation(delay, **kinds), L)
        assert found.seconds == pytest.approx(delay, abs=0.02)
        assert found.explained > 0.95 > found.undelayed


@pytest.mark.parametrize(
    "given",
    [
        manipulation(0.0),
        manipulation(0.03),  # within what the set-up's delay is fitted for
        manipulation(3600.0, moves=False, turns=False),  # at rest
        manipulation(5.0, speed=1.6),  # another motion than the commanded one
        manipulation(0.5, frames=1),
        manipulation(0.5, noise=0.1),
        Manipulation("none", (), seen(0.5)),
        Manipulation("pin", (command(name="control_point_4"),), seen(0.5)),
        Manipulation("two", (command(), replace(command(name="end"), stamp=BEGIN + 1)), seen(5.0)),
    ],
)  # fmt: skip
def test_where_the_ends_say_nothing_of_a_delay_none_is_told(given):
    assert apparent_delay(given, L) is None


def test_a_delay_is_told_with_its_mend(caplog):
    assert tell_delay(manipulation(0.5), SETTINGS)
    assert "bag: the ends of the observed shapes move 0.50 s later than the commands" in caplog.text
    assert "correct the stamps by that, or state effects.command_delay.delay: 0.50" in caplog.text
    caplog.clear()
    assert tell_delay(manipulation(-60.0), SETTINGS)
    assert "move 60.00 s earlier" in caplog.text and caplog.text.endswith("stamps by that\n")
    caplog.clear()
    stated = SETTINGS.with_effects({"command_delay": {"delay": 0.5}})
    assert not tell_delay(manipulation(0.5), stated) and not caplog.text
    assert tell_delay(manipulation(0.0), stated) is False
    assert stated.command_delay == 0.5 and SETTINGS.command_delay == 0.0


def test_images_are_observed_anew_only_where_many_show_nothing(caplog):
    few = manipulation(0.5, frames=3)
    calls = []

    def uncommanded():
        calls.append(1)
        return [turned_round(o, L) for o in seen(0.5)]  # nobody knows which end is the start

    tell_delay_of_images(few, SETTINGS, 0, uncommanded)
    tell_delay_of_images(replace(few, commands=()), SETTINGS, 90, uncommanded)
    assert not calls and not caplog.text
    tell_delay_of_images(few, SETTINGS, 90, uncommanded)
    assert calls and "0.50 s later" in caplog.text
    caplog.clear()
    tell_delay_of_images(few, SETTINGS, 90, list)
    assert not caplog.text


@pytest.mark.slow
def test_a_camera_with_a_clock_of_its_own_is_told_by_how_much(tmp_path, caplog, capsys):
    """Images of the independent rod, and of a camera half a second late: told, stated, observed."""
    true, late = tmp_path / "true", tmp_path / "late"
    assert main(["synthesize", "c_shape", "--output", str(true), "--seed", "31"]) == 0
    with open_bag(true) as bag, BagWriter(late) as writer:
        for raw in bag.messages():
            message, own = deserialise(raw), 0 if topics.COMMAND in raw.topic else SECOND // 2
            at = message.header.stamp.sec * SECOND + message.header.stamp.nanosec + own
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, SECOND)
            writer.write(raw.topic, message, raw.stamp + own)
    call = ["observe", "--force", "--output", str(tmp_path / "seen"), str(late)]
    assert main([*call, "--params", str(true / "params.yaml")]) == 0
    assert "0.50 s later than the commands say" in caplog.text
    capsys.readouterr()
    settings = Settings.load(true / "params.yaml")
    settings.with_effects({"command_delay": {"delay": 0.5}}).dump(tmp_path / "params.yaml")
    caplog.clear()
    assert main([*call, "--params", str(tmp_path / "params.yaml")]) == 0
    assert "91 of 91 images show the DLO" in capsys.readouterr().out and not caplog.text
