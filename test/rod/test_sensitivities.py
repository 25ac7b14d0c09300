# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives by every parameter, at rest and in motion, against differences of whole runs."""

from dataclasses import replace

import numpy as np
import pytest
from ordinary import some_of
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.rod import compiled_rod
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.resolution import build
from dlo_ros.rod.sensitivity_parameters import STEP, known, variation_of
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

LOOSE = replace(PAPER, simulation=replace(PAPER.simulation, tolerance=0.1))
STOPS = range(SECOND // 200, SECOND // 4 + 1, SECOND // 200)  # so close that every step succeeds
SMOOTH, KINKED = 2e-6, 2e-3  # an effect that switches has no derivative where it switches
ON_THE_WAY = 1e-3  # at rest in space, with 14 knot spans
CASES = [
    ("young_modulus", {}, SMOOTH),
    ("density", {}, SMOOTH),
    ("air_drag", {}, SMOOTH),
    ("relaxation_time", {}, SMOOTH),
    ("gravity", {}, SMOOTH),
    ("length", {}, SMOOTH),
    ("start.x", {}, SMOOTH),
    ("start.z", {}, SMOOTH),
    ("start.angle", {}, SMOOTH),
    ("end.x", {}, SMOOTH),
    ("end.angle", {}, SMOOTH),
    ("effects.intrinsic_curvature.curvature[1]",
     {"intrinsic_curvature": {"curvature": (1.0, 2.0, -1.0)}}, SMOOTH),
    ("effects.intrinsic_curvature.kink",
     {"intrinsic_curvature": {"kink": 0.2, "position": 0.15}}, SMOOTH),
    ("effects.clamp_angle.end", {"clamp_angle": {"end": 0.1}}, SMOOTH),
    ("effects.clamp_compliance.start", {"clamp_compliance": {"start": 4.0, "end": 0.0}}, SMOOTH),
    ("effects.clamp_compliance.end", {"clamp_compliance": {"start": 4.0, "end": 6.0}}, SMOOTH),
    ("effects.connector.mass", {"connector": {"mass": 0.01, "extent": 0.06}}, SMOOTH),
    ("effects.connector.extent", {"connector": {"mass": 0.01, "extent": 0.06}}, SMOOTH),
    ("effects.gravity_tilt.angle", {"gravity_tilt": {"angle": 0.1}}, SMOOTH),
    ("effects.point_mass.mass", {"point_mass": {"mass": 0.01, "position": 0.21}}, SMOOTH),
    ("effects.point_mass.position", {"point_mass": {"mass": 0.01, "position": 0.21}}, SMOOTH),
    ("effects.stiff_segment.centre",
     {"stiff_segment": {"centre": 0.155, "extent": 0.1, "ratio": 3.0}}, SMOOTH),
    ("effects.stiff_segment.ratio",
     {"stiff_segment": {"centre": 0.155, "extent": 0.1, "ratio": 3.0}}, SMOOTH),
    ("effects.stiffness_gradient.change", {"stiffness_gradient": {"change": 0.3}}, SMOOTH),
    ("effects.nonlinear_stiffness.half_curvature",
     {"nonlinear_stiffness": {"half_curvature": 5.0}}, SMOOTH),
    ("effects.plasticity.yield_curvature",
     {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}, KINKED),
    ("effects.plasticity.hardening",
     {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}, KINKED),
    ("effects.viscoelasticity.share", {"viscoelasticity": {"share": 0.0, "time": 0.1}}, SMOOTH),
    ("effects.viscoelasticity.share", {"viscoelasticity": {"share": 0.4, "time": 0.1}}, SMOOTH),
    ("effects.viscoelasticity.time", {"viscoelasticity": {"share": 0.4, "time": 0.05}}, SMOOTH),
    ("effects.hysteresis.moment", {"hysteresis": {"moment": 2e-3, "curvature": 2.0}}, KINKED),
    ("effects.hysteresis.curvature", {"hysteresis": {"moment": 2e-3, "curvature": 2.0}}, KINKED),
    ("effects.surface_friction.force", {"surface_friction": {"force": 0.05}}, KINKED),
    ("effects.air_drag.coefficient", {"air_drag": {"coefficient": 0.02}}, SMOOTH),
    ("effects.internal_damping.relaxation_time",
     {"internal_damping": {"relaxation_time": 0.01}}, SMOOTH),
    ("effects.command_delay.delay", {"command_delay": {"delay": 0.021}}, 0.2),
    ("effects.clamp_slip.length", {"clamp_slip": {"length": 0.01}}, SMOOTH),
    ("effects.clamp_slip.onset", {"clamp_slip": {"length": 0.01, "onset": 0.0631}}, SMOOTH),
    ("effects.clamp_slip.duration",
     {"clamp_slip": {"length": 0.01, "onset": 0.0231, "duration": 0.3}}, SMOOTH),
    ("effects.quadratic_drag.coefficient", {"quadratic_drag": {"coefficient": 0.0}}, SMOOTH),
    ("effects.quadratic_drag.coefficient", {"quadratic_drag": {"coefficient": 0.3}}, SMOOTH),
    ("effects.wall.offset", {"wall": {"offset": -0.1}}, KINKED),
    ("effects.length_error.difference", {"length_error": {"difference": 0.01}}, SMOOTH),
    ("effects.camera_scale.ratio", {"camera_scale": {"ratio": 1.01}}, SMOOTH),
    ("effects.camera_rotation.angle", {"camera_rotation": {"angle": 0.02}}, SMOOTH),
    ("effects.camera_shift.z", {"camera_shift": {"x": 0.003, "z": 0.002}}, SMOOTH),
    ("effects.clamp_offset.start[1]", {"clamp_offset": {"start": (0.002, 0.004)}}, SMOOTH),
    ("effects.clamp_offset.end[0]", {"clamp_offset": {"end": (0.0, 0.0, 0.0)}}, SMOOTH),
    ("effects.grip_offset.start[1]", {"grip_offset": {"start": (0.002, 0.004)}}, SMOOTH),
    ("effects.constant_force.z", {"constant_force": {"x": 0.02, "z": 0.03}}, SMOOTH),
    ("effects.obstacle.z", {"obstacle": {"x": 0.15, "z": -0.11, "radius": 0.02}}, KINKED),
]  # fmt: skip

CREEPS = {"viscoelasticity": {"share": 0.4, "time": 0.1}}
SOFTENS = {"nonlinear_stiffness": {"half_curvature": 5.0}}
RUBS = {"hysteresis": {"moment": 2e-3, "curvature": 2.0}}
GIVES = {"clamp_compliance": {"start": 4.0, "end": 6.0}}
CURVED = {"intrinsic_curvature": {"curvature": (1.0, 2.0, -1.0)}}
YIELDS = {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}
KINK = {"intrinsic_curvature": {"kink": -1.0, "position": 0.2}}
SLIPS = {"clamp_slip": {"length": 0.04}, **KINK, **GIVES}
OF_INELASTIC_RODS = [
    ("young_modulus", CREEPS, SMOOTH),
    ("young_modulus", SOFTENS, SMOOTH),
    ("start.angle", {**SOFTENS, **CURVED}, SMOOTH),
    ("effects.intrinsic_curvature.curvature[1]", {**CREEPS, **CURVED}, SMOOTH),
    ("effects.intrinsic_curvature.curvature[1]", {**SOFTENS, **CURVED}, SMOOTH),
    ("length", CREEPS, SMOOTH),
    ("young_modulus", {**CREEPS, **SOFTENS}, SMOOTH),
    ("effects.viscoelasticity.share", {**CREEPS, **SOFTENS}, SMOOTH),
    ("effects.nonlinear_stiffness.half_curvature", {**CREEPS, **SOFTENS}, SMOOTH),
    ("density", {"quadratic_drag": {"coefficient": 0.3}}, SMOOTH),
    ("start.z", {"quadratic_drag": {"coefficient": 0.3}}, SMOOTH),
    ("start.angle", {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}, KINKED),
    ("young_modulus", {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}, KINKED),
    ("density", {"surface_friction": {"force": 0.05}}, KINKED),
    ("effects.hysteresis.moment", {**RUBS, **GIVES}, KINKED),
    ("effects.hysteresis.curvature", {**RUBS, **GIVES}, KINKED),
    ("young_modulus", {**RUBS, **GIVES}, KINKED),
    ("effects.clamp_slip.length", SLIPS, SMOOTH),
    ("effects.intrinsic_curvature.kink", SLIPS, SMOOTH),
    ("effects.clamp_compliance.start", SLIPS, SMOOTH),
    ("effects.clamp_slip.length", {**SLIPS, **YIELDS}, KINKED),
    ("effects.intrinsic_curvature.kink", {**SLIPS, **YIELDS}, KINKED),
]

ACROSS = [
    ("effects.clamp_angle.start[2]", {"clamp_angle": {"start": (0.0, 0.0, 0.0)}}, SMOOTH),
    ("effects.clamp_angle.end[0]", {"clamp_angle": {"end": (0.1, 0.05, 0.2)}}, SMOOTH),
    ("effects.clamp_offset.end[1]", {"clamp_offset": {"end": (0.0, 0.0, 0.0)}}, SMOOTH),
    ("effects.grip_offset.start[1]", {"grip_offset": {"start": (0.0, 0.0, 0.0)}}, SMOOTH),
    ("effects.grip_offset.end[2]",
     {"clamp_angle": {"end": (0.1, 0.05, 0.2)}, "grip_offset": {"end": (0.002, 0.0, 0.004)}},
     SMOOTH),
    ("effects.grip_angle.start[0]", {"grip_angle": {"start": (0.0, 0.0)}}, SMOOTH),
    ("effects.grip_angle.end[1]", {"grip_angle": {"end": (0.1, 0.2)}}, SMOOTH),
    ("effects.gravity_tilt.across", {"gravity_tilt": {"angle": 0.1, "across": 0.0}}, SMOOTH),
    ("effects.gravity_tilt.angle", {"gravity_tilt": {"angle": 0.1, "across": 0.2}}, SMOOTH),
    ("effects.constant_force.y", {"constant_force": {"x": 0.02, "y": 0.0}}, SMOOTH),
    ("effects.intrinsic_curvature.across[1]",
     {"intrinsic_curvature": {"across": (1.0, 2.0, -1.0)}}, SMOOTH),
    ("effects.intrinsic_curvature.across", {"intrinsic_curvature": {"across": 0.0}}, SMOOTH),
    ("effects.anisotropy.ratio", {"anisotropy": {"ratio": 1.0, "angle": 0.4}}, SMOOTH),
    ("effects.anisotropy.ratio", {"anisotropy": {"ratio": 3.0, "angle": 0.4}}, SMOOTH),
    ("effects.anisotropy.angle", {"anisotropy": {"ratio": 3.0, "angle": 0.4}}, SMOOTH),
    ("effects.anisotropy.angle", {"anisotropy": {"ratio": 3.0, "angle": 0.4}, **CREEPS}, SMOOTH),
    ("effects.twisting_stiffness.ratio", {"twisting_stiffness": {"ratio": 1.0}}, SMOOTH),
    ("effects.twisting_stiffness.ratio", {"twisting_stiffness": {"ratio": 2.0}}, SMOOTH),
    ("effects.camera_rotation.angle[0]",
     {"camera_rotation": {"angle": (0.02, 0.01, -0.03)}}, SMOOTH),
    ("effects.camera_shift.y", {"camera_shift": {"x": 0.003, "y": 0.002}}, SMOOTH),
]  # fmt: skip

OF_THE_FIRST_SHAPE = [
    ("young_modulus", {}),
    ("length", {}),
    ("start.z", {}),
    ("end.angle", {}),
    ("effects.clamp_angle.end", {"clamp_angle": {"end": 0.1}}),
    ("effects.clamp_offset.start[1]", {"clamp_offset": {"start": (0.002, 0.004)}}),
    ("effects.grip_offset.start[1]", {"grip_offset": {"start": (0.002, 0.004)}}),
    ("effects.length_error.difference", {"length_error": {"difference": 0.01}}),
    ("effects.camera_scale.ratio", {"camera_scale": {"ratio": 1.01}}),
    ("effects.camera_rotation.angle", {"camera_rotation": {"angle": 0.02}}),
    ("effects.camera_shift.z", {"camera_shift": {"x": 0.003, "z": 0.002}}),
    ("effects.clamp_compliance.start", GIVES),
    ("young_modulus", GIVES),
]


def held(*, space):
    aside = 0.06 if space else 0.0
    return command(
        ["start", "end"], [0.0, 0.2],
        [[[0.0, 0.0, 0.0], [0.26, 0.0, 0.0]], [[0.02, aside, 0.04], [0.26, 0.0, 0.0]]],
    )  # fmt: skip


def hung(*, space):
    """Both ends held so that the rope hangs between them, stable across the plane, too."""
    angles = ((0.6, -0.6), (0.6, -0.9))
    rotations = [[[0.0, np.sin(0.5 * a), 0.0, np.cos(0.5 * a)] for a in both] for both in angles]
    return replace(held(space=space), rotations=np.array(rotations))


def lying(settings):
    """A first shape that sags between both ends, shape (n, 4)."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = 0.26 * basis.greville / 0.4
    shape[:, 2] = -0.1 * np.sin(np.pi * basis.greville / 0.4)
    return shape


def run(settings, imposed, parameters=(), first=None):
    """Published shapes at the start and at the stops, and their derivatives.

    Args:
        first: the first shape as it is seen, shape (n, 4); None: one that sags. A simulation that
            starts `moving` sees that the DLO was at rest a little higher before.
    """
    shape = lying(settings) if first is None else first
    needed = 2 if settings.simulation.start == "moving" else 1
    simulation = Simulation(settings, Motion([imposed]), parameters=parameters, spans=14)
    simulation.start([Observation(-SECOND // 100, 0.99 * shape), Observation(0, shape)][-needed:])
    path = [simulation.prediction(), *(simulation.advance(stop) for stop in STOPS)]
    path = [path[0], path[20], path[-1]]
    derivatives = np.array([p.sensitivity for p in path]) if parameters else None
    return np.array([p.control_points[:, :3] for p in path]), derivatives


def at_rest(settings, imposed):
    """The shape at rest as it is seen, without twist, published control points of shape (n, 4).

    Newton's method leaves some 1e-6 rad of twist where it comes from far away, of which a
    difference of runs across the plane would see more than of the parameter.
    """
    shape = lying(settings)
    for _ in range(2):
        simulation = Simulation(settings, Motion([imposed]), spans=14)
        simulation.start([Observation(0, MeasurementMap(settings).measured(shape))])
        shape = MeasurementMap(settings).true(simulation.prediction().control_points)
        shape[:, 3] = 0.0
    return MeasurementMap(settings).measured(shape)


@pytest.mark.parametrize("space", some_of([False, True], [False]), ids=["plane", "space"])
@pytest.mark.parametrize(("name", "effects", "slack"), CASES, ids=[c[0] for c in CASES])
def test_derivatives_agree_with_differences(same_steps, name, effects, slack, space):
    check(LOOSE.with_effects(effects), held(space=space), name, slack, space)


@pytest.mark.parametrize("space", some_of([False, True], [False]), ids=["plane", "space"])
@pytest.mark.parametrize(
    ("name", "effects", "slack"), OF_INELASTIC_RODS,
    ids=[f"{name} with {'+'.join(effects)}" for name, effects, _ in OF_INELASTIC_RODS],
)  # fmt: skip
def test_derivatives_of_inelastic_rods(same_steps, name, effects, slack, space):
    """By numbers that are not those of the law, which vary through what the rod remembers."""
    check(LOOSE.with_effects(effects), held(space=space), name, slack, space)


@pytest.mark.parametrize("space", some_of([False, True], [True]), ids=["plane", "space"])
@pytest.mark.parametrize(
    "start", some_of(["equilibrium", "observed", "moving"], ["equilibrium", "moving"])
)
@pytest.mark.parametrize(("name", "effects", "slack"), ACROSS, ids=[c[0] for c in ACROSS])
def test_derivatives_across_the_plane(same_steps, name, effects, slack, start, space):
    soft = replace(LOOSE, rod=replace(LOOSE.rod, young_modulus=5e6)).with_effects(effects)
    imposed = hung(space=space)
    first = at_rest(soft, imposed)
    started = replace(soft, simulation=replace(soft.simulation, start=start))
    # Twist that the frames gather on the way to rest is no spline, as theta is: what they gather
    # depends on the way by the error of the discretisation.
    slack = ON_THE_WAY if start == "equilibrium" else slack
    check(started, imposed, name, slack, space, first=first, wide=150.0)


@pytest.mark.parametrize("space", some_of([False, True], [True]), ids=["plane", "space"])
@pytest.mark.parametrize("start", some_of(["observed", "moving"], ["moving"]))
@pytest.mark.parametrize(
    ("name", "effects"), OF_THE_FIRST_SHAPE, ids=[n for n, _ in OF_THE_FIRST_SHAPE]
)
def test_derivatives_of_the_first_shape(same_steps, name, effects, start, space):
    """Where the DLO was at first depends on the camera's errors, and its ends on the clamps'."""
    soft = replace(LOOSE, rod=replace(LOOSE.rod, young_modulus=5e6)).with_effects(effects)
    imposed = hung(space=space)
    started = replace(soft, simulation=replace(soft.simulation, start=start))
    check(started, imposed, name, SMOOTH, space, first=at_rest(soft, imposed), wide=300.0)


@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
@pytest.mark.parametrize(
    ("body", "place", "axis"),
    [
        ({"wall": {"offset": -0.1, "angle": 0.0}}, "effects.wall.offset", "z"),
        ({"obstacle": {"x": 0.15, "z": -0.11, "radius": 0.02}}, "effects.obstacle.z", "z"),
        ({"obstacle": {"x": 0.15, "z": -0.11, "radius": 0.02}}, "effects.obstacle.x", "x"),
    ],
    ids=["wall", "peg, z", "peg, x"],
)
def test_grips_and_body_moved_together_move_the_dlo(body, place, axis, space):
    """Through all impacts, where derivatives by the place of what is hit have to be bounded."""
    names = (place, f"start.{axis}", f"end.{axis}")
    _, derivatives = run(LOOSE.with_effects(body), held(space=space), names)
    assert np.abs(derivatives[-1, 0]).max() > 0.05
    together = np.tile([axis == a for a in "xyz"], (derivatives.shape[2], 1))
    for at in derivatives:
        np.testing.assert_allclose(at.sum(axis=0), together, atol=3e-2 if space else 1e-3)


def check(settings, imposed, name, slack, space, first=None, wide=30.0):
    """Derivatives by a parameter against differences of whole runs.

    Args:
        first: see `run`.
        wide: step of the wide differences, in steps, at which rounding does not count; they are of
            fourth order.
    """
    _, exact = run(settings, imposed, (name,), first)
    if "twisting_stiffness" in name and not space:  # nothing twists; differences are rounding
        np.testing.assert_allclose(exact, 0.0, atol=1e-12)
        return
    chosen = variation_of(settings, name)

    def difference(change):
        sides = [chosen.vary(settings, imposed, d * change) for d in (1.0, -1.0)]
        pair = [run(*side, first=first)[0] for side in sides]
        return (pair[0] - pair[1]) / (2.0 * change)

    if slack < KINKED:
        expected = difference(wide * chosen.step), difference(2.0 * wide * chosen.step)
        expected = (4.0 * expected[0] - expected[1]) / 3.0
    else:
        expected = difference(STEP * chosen.natural)
    for k, instant in enumerate(("at rest", "moving", "at the end")):
        if ("obstacle" in name or "wall" in name) and (k > 0 or space):
            continue  # in motion it knocks, and in space it slides off
        scale = np.abs(expected[k]).max()
        if scale < 1e-7 * np.abs(expected).max():
            continue
        np.testing.assert_allclose(
            exact[k, 0], expected[k], atol=slack * scale, rtol=0.0, err_msg=instant
        )
    assert np.abs(expected).max() > 0.0


def test_unknown_parameters_are_refused_with_those_that_there_are():
    settings = LOOSE.with_effects({"point_mass": {"mass": 0.1, "position": 0.2}})
    assert "effects.point_mass.mass" in known(settings)
    with pytest.raises(InputError, match=r"no sensitivity to 'stiffness'; known are young_modulus"):
        run(settings, held(space=False), ("stiffness",))
    with pytest.raises(InputError, match=r"no sensitivity to .effects\.point_mass\.mass."):
        run(LOOSE, held(space=False), ("effects.point_mass.mass",))


def test_only_effects_on_the_rod_itself_need_rods_of_their_own(monkeypatch):
    effects = {
        "clamp_offset": {"start": (0.0, 0.0)}, "camera_shift": {"x": 0.0},
        "point_mass": {"mass": 0.01, "position": 0.2},
    }  # fmt: skip
    imposed = command(["start"], [0.0, 1.0], np.zeros((2, 1, 3)))
    model, boundary = build(PAPER.with_effects(effects), imposed, 6)
    names = ("effects.clamp_offset.start[0]", "effects.camera_shift.x", "effects.point_mass.mass")
    built = watched(monkeypatch)
    found = compiled_rod.compiled(model, boundary, imposed, names, flat=True)
    assert [rod.settings is model.settings for rod in built] == [True, False, False]
    assert found.moves.tolist() == [1.0, 0.0, 0.0]
    assert [bool(rate.any()) for rate in found.rates.mass] == [False, False, True]


def test_recordings_share_the_rods_of_their_parameters(monkeypatch):
    """They differ in their commands, in what is held, and in their time steps alone."""
    names, built, found = ("young_modulus", "start.x"), watched(monkeypatch), []
    for tolerance, height, end in ((1e-3, 0.0, "start"), (1e-4, 0.3, "start"), (1e-4, 0.3, "end")):
        imposed = command([end], [0.0, 1.0], np.full((2, 1, 3), height))
        simulation = replace(PAPER.simulation, tolerance=tolerance)
        model, boundary = build(replace(PAPER, simulation=simulation), imposed, 7)
        found.append(compiled_rod.compiled(model, boundary, imposed, names, flat=True))
        rule = found[-1].system.rule
        assert [rule.stretch_linear[k] for k in (0, -1)] == [end != "start", end != "end"]
        assert found[-1].system.fixed[0] == (end == "start")
        assert found[-1].system.reach == pytest.approx(boundary.reach * np.ones(5))
    assert len(built) == 3
    assert found[0].rates is found[1].rates is found[2].rates
    assert [f.imposed.positions[0, 0, 0, 2] for f in found] == [0.0, 0.3, 0.3]


def watched(monkeypatch):
    """The rods whose numbers are computed from here on."""
    built, parts = [], compiled_rod.parts_of
    monkeypatch.setattr(
        compiled_rod, "parts_of",
        lambda rod, *asked, **options: built.append(rod) or parts(rod, *asked, **options),
    )  # fmt: skip
    return built
