# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Formats whose simulators cannot be run here: read again, and held against the chain."""

import ast
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from cables import BASIS, chain_of, held, straight
from scipy.spatial.transform import Rotation

from dlo_ros.command import Command
from dlo_ros.export.formats import FORMATS
from dlo_ros.export.grips import Pose

EFFECTS = {
    "intrinsic_curvature": {"curvature": 4.0},
    "point_mass": {"mass": 0.01, "position": 0.3},
    "clamp_angle": {"start": 0.1},
    "gravity_tilt": {"angle": 0.2},
}


def bent():
    """A shape that is an arc, beginning as the clamp truly points."""
    u = np.linspace(0.0, 0.4, 200)
    angle = 0.1 + 3.0 * u
    arc = np.zeros((200, 4))
    arc[:, 0] = (np.sin(angle) - np.sin(0.1)) / 3.0
    arc[:, 2] = (np.cos(angle) - np.cos(0.1)) / 3.0
    return BASIS.fit(u, arc)


@pytest.fixture(scope="module")
def chain():
    return chain_of(EFFECTS, joints=8, command=held(("start", "end")), shape=bent())


def written(chain, name):
    return FORMATS[name].write(chain, step=1e-3, comment="Cable -- with\na comment")


# --- SDF ---------------------------------------------------------------------------------------


def sdf_pose(text):
    x = [float(v) for v in text.split()]
    return Pose(np.array(x[:3]), Rotation.from_euler("xyz", x[3:]))


def test_sdf_follows_the_formats_rules(chain):
    root = ElementTree.fromstring(written(chain, "sdf"))
    assert root.tag == "sdf" and root.get("version") == "1.9"
    model = root.find("world/model")
    names = [e.get("name") for e in [*model.iter("link"), *model.iter("joint")]]
    assert len(set(names)) == len(names) == 9 + 8 + 2
    links = {link.get("name") for link in model.iter("link")}
    mass = 0.0
    for link in model.iter("link"):
        mass += float(link.find("inertial/mass").text)
        entries = {e.tag: float(e.text) for e in link.find("inertial/inertia")}
        a, b, c = sorted(entries[k] for k in ("ixx", "iyy", "izz"))
        assert a > 0.0 and a + b > c * (1.0 - 1e-6)  # what a body can have
    assert np.isclose(mass, chain.line_density * chain.length + 0.01)
    for joint in model.iter("joint"):
        assert joint.find("parent").text in links | {"world"}
        assert joint.find("child").text in links
        assert joint.get("type") in ("universal", "fixed", "ball")
    gravity = [float(x) for x in root.find("world/gravity").text.split()]
    assert np.allclose(gravity, chain.gravity) and abs(gravity[0]) > 1.0


def test_sdf_has_the_chains_poses_springs_and_rest(chain):
    model = ElementTree.fromstring(written(chain, "sdf")).find("world/model")
    poses = [sdf_pose(link.find("pose").text) for link in model.iter("link")]
    for found, expected in zip(poses, chain.poses, strict=True):
        assert np.allclose(found.position, expected.position, atol=1e-8)
        assert (found.rotation.inv() * expected.rotation).magnitude() < 1e-7
    for k in range(1, 9):
        joint = model.find(f"joint[@name='joint_{k}']")
        first, second = (joint.find(f"{tag}/dynamics") for tag in ("axis", "axis2"))
        for axis in (first, second):
            stiffness = float(axis.find("spring_stiffness").text)
            assert np.isclose(stiffness, chain.bend[k - 1])
            damping = float(axis.find("damping").text)
            assert np.isclose(damping, chain.relaxation_time * stiffness)
        # The relative turn of the links, moved by the reference, is that at rest.
        now = (poses[k - 1].rotation.inv() * poses[k].rotation).as_rotvec()
        rest = now[1] + float(first.find("spring_reference").text)
        assert np.isclose(rest, chain.rest[k - 1].as_rotvec()[1], atol=1e-7)
        assert np.isclose(rest, 4.0 * chain.cell, rtol=1e-5)


def test_a_pose_that_points_straight_up_can_be_written():
    up = straight(angle=-0.5 * np.pi)
    chain = chain_of(command=held(angle=-0.5 * np.pi), shape=up)
    model = ElementTree.fromstring(written(chain, "sdf")).find("world/model")
    for link, expected in zip(model.iter("link"), chain.poses, strict=True):
        found = sdf_pose(link.find("pose").text)
        assert (found.rotation.inv() * expected.rotation).magnitude() < 1e-6


# --- USD ---------------------------------------------------------------------------------------


def test_usd_read_by_its_own_library(chain, tmp_path):
    pxr = pytest.importorskip("pxr", reason="usd-core is not installed: make test-export")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    path = tmp_path / "cable.usda"
    path.write_text(written(chain, "usd"))
    stage = Usd.Stage.Open(str(path))
    assert pxr and UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    scene = UsdPhysics.Scene(stage.GetPrimAtPath("/Scene"))
    down = np.array(scene.GetGravityDirectionAttr().Get()) * scene.GetGravityMagnitudeAttr().Get()
    assert np.allclose(down, chain.gravity, rtol=1e-6)
    mass = sum(
        UsdPhysics.MassAPI(stage.GetPrimAtPath(f"/Cable/link_{k}")).GetMassAttr().Get()
        for k in range(9)
    )
    assert np.isclose(mass, chain.line_density * chain.length + 0.01)
    for k in range(1, 9):
        prim = stage.GetPrimAtPath(f"/Cable/joint_{k}")
        joint = UsdPhysics.Joint(prim)
        for rel in (joint.GetBody0Rel(), joint.GetBody1Rel()):
            [target] = rel.GetTargets()
            assert stage.GetPrimAtPath(target).HasAPI(UsdPhysics.RigidBodyAPI)
        for axis, stiffness in (("rotX", chain.twist), ("rotY", chain.bend), ("rotZ", chain.bend)):
            drive = UsdPhysics.DriveAPI(prim, axis)
            assert prim.HasAPI(UsdPhysics.DriveAPI, axis)
            in_radians = drive.GetStiffnessAttr().Get() * 180.0 / np.pi
            assert np.isclose(in_radians, stiffness[k - 1], rtol=1e-6)
        for axis in ("transX", "transY", "transZ"):
            limit = UsdPhysics.LimitAPI(prim, axis)
            assert limit.GetLowAttr().Get() > limit.GetHighAttr().Get()  # locked
        rest = Gf.Quatf(joint.GetLocalRot0Attr().Get())
        angle = 2.0 * np.arctan2(rest.GetImaginary()[1], rest.GetReal())
        assert np.isclose(angle, chain.rest[k - 1].as_rotvec()[1], rtol=1e-5)
    for end in ("start", "end"):
        body = stage.GetPrimAtPath(f"/Cable/{end}")
        assert UsdPhysics.RigidBodyAPI(body).GetKinematicEnabledAttr().Get()


# --- Newton ------------------------------------------------------------------------------------


def numbers(text):
    """The constants of the script."""
    tree = ast.parse(text)
    return {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
    }


def test_newtons_script_compiles_and_has_the_chains_numbers(chain):
    text = written(chain, "newton")
    compile(text, "cable.py", "exec")
    found = numbers(text)
    assert np.allclose([joint[0] for joint in found["JOINTS"]], chain.bend)
    assert np.isclose(sum(link[1] for link in found["LINKS"]), 0.01 + chain.line_density * 0.4)
    assert np.allclose(found["GRAVITY"], chain.gravity)
    assert found["START"] == found["END"] == "clamp"
    for joint, rest, turn in zip(found["JOINTS"], chain.rest, chain.turns, strict=True):
        assert np.allclose(joint[1], rest.as_quat()) and np.allclose(joint[2], turn.as_quat())


@pytest.mark.parametrize("names", [("control_point_1",), ("end",)])
def test_free_ends_and_tips_are_written(names):
    places = np.zeros((1, len(names), 3))
    command = Command(
        0, names, np.zeros(1), places, np.tile([0.0, 0.0, 0.0, 1.0], (1, len(names), 1)),
        np.full((1, len(names), 3), np.nan), 12,
    )  # fmt: skip
    chain = chain_of(command=command)
    for name in FORMATS:
        text = written(chain, name)
        assert ("grip_end" in text) == (names == ("end",)) if name == "mjcf" else text
    found = numbers(written(chain, "newton"))
    assert found["START"] == ("" if names == ("end",) else "tip")


@pytest.mark.long
def test_newton_runs_it_and_it_stays_at_rest(tmp_path):
    pytest.importorskip("newton", reason="Newton is not installed")
    pytest.importorskip("mujoco_warp", reason="Newton's MuJoCo solver is not installed")
    import importlib.util

    from dlo_ros.export.fidelity import first_chain
    from dlo_ros.export.scenes import standard_scene
    from dlo_ros.parameters import RodParameters, Settings

    settings = Settings(RodParameters(0.4, 0.004, 5e7, 2500.0))
    built = first_chain(standard_scene(settings), settings, 16)
    path = tmp_path / "cable.py"
    path.write_text(written(built, "newton"))
    spec = importlib.util.spec_from_file_location("cable", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    places = script.run(1.0, use_mujoco_cpu=True)
    expected = np.array([pose.position for pose in built.poses])
    assert np.linalg.norm(places[:, :3] - expected, axis=1).mean() < 0.01 * 0.4
