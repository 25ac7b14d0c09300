# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces measured at a grip, live: in the fixed frame, in that of a sensor, in an unknown one."""

from types import SimpleNamespace

import numpy as np
import pytest
import recordings_samples as samples

from dlo_ros.errors import InputError
from dlo_ros.recordings import BAG_MESSAGES
from dlo_ros.recordings.message_building import transform_message, wrench_message

pytest.importorskip("rclpy")

from dlo_ros.nodes import measured_forces
from dlo_ros.recordings.transforms import Transforms

MS = 1_000_000
QUARTER = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # x of the sensor along the board's y
COMMANDS = [samples.command()]


@pytest.fixture
def forces(monkeypatch):
    """The listener of a node that only counts and notes its warnings, and its transforms."""
    listener = SimpleNamespace(transforms=Transforms(), available=True)
    monkeypatch.setattr(measured_forces, "TransformListener", lambda node: listener)
    monkeypatch.setattr(measured_forces, "PATIENCE", 0.0)
    counted, told = [], {}

    def check_stamp(stamp, what):
        if not stamp:
            raise InputError(f"{what} has no stamp")

    node = SimpleNamespace(
        settings=samples.SETTINGS, is_earlier=lambda stamp: False, check_stamp=check_stamp,
        subscribe=lambda *args: None,
        health=SimpleNamespace(
            count=counted.append, warn=told.__setitem__, solved=lambda kind: told.pop(kind, None)
        ),
    )  # fmt: skip
    made = measured_forces.MeasuredForces(node)
    return SimpleNamespace(made=made, listener=listener, counted=counted, told=told)


def hear(forces, frame, stamp=samples.START, force=(1.0, 2.0, 3.0)):
    message = wrench_message(BAG_MESSAGES, stamp, frame, np.array(force), np.array([0.1, 0.2, 0.3]))
    message.wrench.force.x = force[0]
    forces.made.hear("end", message)


def place(forces, stamp, child, parent, translation, rotation, *, fixed):
    message = transform_message(BAG_MESSAGES, stamp, parent, child, translation, rotation)
    forces.listener.transforms.add(message, fixed=fixed)


def test_forces_in_the_fixed_frame_are_taken_as_they_are_and_old_ones_forgotten(forces):
    with pytest.raises(InputError, match="not finite"):
        hear(forces, "board", force=(float("nan"), 0.0, 0.0))
    with pytest.raises(InputError, match="forces are in N"):
        hear(forces, "board", force=(1e300, 0.0, 0.0))
    with pytest.raises(InputError, match="dlo/wrench_end has no stamp"):
        hear(forces, "board", stamp=0)
    assert forces.counted == []
    for k in range(2100):  # nobody sees the DLO
        hear(forces, "/board", samples.START + k)
    (found,) = forces.made.take([])
    assert len(found.stamps) == 2000 and len(forces.counted) == 2100
    np.testing.assert_array_equal(found.force[0], [1.0, 2.0, 3.0])
    assert forces.made.take([]) == [] and not forces.told
    hear(forces, "board")
    forces.made.forget()
    assert forces.made.take([]) == []


def test_forces_in_a_sensors_frame_are_turned_once_its_pose_is_known(forces):
    place(forces, 0, "sensor", "flange", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0), fixed=True)
    place(forces, samples.START, "flange", "board", (0.3, 0.0, 0.0), QUARTER, fixed=False)
    for k in (0, 20):
        hear(forces, "sensor", samples.START + k * MS)
    (first,) = forces.made.take(COMMANDS)
    assert list(first.stamps) == [samples.START]  # the other waits for the flange's pose
    place(forces, samples.START + 20 * MS, "flange", "board", (0.5, 0.0, 0.0), QUARTER, fixed=False)
    (second,) = forces.made.take(COMMANDS)
    assert not forces.told
    for found, x in ((first, 0.3), (second, 0.5)):
        np.testing.assert_allclose(found.force, [[-2.0, 1.0, 3.0]], atol=1e-12)
        held = COMMANDS[0].sample(int(found.stamps[0]))[0][1]
        lever = np.array([x, 0.0, 0.1]) - held
        expected = np.array([-0.2, 0.1, 0.3]) + np.cross(lever, [-2.0, 1.0, 3.0])
        np.testing.assert_allclose(found.torque[0], expected, atol=1e-9)
        np.testing.assert_allclose(found.axes[0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_a_frame_that_nobody_knows_is_told_with_the_mend(forces):
    hear(forces, "gripper")
    assert forces.made.take(COMMANDS) == []
    (said,) = forces.told.values()
    assert "dlo/wrench_end is in frame 'gripper' and not used: no transform leads from" in said
    assert "--frame-id board --child-frame-id gripper" in said
    forces.listener.available = False
    hear(forces, "gripper")
    forces.made.take(COMMANDS)
    assert "install ros-jazzy-tf2-msgs" in forces.told["dlo/wrench_end"]
    hear(forces, "board")
    assert len(forces.made.take(COMMANDS)) == 1 and not forces.told


def test_a_frame_that_is_told_no_more_or_has_yet_to_come(forces, monkeypatch):
    place(forces, samples.START, "sensor", "board", (0.3, 0.0, 0.0), QUARTER, fixed=False)
    hear(forces, "sensor", samples.START + 2000 * MS)
    assert forces.made.take(COMMANDS) == []
    assert "ends 2.00 s before the instant for which it is needed" in str(forces.told)
    monkeypatch.setattr(measured_forces, "PATIENCE", 60.0)
    forces.told.clear()
    hear(forces, "gripper", samples.START)
    assert forces.made.take(COMMANDS) == [] and not forces.told  # /tf_static may be on its way
    place(forces, 0, "gripper", "board", (0.3, 0.0, 0.0), QUARTER, fixed=True)
    assert len(forces.made.take(COMMANDS)) == 1


def test_an_end_that_nothing_holds_bears_nothing_that_could_be_moved_there(forces):
    place(forces, 0, "sensor", "board", (0.3, 0.0, 0.0), QUARTER, fixed=True)
    hear(forces, "sensor")
    assert forces.made.take([]) == []
    assert "no command holds the end of the DLO" in forces.told["dlo/wrench_end"]
