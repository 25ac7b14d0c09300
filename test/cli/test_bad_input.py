# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Unusable input, where a user meets it: errors that name quantity, value and what is right."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rods import PAPER, SECOND, command, held_start

from dlo_ros.command import Motion
from dlo_ros.errors import CommandError, DloError, InputError, ParameterError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

GOOD = {
    "rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 5e7, "rod.density": 2500.0,
}  # fmt: skip


def straight_shape():
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, 0.4).greville
    return shape


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("rod.control_points", 3, r"rod\.control_points is 3; allowed is 4 to 200"),
        ("rod.length", 0.0, r"rod\.length is 0 m; allowed is 0\.01 to 100"),
        ("rod.young_modulus", -5e7, r"rod\.young_modulus is -5e\+07 Pa; allowed is 1000 to"),
        ("rod.density", float("nan"), r"rod\.density is nan kg/m\^3; allowed is 1 to"),
        ("rod.diameter", "thin", r"rod\.diameter is 'thin'; it must be a number \[m\]"),
        ("gravity", [0.0, float("inf"), 0.0], r"gravity is inf m/s\^2; allowed is"),
        ("damping.air_drag", -1.0, r"damping\.air_drag is -1 N s/m\^2; allowed is 0 to"),
        ("effects.stiff_segment.ratio", -2.0, r"stiff_segment\.ratio is -2\.0; .* from 0\.01 to"),
        ("effects.point_mass.mass", float("nan"), r"point_mass\.mass is nan; it must be a number"),
        ("effects.stiff_segment.width", 0.1, "has no parameter 'width'; it has centre, extent"),
        ("effects.ghost.size", 0.1, "there is no effect 'ghost'; known are air_drag,"),
    ],
)
def test_parameter_files_are_checked(key, value, message, tmp_path):
    file = tmp_path / "params.yaml"
    lines = [f"    {name}: {_yaml(number)}" for name, number in {**GOOD, key: value}.items()]
    file.write_text("\n".join(["/**:", "  ros__parameters:", *lines]) + "\n")
    with pytest.raises(ParameterError, match=message):
        Settings.load(file)


@pytest.mark.parametrize("block", ["effect", "efects"])
def test_a_mistyped_block_of_effects_is_told(block, tmp_path, caplog):
    """Else the plain model would run in place of the extended one, without a word."""
    file, values = tmp_path / "params.yaml", {**GOOD, f"{block}.clamp_angle.start": 0.1}
    lines = [f"    {name}: {number}" for name, number in values.items()]
    file.write_text("\n".join(["/**:", "  ros__parameters:", *lines]) + "\n")
    assert Settings.load(file).effects == {}
    said = f"parameter {block}.clamp_angle.start is ignored; is effects.clamp_angle.start meant?"
    assert said in caplog.text


def _yaml(value):
    names = {"nan": ".nan", "inf": ".inf"}
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(v) for v in value) + "]"
    return names.get(str(value), str(value))


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"air_drag": {"coefficient": -1.0}}, r"air_drag\.coefficient is -0\.99 N s/m\^2 in all"),
        ({"internal_damping": {"relaxation_time": -0.1}}, r"relaxation_time is -0\.098 s in all"),
        ({"length_error": {"difference": -0.5}}, r"leave -0\.1 m of a DLO of 0\.4 m; at least"),
        ({"clamp_slip": {"length": -0.39}}, r"leave 0\.01 m of a DLO of 0\.4 m; at least 0\.04 m"),
        ({"point_mass": {"mass": 0.1, "position": 0.5}}, r"is 0\.5 m; it must lie on the DLO, 0"),
        ({"stiffness_gradient": {"change": -3.0}}, r"bending stiffness of -.* must be positive"),
    ],
)
def test_effects_that_leave_no_rope_are_refused(effects, message):
    simulation = Simulation(PAPER.with_effects(effects), Motion([held_start()]), spans=7)
    with pytest.raises(SimulationError, match=message):
        simulation.start([Observation(0, straight_shape())])


def test_bases_and_shapes_are_checked():
    with pytest.raises(InputError, match="control_points is 3; a cubic spline needs at least 4"):
        SplineBasis(3, 0.4)
    with pytest.raises(InputError, match=r"length is 0\.0 m; it must be positive"):
        SplineBasis(10, 0.0)
    with pytest.raises(InputError, match="NaN or infinite"):
        Observation(0, np.full((10, 4), np.nan))
    for coinciding in (slice(0, 10), slice(4, 8)):
        shape = straight_shape()
        shape[coinciding] = shape[4]
        for start in ("equilibrium", "observed"):
            settings = replace(PAPER, simulation=replace(PAPER.simulation, start=start))
            simulation = Simulation(settings, Motion([held_start()]), spans=7)
            with pytest.raises(InputError, match=r"coincide at u = .* no direction there"):
                simulation.start([Observation(0, shape)])


def test_commands_are_checked():
    good = held_start()
    wrong = np.full((1, 1, 3), np.nan)
    with pytest.raises(CommandError, match="position that is not finite"):
        replace(good, positions=wrong)
    with pytest.raises(CommandError, match="velocity that is infinite"):
        replace(good, velocities=np.full((1, 1, 3), np.inf))
    with pytest.raises(CommandError, match="rotation of 'start' at point 0 has norm nan"):
        replace(good, rotations=np.full((1, 1, 4), np.nan))
    with pytest.raises(CommandError, match="time that is not finite"):
        replace(good, times=np.array([np.nan]))


def started(imposed, settings=PAPER, more=()):
    simulation = Simulation(settings, Motion([imposed]), spans=14)
    simulation.start([Observation(0, straight_shape())])
    for later in more:
        simulation.motion.add(later)
    return simulation


TURN = [[[0.0, 0.0, 0.0, 1.0]]] * 2 + [[[0.0, np.sin(0.8), 0.0, np.cos(0.8)]]]
JUMPS = {
    "within a command": (
        held_start(),
        command(["start"], [0.0, 0.1, 0.1001], [[0, 0, 0], [0, 0, 0], [0, 0, 0.2]]),
        r"'start' moves 0\.2 m at once at 0\.100 s; at most 0\.1 m \(0\.25 of the length\)",
    ),
    "from one command to the next": (
        held_start(),
        command(["start"], [0.0], [[0.0, 0.0, 0.3]], stamp=SECOND // 10),
        r"'start' moves 0\.3 m at once at 0\.000 s; at most 0\.1 m",
    ),
    "in direction": (
        held_start(),
        command(["start"], [0.0, 0.1, 0.1001], [[0, 0, 0]] * 3, TURN),
        r"'start' turns by 1\.6 rad at once at 0\.100 s; at most 1 rad",
    ),
    "of a pin": (
        command(["start", "control_point_6"], [0.0], [[0, 0, 0], [0.15, 0, -0.05]]),
        command(["start", "control_point_6"], [0.0], [[0, 0, 0], [0, 0, 0.15]], stamp=SECOND // 9),
        r"'control_point_6' moves 0\.25 m at once",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", JUMPS)
def test_a_command_that_jumps_is_told(case):
    first, then, message = JUMPS[case]
    simulation = started(first, more=[then])
    simulation.advance(SECOND // 20)
    before = simulation.state
    with pytest.raises(SimulationError, match=message):
        simulation.advance(SECOND // 2)
    assert simulation.state is before


def test_small_steps_and_new_grips_are_no_jumps():
    """Poses that are sent one by one, and a grip that finds the DLO elsewhere than simulated."""
    simulation = started(held_start())
    for k in range(1, 6):
        simulation.motion.add(
            command(["start"], [0.0], [[0.0, 0.0, 0.04 * k]], stamp=k * SECOND // 10)
        )
    simulation.advance(SECOND * 6 // 10)
    tip = simulation.prediction().control_points[-1, :3]
    elsewhere = [tip[0] - 0.12, 0.0, tip[2] + 0.05]
    simulation.motion.add(
        command(["start", "control_point_10"], [0.0], [[0, 0, 0.2], elsewhere],
                stamp=SECOND * 7 // 10)
    )  # fmt: skip
    shape = simulation.advance(SECOND).control_points
    np.testing.assert_allclose(shape[-1, :3], elsewhere, atol=1e-9)


def test_the_true_length_decides_what_can_be_reached():
    ends = [[[0, 0, 0], [0.3, 0, 0]], [[0, 0, 0], [0.44, 0, 0]]]
    apart = command(["start", "end"], [0.0, 0.4], ends)
    with pytest.raises(SimulationError, match=r"points 0\.44 m apart, .* only 0\.4 m long"):
        started(apart).advance(SECOND)
    longer = PAPER.with_effects({"length_error": {"difference": 0.06}})
    shape = started(apart, longer).advance(SECOND).control_points
    assert shape[-1, 0] == pytest.approx(0.44)


@pytest.mark.parametrize("failing", ["apart", "jump", "no direction"])
def test_a_live_simulation_holds_its_last_good_shape_and_goes_on(failing):
    names = ["control_point_1", "control_point_2", "control_point_10"]
    good = [[0, 0, 0], [0.02, 0, 0], [0.33, 0, 0]]
    bad = {
        "apart": ([[0, 0, 0], [0.02, 0, 0], [0.42, 0, 0]], r"0\.\d+ m apart.*0\.4 m long"),
        "jump": ([[0, 0, 0], [0.02, 0, 0], [-0.3, 0, 0]], r"'control_point_10' moves 0\.63 m"),
        "no direction": ([[0, 0, 0], [0, 0, 0], [0.33, 0, 0]], "direction of an end coincide"),
    }[failing]
    live = LiveSimulation(PAPER)
    live.set_command(command(names, [0.0], [good]))
    live.start([Observation(0, straight_shape())])
    last = live.advance(SECOND // 10).control_points
    live.set_command(command(names, [0.0], [bad[0]], stamp=SECOND // 10))
    with pytest.raises(DloError, match=bad[1]):
        live.advance(SECOND // 5)
    np.testing.assert_array_equal(live._simulation.prediction().control_points, last)
    live.set_command(command(names, [0.0], [good], stamp=SECOND // 4))
    shape = live.advance(SECOND // 2).control_points
    np.testing.assert_allclose(shape[-1, :3], good[2], atol=1e-6)
    assert np.abs(shape - last).max() < 0.1


def test_slip_goes_on_over_several_commands():
    """Three commands that together make one way, and a message that repeats itself."""
    settings = replace(PAPER, damping=replace(PAPER.damping, air_drag=1.0, relaxation_time=0.1))
    settings = settings.with_effects({"clamp_slip": {"length": 0.03}})
    heights = [0.0, 0.02, 0.06, 0.1]
    parts = [
        command(["start"], [0.0, 0.2], [[0.0, 0.0, a], [0.0, 0.0, b]], stamp=k * SECOND // 5)
        for k, (a, b) in enumerate(pairwise(heights))
    ]
    one = command(["start"], [0.0, 0.2, 0.4, 0.6], [[0.0, 0.0, z] for z in heights])
    stamps = [k * SECOND // 10 for k in range(1, 10)]
    shapes = []
    for commands in ([one], parts):
        simulation = Simulation(settings, Motion(list(commands)), spans=14)
        simulation.start([Observation(0, straight_shape())])
        shapes.append([p.control_points for p in simulation.advance_through(stamps)])
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-4)


def test_what_comes_later_leaves_the_slip_so_far_as_it_is():
    settings = PAPER.with_effects({"clamp_slip": {"length": 0.03}})
    first = command(["start"], [0.0, 0.2], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]])
    simulation = started(first, settings)
    simulation.advance(SECOND // 5)
    before = simulation.prediction().control_points
    simulation.motion.add(
        command(["start"], [0.0, 0.2], [[0, 0, 0.05], [0, 0, 0.1]], stamp=SECOND // 5)
    )
    after = simulation.advance(SECOND // 5 + SECOND // 1000).control_points
    assert np.abs(after - before)[:, :3].max() < 5e-3
    assert simulation._timeline.at(SECOND // 4, slips=True).progress.tolist() == pytest.approx(
        [1, 2]
    )
