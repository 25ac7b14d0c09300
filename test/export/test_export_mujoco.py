# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Exported cables in MuJoCo, against closed forms and the rod; `make test-export` installs it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from elastica import Cantilever

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.cli.main import main
from dlo_ros.errors import SimulationError
from dlo_ros.export import mujoco_run
from dlo_ros.export.fidelity import another_chain, first_chain, measure, step_of_another
from dlo_ros.export.mjcf import PLUGIN, mjcf
from dlo_ros.export.mujoco_run import MujocoCable
from dlo_ros.export.scenes import recorded_scene, standard_scene
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.parameters import RodParameters, Settings

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: make test-export")
FORMS = [
    False,
    pytest.param(
        True,
        marks=pytest.mark.skipif(
            not mujoco_run.has_plugin(mujoco, PLUGIN), reason="this MuJoCo has no plugin for cables"
        ),
    ),
]
STIFF = RodParameters(0.4, 0.004, 5e7, 2500.0)


def settled(settings, elements, plugin, step=5e-4):
    scene = standard_scene(settings)
    chain = first_chain(scene, settings, elements)
    cable = MujocoCable(mujoco, mjcf(chain, plugin=plugin, step=step, comment=""), chain)
    cable.settle()
    return cable.shape(scene.basis), scene.basis


@pytest.mark.parametrize("plugin", FORMS)
def test_a_stiff_cantilever_sags_as_the_closed_form_says(plugin):
    rod = replace(STIFF, young_modulus=5e9)
    shape, _ = settled(Settings(rod), 16, plugin, step=1e-4)
    weight = rod.linear_density * 9.81
    assert np.isclose(-shape[-1, 2], weight * 0.4**4 / (8.0 * rod.bending_stiffness), rtol=0.01)


@pytest.mark.parametrize("plugin", FORMS)
def test_a_heavy_cantilever_is_the_elastica(plugin):
    shape, basis = settled(Settings(STIFF), 32, plugin)
    weight = STIFF.linear_density * 9.81
    heavy = Cantilever(
        0.4, lambda s: np.full_like(s, STIFF.bending_stiffness), STIFF.young_modulus * STIFF.area,
        lambda s: (np.zeros_like(s), -weight * (0.4 - s)),
    )  # fmt: skip
    s = np.linspace(0.0, 0.4, 41)
    apart = np.linalg.norm(basis.evaluate(shape, s)[:, [0, 2]] - heavy.solve(s), axis=1)
    assert apart.mean() < 0.001 * 0.4


@pytest.mark.parametrize("plugin", FORMS)
def test_it_follows_the_rod_with_all_that_a_chain_can_have(plugin):
    effects = {
        "stiffness_gradient": {"change": 1.0},
        "intrinsic_curvature": {"curvature": (3.0, 0.0, -4.0)},
        "point_mass": {"mass": 0.004, "position": 0.25},
        "quadratic_drag": {"coefficient": 0.05},
        "air_drag": {"coefficient": 0.02},
        "clamp_angle": {"start": 0.2},
        "clamp_offset": {"start": (0.01, 0.02)},
        "gravity_tilt": {"angle": 0.1},
    }
    settings = replace(Settings(STIFF), effects=effects)
    scene = standard_scene(settings)
    found = measure(mujoco, scene, settings, 16, 5e-4, plugin=plugin)
    assert found.static < 0.005 and found.largest < 0.007
    # Each of these counts: without it the same chain is clearly further off.
    for name in ("stiffness_gradient", "intrinsic_curvature", "point_mass", "gravity_tilt"):
        less = replace(settings, effects={k: v for k, v in effects.items() if k != name})
        assert measure(mujoco, scene, less, 16, 5e-4, plugin=plugin).largest > 0.008, name


def test_air_drags_links_as_it_does_the_rod():
    """A light rope in thick air: the swing after the motion dies away alike."""
    effects = {"air_drag": {"coefficient": 0.2}}
    settings = replace(Settings(STIFF), effects=effects)
    scene = standard_scene(settings)
    assert measure(mujoco, scene, settings, 16, 5e-4, plugin=False).largest < 0.007
    thin = replace(settings, effects={})
    assert measure(mujoco, scene, thin, 16, 5e-4, plugin=False).largest > 0.03


def test_a_stiffer_cable_has_a_step_with_which_it_does_not_blow_up():
    settings = Settings(STIFF)
    scene = standard_scene(settings)
    own = first_chain(scene, settings, 12)
    assert measure(mujoco, scene, settings, 12, 2e-3, plugin=False).worst < 0.01
    damping = replace(settings.damping, relaxation_time=8e-4)
    stiff = Settings(replace(STIFF, young_modulus=3.2e8), damping=damping)
    chain = another_chain(scene, stiff, 12)
    with pytest.raises(SimulationError, match="blows up"):
        swung(chain, scene, 2e-3)
    step = step_of_another(chain, 2e-3, own)
    assert step < 1e-3 and step_of_another(own, 2e-3, own) == 2e-3
    assert np.abs(swung(chain, scene, step)).max() < 0.6


def swung(chain, scene, step):
    """Shapes of a chain that a scene's grips move."""
    cable = MujocoCable(mujoco, mjcf(chain, plugin=False, step=step, comment=""), chain)
    return cable.follow(scene.pose, scene.stamps[0], scene.stamps[1:], scene.basis).shapes


@pytest.mark.parametrize("plugin", FORMS)
def test_the_tool_reaches_what_is_asked_for_and_writes_it(plugin, tmp_path, capsys):
    params, out = tmp_path / "params.yaml", tmp_path / "cable.xml"
    Settings(STIFF).dump(params)
    form = "mjcf" if plugin else "mjcf-chain"
    call = ["export", "--params", str(params), "--format", form, "--output", str(out)]
    assert main([*call, "--max-err", "0.01"]) == 0
    said = capsys.readouterr().out
    at_rest, mean, most = map(
        float,
        re.search(
            r"at rest ([\d.]+) %; moving ([\d.]+) % in the mean, ([\d.]+) % at most", said
        ).groups(),
    )
    assert at_rest <= 1.0 and mean <= most <= 1.0
    assert f"at rest {at_rest:.2g} %" in out.read_text()
    model = mujoco.MjModel.from_xml_path(str(out))  # as a user would
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 200)
    assert np.all(np.isfinite(data.qpos))


def test_a_recording_is_compared_until_a_grip_lets_go():
    """The exported cable's grips stay; the rod falls."""
    settings = Settings(STIFF)
    scene = standard_scene(settings)
    first = scene.shapes[0]
    still = replace(
        scene.command, names=("start", "end"), times=np.zeros(1),
        positions=np.array([[first[0], first[-1]]]), velocities=np.full((1, 2, 3), np.nan),
        rotations=np.array([[[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]]),
    )  # fmt: skip
    loose = replace(
        still, stamp=200_000_000, names=("start",), positions=still.positions[:, :1],
        velocities=still.velocities[:, :1], rotations=still.rotations[:, :1],
    )  # fmt: skip
    shape = np.hstack([first, np.zeros((len(first), 1))])
    seen = tuple(Observation(k * 50_000_000, shape) for k in range(9))
    settings = scene.settings
    recording = Manipulation("loose", (still, loose), seen)
    found = recorded_scene(recording, settings, settings)
    assert found.stamps == tuple(o.stamp for o in seen[:4]) and len(found.observed) == 4
    assert found.name == "loose, up to 0.15 s, where its grips change"
    measured = measure(mujoco, found, settings, 16, 5e-4, plugin=False)
    assert measured.static < 0.01 and measured.largest < 0.01
    held = recorded_scene(replace(recording, commands=(still,)), settings, settings)
    assert len(held.stamps) == 9 and held.name == "loose"


REAL = {
    "hanging_loop/white/trial0": (6.0e6, "equilibrium", 40, 2e-3),
    "cable_swing/black_short_unweighted/dynamic_fixed_base": (9.4e6, "moving", 16, 5e-4),
}
"""Recordings, their E [Pa] as `identify` finds it, their start, elements and time step [s]."""


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(REAL))
def test_measured_cables(shared_data, name):
    modulus, start, elements, step = REAL[name]
    bag = shared_data / name
    settings = Settings.load(bag.parent / "params.yaml")
    settings = replace(
        settings,
        rod=replace(settings.rod, young_modulus=modulus),
        simulation=replace(settings.simulation, start=start),
    )
    scene = recorded_scene(load_manipulation(bag, settings), settings, settings)
    found = measure(mujoco, scene, settings, elements, step, plugin=False)
    assert found.worst < 0.01
    assert abs(found.recorded - found.rod_recorded) < 0.01 * settings.rod.length


def test_a_goal_out_of_reach_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("dlo_ros.export.fidelity.ELEMENTS", (8,))
    params = tmp_path / "params.yaml"
    Settings(STIFF).dump(params)
    call = [
        "export",
        "--params",
        str(params),
        "--format",
        "mjcf-chain",
        "--output",
        str(tmp_path / "c.xml"),
    ]
    assert main([*call, "--max-err", "0.0001"]) == 0
    assert "WARNING: 0.01 % of the length is not reached" in capsys.readouterr().out
