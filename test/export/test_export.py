# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`export`: the chain of links, what a format cannot say, draws; the tool without a simulator."""

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import fields, replace
from itertools import islice

import numpy as np
import pytest
from cables import BASIS, ROD, chain_of, held, straight
from scipy.spatial.transform import Rotation

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.effects import Body, build, effects
from dlo_ros.errors import InputError
from dlo_ros.export import mujoco_run
from dlo_ros.export.chain import STIFFEST
from dlo_ros.export.draws import draw, read_knowledge, statement
from dlo_ros.export.format_support import unsupported
from dlo_ros.export.formats import FORMATS
from dlo_ros.export.mjcf import FIELDS, mjcf
from dlo_ros.parameters import Settings
from dlo_ros.rod.model import RodModel


def test_the_links_have_the_rods_mass_and_tile_its_length():
    chain = chain_of()
    assert np.isclose(sum(map(chain.mass, range(11))), ROD.linear_density * ROD.length)
    lengths = [b - a for a, b in map(chain.extent, range(11))]
    assert np.allclose(lengths, [0.02, *[0.04] * 9, 0.02])
    for k in range(11):
        along, across = chain.inertia(k)
        assert 0.0 < along < 2.0 * across  # what a body can have


def test_compliances_and_angles_at_rest_are_integrals():
    values = (2.0, -1.0, 4.0)
    chain = chain_of(
        {
            "stiffness_gradient": {"change": 0.8},
            "intrinsic_curvature": {"curvature": values, "kink": 0.3, "position": 0.13},
        },
        joints=16,
    )
    u = np.linspace(0.0, 0.4, 100_001)
    b = ROD.bending_stiffness * (1.0 + 0.8 * (u / 0.4 - 0.5))
    assert np.isclose(np.sum(1.0 / chain.bend), np.trapezoid(1.0 / b, u), rtol=1e-4)
    bent = np.trapezoid(np.interp(u, [0.0, 0.2, 0.4], values), u) + 0.3
    assert np.isclose(chain.rest.as_rotvec()[:, 1].sum(), bent, rtol=1e-4)
    assert np.argmax(chain.rest.as_rotvec()[:, 1]) == 5  # the kink's cell


def test_a_rigid_plug_is_stiff_and_has_its_mass():
    chain = chain_of({"connector": {"mass": 0.02, "extent": 0.08}}, joints=20)
    assert np.isclose(chain.bend[-1] / chain.bend[0], STIFFEST)
    assert np.isclose(sum(m for m, _, _ in chain.masses), 0.02)
    places = [chain.cell * (link - 0.5) + x for _, link, x in chain.masses]
    assert np.isclose(np.mean(places), 0.36)


@pytest.mark.parametrize(
    "soft",
    [
        {"clamp_compliance": {"start": 3000.0}},
        {"stiff_segment": {"centre": 0.1, "extent": 0.04, "ratio": 0.01}},
    ],
)
def test_one_soft_place_leaves_the_other_joints_as_stiff_as_they_are(soft):
    chain = chain_of(soft)
    plain = ROD.bending_stiffness / chain.cell
    assert chain.bend.min() < plain / 40.0
    assert np.allclose(np.sort(chain.bend)[3:], plain, rtol=1e-6)


def test_a_longer_rope_has_longer_links():
    chain = chain_of(
        {"length_error": {"difference": 0.02}, "point_mass": {"mass": 0.01, "position": 0.2}}
    )
    assert np.isclose(chain.cell, 0.042)
    [(_, link, x)] = chain.masses
    assert np.isclose(chain.cell * (link - 0.5) + x, 0.21)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_the_grip_holds_what_the_set_up_makes_of_it(angle):
    wrong = {"clamp_angle": {"start": 0.1}, "clamp_offset": {"start": (0.01, -0.02)}}
    place = (0.1, 0.0, 0.3)
    true = (0.11, 0.0, 0.28)
    chain = chain_of(
        wrong, command=held(position=place, angle=angle), shape=straight(true, angle + 0.1)
    )
    [grip] = chain.grips
    held_at = grip.commanded @ grip.offset
    assert np.allclose(held_at.position, true)
    assert np.allclose(held_at.rotation.as_rotvec(), [0.0, angle + 0.1, 0.0])
    assert np.allclose(chain.poses[0].rotation.as_rotvec(), [0.0, angle + 0.1, 0.0])


def test_links_are_rolled_as_the_clamp_that_holds_them():
    """Curvature at rest is about the clamp's own axes."""
    rolled = Rotation.from_rotvec([0.7, 0.0, 0.0])
    command = replace(held(), rotations=rolled.as_quat()[None, None])
    chain = chain_of({"intrinsic_curvature": {"curvature": 2.0}}, command=command)
    [grip] = chain.grips
    for pose in (*chain.poses, grip.commanded @ grip.offset):
        assert np.allclose(pose.rotation.as_matrix(), rolled.as_matrix())


def test_links_lie_on_the_shape():
    u = np.linspace(0.0, 0.4, 200)
    arc = np.column_stack([np.sin(5 * u) / 5, 0 * u, (np.cos(5 * u) - 1) / 5, 0 * u])
    chain = chain_of(shape=BASIS.fit(u, arc), joints=40)
    for k, pose in enumerate(chain.poses):
        middle = (
            pose @ type(pose)(np.array([0.5 * chain.cell, 0.0, 0.0]), Rotation.identity())
        ).position
        radius = np.linalg.norm(middle - [0.0, 0.0, -0.2])
        assert abs(radius - 0.2) < 2e-4, k


# --- what a format cannot say ----------------------------------------------------------------


def plausible(name):
    """An effect's numbers with which it does something."""
    rope = Settings(ROD).scale
    values = {}
    for q in effects()[name].quantities():
        value = q.plausible_for(rope, 1.0)
        if q.role in ("place", "extent") and q.unit == "m":
            value = 0.3 * ROD.length if q.role == "place" else 0.2 * ROD.length
        values[q.name] = q.filled(value)
    if name == "intrinsic_curvature":
        values["kink"] = 0.2
    return {name: values}


def same(a, b):
    rest = np.allclose(a.rest.as_rotvec(), b.rest.as_rotvec())
    numbers = ("length", "relaxation_time", "air_drag", "quadratic_drag", "line_density", "masses")
    grips = all(
        np.allclose(x.offset.position, y.offset.position)
        and np.allclose(x.offset.quaternion, y.offset.quaternion)
        for x, y in zip(a.grips, b.grips, strict=True)
    )
    return (
        rest and grips and np.allclose(a.bend, b.bend) and np.allclose(a.twist, b.twist)
        and np.allclose(a.gravity, b.gravity)
        and all(getattr(a, n) == getattr(b, n) for n in numbers)
    )  # fmt: skip


@pytest.mark.parametrize("name", sorted(effects()))
def test_an_effect_is_in_the_chain_or_told_by_name(name):
    given = plausible(name)
    settings = replace(Settings(ROD), effects=given)
    found = unsupported(settings, FIELDS)
    told = [line for line in found.lines if line.startswith(f"effects.{name} (")]
    assert bool(told) == (name not in found.settings.effects)
    if not told:
        # The shape is held as it is.
        start = given.get("grip_angle", given.get("clamp_angle", {})).get("start", 0.0)
        start = start[0] if isinstance(start, tuple) else start
        shape = straight(angle=start)
        assert not same(chain_of(given, shape=shape), chain_of())


def test_a_new_field_of_the_rod_counts_as_not_said():
    assert {f.name for f in fields(Body)} > FIELDS
    hidden = FIELDS - {"masses"}
    settings = replace(Settings(ROD), effects=plausible("point_mass"))
    assert (
        "effects.point_mass (mass on the DLO) is left out" in unsupported(settings, hidden).lines[0]
    )


def test_a_flat_section_is_told_also_where_it_lies_level():
    settings = replace(Settings(ROD), effects={"anisotropy": {"ratio": 3.0}})
    found = unsupported(settings, FIELDS)
    assert "effects.anisotropy (" in found.lines[0] and not found.settings.effects


def test_stretch_is_told_with_its_size():
    [line] = unsupported(Settings(ROD), FIELDS).lines
    weight = RodModel(Settings(ROD), BASIS).line_load[:, 2].sum()
    share = 50.0 * abs(weight) / (ROD.young_modulus * ROD.area)
    assert line == f"stretch: links are rigid; hanging straight the DLO is {share:.2g} % longer"


# --- the text --------------------------------------------------------------------------------


@pytest.mark.parametrize("plugin", [False, True])
def test_mjcf_read_again(plugin):
    chain = chain_of(
        {
            "point_mass": {"mass": 0.01, "position": 0.3},
            "stiff_segment": {"centre": 0.1, "extent": 0.1, "ratio": 3.0},
        },
        command=held(("start", "end")),
    )
    root = ElementTree.fromstring(mjcf(chain, plugin=plugin, step=1e-3, comment="a -- b\nc"))
    joints = [j for j in root.iter("joint") if j.get("type") == "ball"]
    assert len(joints) == 10 and root.find(".//freejoint") is not None
    masses = [float(i.get("mass")) for i in root.iter("inertial")]
    assert np.isclose(sum(masses), ROD.linear_density * ROD.length + 0.01)
    assert [w.tag for w in root.find("equality")] == ["weld", "weld"]
    sites = {s.get("name") for s in root.iter("site")}
    for weld in root.find("equality"):
        assert {weld.get("site1"), weld.get("site2")} <= sites
    key = root.find("keyframe/key")
    assert len(key.get("qpos").split()) == 7 + 4 * 10 and len(key.get("mpos").split()) == 6
    if plugin:
        radius = {
            b.get("name"): float(b.find("geom").get("size"))
            for b in root.iter("body")
            if b.find("geom") is not None
        }
        modulus = float(root.find(".//config[@key='bend']").get("value"))
        stiffness = [
            modulus * np.pi * radius[f"link_{k}"] ** 4 / 4 / chain.cell for k in range(1, 11)
        ]
        assert np.allclose(stiffness, chain.bend, rtol=1e-6)
    else:
        assert np.allclose([float(j.get("stiffness")) for j in joints], chain.bend)


def test_ends_that_are_held_otherwise():
    names = ("control_point_1", "control_point_2", "control_point_12")
    places = np.array([[[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.4, 0.0, 0.0]]])
    command = Command(
        0,
        names,
        np.zeros(1),
        places,
        np.tile([0.0, 0.0, 0.0, 1.0], (1, 3, 1)),
        np.full((1, 3, 3), np.nan),
        12,
    )
    chain = chain_of(command=command)
    assert [(g.end, g.kind) for g in chain.grips] == [("start", "clamp"), ("end", "tip")]
    root = ElementTree.fromstring(mjcf(chain, plugin=False, step=1e-3, comment=""))
    assert [c.tag for c in root.find("equality")] == ["weld", "connect"]


# --- intervals and draws ---------------------------------------------------------------------


def estimate(tmp_path, matrix=None, **more):
    path = tmp_path / "estimate.json"
    if matrix is None:  # E/mu to 2 %, nothing else
        a = np.array([1.0, -1.0, 0.0, 0.0])
        matrix = np.outer(a, a) / 0.02**2
    path.write_text(json.dumps({"information": {"matrix": np.asarray(matrix).tolist()}, **more}))
    return path


def test_draws_have_the_spread_that_is_known(tmp_path):
    settings = replace(
        Settings(replace(ROD, density_std=50.0)),
        effects={"intrinsic_curvature": {"curvature": (1.0, 2.0)}},
    )
    path = estimate(tmp_path, setup={"intrinsic_curvature.curvature": {"value": 1.0, "std": 0.25}})
    known = read_knowledge(settings, path)
    assert np.isclose(known.ratio_std, 0.02, rtol=0.01)
    cables = list(islice(draw(settings, known), 400))
    ratio = np.log([c.rod.specific_modulus for c in cables])
    assert np.isclose(ratio.std(), 0.02, rtol=0.15) and abs(ratio.mean() - np.log(2e4)) < 0.004
    assert np.isclose(np.std([c.rod.density for c in cables]), 50.0, rtol=0.15)
    curved = np.array([c.effects["intrinsic_curvature"]["curvature"] for c in cables])
    assert np.allclose(curved.std(axis=0), 0.25, rtol=0.15)
    assert [c.rod for c in islice(draw(settings, known), 3)] == [c.rod for c in cables[:3]]
    of_camera = replace(settings, effects=settings.effects | {"camera_scale": {"ratio": 1.01}})
    path = estimate(tmp_path, setup={"camera_scale.ratio": {"value": 1.01, "std": 0.002}})
    seen = read_knowledge(of_camera, path)
    assert ("camera_scale", "ratio") in seen.numbers  # which no simulated cable has
    assert next(draw(settings, seen)).effects == settings.effects
    assert "95 % interval 1.923e+04 to 2.08e+04" in statement(settings, known)
    assert "uncertainty is not given" in statement(settings, read_knowledge(settings, None))


def test_the_parameter_files_own_std_is_an_interval_too():
    settings = Settings(replace(ROD, specific_modulus_std=400.0))
    known = read_knowledge(settings, None)
    assert np.isclose(known.ratio_std, 0.02, rtol=0.01)
    assert "95 % interval 1.923e+04 to 2.08e+04" in statement(settings, known)


@pytest.mark.parametrize(
    "text", ["{", "{}", '{"information": {"matrix": [[1]]}}', '{"information": 3}']
)
def test_no_estimate_is_refused(tmp_path, text):
    path = tmp_path / "estimate.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"estimate\.json"):
        read_knowledge(Settings(ROD), path)


# --- the tool where nothing can be run ---------------------------------------------------------


@pytest.fixture
def params(tmp_path):
    path = tmp_path / "params.yaml"
    effects = {"wall": {"offset": -1.0, "angle": 0.0}, "camera_shift": {"x": 0.01, "z": 0.0}}
    replace(Settings(ROD), effects=effects).dump(path)
    return path


def test_without_mujoco_a_default_is_written_and_said(params, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(mujoco_run, "installed", lambda: None)
    out = tmp_path / "cable.xml"
    call = ["export", "--params", str(params), "--format", "mjcf-chain", "--output", str(out)]
    assert main([*call, "--sample", "3", "--estimate", str(estimate(tmp_path))]) == 0
    said = capsys.readouterr().out
    for text in (
        "32 elements",
        "MuJoCo is not installed",
        "effects.wall (",
        "effects.camera_shift (",
        "95 % interval",
    ):
        assert text in said and text in out.read_text()
    files = sorted(tmp_path.glob("cable_*.xml"))
    assert [f.name for f in files] == [f"cable_00{k}.xml" for k in (1, 2, 3)]
    moduli = {
        ElementTree.parse(f).find(".//joint[@name='joint_5']").get("stiffness") for f in files
    }
    assert len(moduli) == 3
    assert "Plausible cable 2" in files[1].read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--max-err", "0"], "--max-err"),
        (["--sample", "0"], "--sample"),
        (["--bag", "nowhere"], "nowhere"),
        (["--estimate", "nowhere.json"], "nowhere.json"),
        (["--output", "no/such/folder/x.xml"], "folder"),
    ],
)
def test_what_cannot_be_used_is_one_line(params, tmp_path, capsys, options, words):
    call = [
        "export",
        "--params",
        str(params),
        "--format",
        "mjcf",
        "--output",
        str(tmp_path / "x.xml"),
    ]
    assert main([*call, *options]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and words in text and not (tmp_path / "x.xml").exists()


def test_an_unknown_format_lists_the_others(params, tmp_path, capsys):
    call = ["export", "--params", str(params), "--format", "urdf", "--output", str(tmp_path / "x")]
    assert main(call) == 2
    said = capsys.readouterr().err
    assert all(name in said for name in FORMATS)


def test_effects_that_stay_are_those_of_the_chain(params):
    left = unsupported(Settings.load(params), FIELDS)
    assert not build(left.settings.effects)
