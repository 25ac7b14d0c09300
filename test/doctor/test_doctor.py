# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What `doctor` finds wrong, and that it finds nothing where all is well; no node runs here."""

import importlib
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
from conftest import ROOT

from dlo_ros.cli import doctor
from dlo_ros.cli import main as cli
from dlo_ros.dependencies import DEPENDENCIES, missing
from dlo_ros.doctor import environment, installation
from dlo_ros.doctor.connections import connections, quality
from dlo_ros.doctor.finding import WIDTH, Level, ok, page, warning, worst, wrong
from dlo_ros.doctor.graph import Endpoint, Graph, Header, NodeState
from dlo_ros.doctor.node_states import nodes
from dlo_ros.doctor.parameter_check import judge, judge_file
from dlo_ros.doctor.times_and_frames import clocks, frames
from dlo_ros.errors import KernelError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics

POSES = topics.TYPES[topics.OBSERVED]
DEFAULT = ROOT / "config" / "default.yaml"
SHARED = {
    "use_sim_time": False,
    "frame_id": "board",
    "rod.length": 0.4,
    "rod.diameter": 0.004,
    "rod.control_points": 10,
}
NODES = tuple(
    NodeState(f"/{name}", True, 0, "works", SHARED)
    for name in ("observer", "simulator", "identifier")
)
HEALTHY = Graph(
    "rmw_fastrtps_cpp",
    5.0,
    {
        "/dlo/observed": (
            Endpoint("/observer", POSES, True),
            Endpoint("/simulator", POSES, False),
            Endpoint("/identifier", POSES, False),
        ),
        "/dlo/command": (
            Endpoint("/robot", topics.TYPES[topics.COMMAND], True, latched=True),
            Endpoint("/simulator", topics.TYPES[topics.COMMAND], False, latched=True),
        ),
    },
    nodes=NODES,
    headers={
        "/dlo/observed": Header("board", 999.9, 1000.0, 10),
        "/dlo/command": Header("board", 10.0, 1000.0),
    },
    frames=frozenset({"camera", "board"}),
)


def bad(findings, level=Level.WRONG):
    return [f for f in findings if f.level == level]


def one(findings, *words, level=Level.WRONG):
    """The one bad finding, whose text and remedy hold the words."""
    (found,) = bad(findings, level)
    for word in words:
        assert word in f"{found.text} -> {found.remedy}"
    assert found.remedy
    return found


# --- the page --------------------------------------------------------------------------------


def test_the_page_can_be_read():
    sections = {
        "First": [ok("well"), wrong("x" * 30 + " " + "y" * 80, "mend it"), warning("doubtful")],
        "Empty": [],
    }
    text = page("title", sections)
    assert text.splitlines()[0] == "title" and "Empty" not in text
    assert "  WRONG    xxx" in text and "-> mend it" in text
    assert text.endswith("1 thing is wrong, 1 warning")
    assert max(map(len, text.splitlines())) <= WIDTH
    assert worst(sections["First"]) == Level.WRONG and worst([]) == Level.OK
    assert page("t", {"a": [ok("b")]}).endswith("nothing is wrong")
    assert page("t", {"a": [wrong("b", "c")] * 2}).endswith("2 things are wrong")


# --- what is installed -----------------------------------------------------------------------


def test_what_is_installed_here_is_well():
    found = installation.installed("0")
    assert not bad(found) and "numpy" in found[1].text and "numba" in found[1].text


def test_a_library_that_is_missing_old_or_broken_is_told():
    def importer(name):
        if name in ("numba", "rclpy"):
            raise ModuleNotFoundError(name, name=name)
        if name == "scipy":
            raise ImportError("numpy.core.multiarray failed to import\nmore")
        if name == "rosbags":
            return SimpleNamespace(__version__="0.9.1")
        if name == "cv2":  # Ubuntu's
            return SimpleNamespace(__version__="4.6.0", aruco=None)
        return importlib.import_module(name)

    found = installation.installed("0", importer)
    told = {f.text.split()[0]: f for f in bad(found)}
    assert set(told) == {"numba", "scipy", "rosbags"}
    assert "pip install numba" in told["numba"].remedy
    assert "multiarray" in told["scipy"].text and "NumPy" in told["scipy"].remedy
    assert "older than 0.11.7" in told["rosbags"].text
    one(found, "rclpy is not installed", level=Level.WARNING)


@pytest.mark.parametrize(
    ("older", "newer"), [("1.9.3", "1.10"), ("4.6.0", "4.7"), ("2.0rc1", "2.1"), ("9", "unknown")]
)
def test_versions_compare_as_numbers(older, newer):
    assert installation.numbers(older) < installation.numbers(newer)


def test_rclpy_of_another_python_is_wrong():
    def importer(name):
        if name == "rclpy":
            raise ImportError("_rclpy_pybind11.cpython-312 cannot be loaded")
        return importlib.import_module(name)

    one(installation.installed("0", importer), "rclpy cannot be imported", "Python")


def test_kernels_that_cannot_be_kept():
    assert not bad(installation.judge_kernels("/cache", True, []))
    one(
        installation.judge_kernels("/cache", True, ["rod"]),
        "rod", "dlo_ros.compile", level=Level.WARNING,
    )  # fmt: skip
    one(installation.judge_kernels("/cache", False, ["rod"]), "/cache", "NUMBA_CACHE_DIR")


def test_kernels_without_numba(monkeypatch):
    from dlo_ros import kernel_cache

    monkeypatch.setitem(sys.modules, "numba", None)
    kernel_cache.cache_folder.cache_clear()
    one(installation.kernels(), "numba is not installed", "pip install")
    kernel_cache.cache_folder.cache_clear()


def test_every_library_says_how_to_get_it():
    for dependency in DEPENDENCIES:
        assert "pip install" in dependency.missing
        assert missing(f"{dependency.module}.part") == dependency.missing
    assert "apt install python3-scipy" in missing("scipy.signal")
    assert "numba" in missing("llvmlite.binding") and "ROS 2" in missing("sensor_msgs.msg")
    assert missing("dlo_ros.no_such") is None


# --- the network -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "level"),
    [
        ("ROS_DOMAIN_ID", "42", Level.OK),
        ("ROS_DOMAIN_ID", "150", Level.WARNING),
        ("ROS_DOMAIN_ID", "233", Level.WRONG),
        ("ROS_DOMAIN_ID", "left", Level.WRONG),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", Level.OK),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", Level.WRONG),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", Level.WRONG),
        ("ROS_LOCALHOST_ONLY", "1", Level.WARNING),
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", Level.WARNING),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/no/such.xml", Level.WRONG),
        ("ROS_DISTRO", "humble", Level.WARNING),
    ],
)
def test_variables_of_the_environment(name, value, level):
    assert worst(environment.network({})) == Level.OK
    found = environment.network({name: value})
    assert worst(found) == level
    assert level == Level.OK or any(name in f.text or value in f.text for f in bad(found, level))


def test_little_shared_memory_is_told(tmp_path, monkeypatch):
    assert environment.shared_memory(tmp_path / "none") == []
    monkeypatch.setattr(
        environment.shutil, "disk_usage", lambda _: SimpleNamespace(free=environment.ROOM - 1)
    )
    one(environment.shared_memory(tmp_path), "images may be lost", level=Level.WARNING)


# --- parameters ------------------------------------------------------------------------------


def test_the_bundled_parameters_are_usual():
    found, settings = judge_file(DEFAULT)
    assert worst(found) == Level.OK and settings == Settings.load(DEFAULT)


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("rod.length", 40.0, "centimetres"),
        ("rod.diameter", 0.04, "slender"),
        ("rod.density", 1.2, "g/cm^3"),
        ("rod.young_modulus", 2000.0, "MPa"),
        ("rod.young_modulus", 1e11, "weight"),
        ("gravity", [0.0, 0.0, 9.81], "z points up"),
        ("gravity", [0.0, 0.0, -1.6], "9.81"),
        ("damping.air_drag", 10.0, "honey"),
        ("damping.relaxation_time", 2.0, "milliseconds"),
        ("simulation.tolerance", 0.05, "taken for"),
        ("camera.translation", [0.0, 0.0, 120.0], "millimetres"),
        ("camera.rotation", [0.0, 0.0, 0.0, 1.0], "degrees"),
        ("camera.rotation", [-0.70710678, 0.0, 0.0, 0.70710678], "behind"),
        ("camera.rotation", [0.72, 0.0, 0.0, 0.72], "unit quaternion"),
        ("limits.bend_radius", 0.001, "radius"),
    ],
)
def test_an_unusual_value_is_told_with_what_is_meant(name, value, word):
    values = Settings.load(DEFAULT).flat() | {name: value}
    found = judge(Settings.from_mapping(values))
    assert not bad(found) and any(word in f"{f.text} {f.remedy}" for f in found), found


def test_what_cannot_be_is_wrong():
    values = Settings.load(DEFAULT).flat()
    behind = values | {"camera.translation": [0.0, 0.0, -1.2]}
    one(judge(Settings.from_mapping(behind)), "behind the camera")
    masked = values | {"vision.mask": "no/such.png"}
    one(judge(Settings.from_mapping(masked)), "vision.mask", "no/such.png")


def test_a_file_that_does_not_load_is_wrong(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text("/**:\n  ros__parameters:\n    rod: {length: -1.0}\n")
    found, settings = judge_file(file)
    assert settings is None
    one(found, "rod.length is -1")
    one(judge_file(tmp_path / "none.yaml")[0], "none.yaml")


def test_unknown_names_and_a_missing_camera_are_told(tmp_path, caplog):
    file = tmp_path / "params.yaml"
    rod = "{length: 0.4, diameter: 0.004, young_modulus: 1.0e+6, density: 2000.0, lenght: 0.4}"
    file.write_text(f"/**:\n  ros__parameters:\n    rod: {rod}\n...\n")
    found, settings = judge_file(file)
    assert settings is not None and not caplog.records  # told on the page alone
    texts = [f.text for f in bad(found, Level.WARNING)]
    assert len(texts) == 2 and "rod.lenght" in texts[0] and "no block camera" in texts[1]


# --- the graph -------------------------------------------------------------------------------


def test_a_healthy_graph():
    for settings in (None, Settings.load(DEFAULT)):
        sections = doctor.judge(HEALTHY, settings)
        assert worst(f for s in sections.values() for f in s) == Level.OK, sections
    assert "/dlo/observed 1/2" in connections(HEALTHY)[0].text


def test_an_empty_graph_is_a_warning():
    found = [f for s in doctor.judge(Graph("rmw", 5.0), None).values() for f in s]
    assert worst(found) == Level.WARNING and len(bad(found, Level.WARNING)) == 2


@pytest.mark.parametrize(
    ("sender", "listener", "word"),
    [
        ({"reliable": False}, {}, "best effort"),
        ({}, {"latched": True}, "volatile"),
        ({}, {"reliable": False}, None),
        ({"latched": True}, {}, None),
    ],
)
def test_qualities_of_service_that_do_not_match(sender, listener, word):
    ends = [Endpoint("/a", POSES, True, **sender), Endpoint("/b", POSES, False, **listener)]
    found = quality("/dlo/observed", ends)
    if word is None:
        assert not found
    else:
        one(found, word, "/b hears nothing of /a", "qos_overrides./dlo/observed.subscription")


def test_the_rule_is_that_of_the_middleware():
    pytest.importorskip("rclpy")
    from rclpy.qos import QoSCompatibility, qos_check_compatible

    from dlo_ros.nodes import qos

    profiles = (qos.RELIABLE, qos.LATCHED, qos.SENSOR)
    for publisher in profiles:
        for subscription in profiles:
            ends = [
                Endpoint(
                    name, POSES, sends, p.reliability.name == "RELIABLE",
                    p.durability.name == "TRANSIENT_LOCAL",
                )
                for name, sends, p in (("/a", True, publisher), ("/b", False, subscription))
            ]  # fmt: skip
            compatible, _ = qos_check_compatible(publisher, subscription)
            assert (compatible == QoSCompatibility.ERROR) == bool(quality("/t", ends))


def with_topic(name, *ends, **more):
    return replace(HEALTHY, topics={**HEALTHY.topics, name: ends}, **more)


def test_wrong_types():
    graph = with_topic("/left/dlo/predicted", Endpoint("/x", "geometry_msgs/msg/Pose", True))
    one(connections(graph), "geometry_msgs/msg/Pose", POSES)
    camera = with_topic("/cam/image_raw", Endpoint("/cam", "std_msgs/msg/String", True))
    one(connections(camera), "std_msgs/msg/String", level=Level.WARNING)  # none of ours
    remapped = with_topic("/shape", Endpoint("/a", POSES, True), Endpoint("/b", "x/msg/Y", False))
    one(connections(remapped), "/shape has several types", "remap")


def test_images_under_another_name():
    kind = topics.TYPES[topics.IMAGE]
    graph = with_topic(
        "/image_raw", Endpoint("/observer", kind, False, reliable=False),
        images={"/camera/image_raw": kind},
    )  # fmt: skip
    one(connections(graph), "-r /image_raw:=/camera/image_raw", "dlo.launch.py")
    drawn = replace(graph, images={"/dlo/overlay": kind})  # the observer's own
    assert not bad(connections(drawn))
    depth = replace(graph, images={"/a/depth/image_raw": kind, "/b/color": kind})
    one(connections(depth), "there is /b/color")
    heard = replace(graph, topics={**graph.topics, "/image_raw": (Endpoint("/c", kind, True),)})
    assert not bad(connections(heard))


def test_two_publishers_of_one_shape():
    graph = with_topic("/dlo/observed", *(Endpoint(f"/{n}", POSES, True) for n in "ab"))
    one(connections(graph), "2 publishers (/a, /b)")


def test_a_command_that_is_not_latched():
    graph = with_topic(
        "/dlo/command", Endpoint("/robot", topics.TYPES[topics.COMMAND], True, latched=False)
    )
    one(connections(graph), "never hears it", level=Level.WARNING)


@pytest.mark.parametrize(
    ("state", "level", "word"),
    [
        (NodeState("/observer", False, 1, "compiling, 40 %"), Level.WARNING, "40 %"),
        (NodeState("/observer", True, 1, "waiting for images"), Level.WARNING, "images"),
        (NodeState("/observer", True, 2, "failed"), Level.WRONG, "failed"),
        (NodeState("/observer", True, 3, "no image for 5 s"), Level.WARNING, "5 s"),
        (NodeState("/observer", True, None), Level.WARNING, "no word"),
        (NodeState("/observer"), Level.WRONG, "hangs"),
    ],
)
def test_what_nodes_say(state, level, word):
    (found,) = nodes(replace(HEALTHY, nodes=(state,)))
    assert found.level == level and word in f"{found.text} {found.remedy}"


def test_nodes_that_disagree():
    other = NodeState("/simulator", True, 0, "works", SHARED | {"rod.length": 0.5})
    one(nodes(replace(HEALTHY, nodes=(*NODES[:1], other))), "rod.length", "0.5", "0.4")
    second = replace(other, name="/right/simulator")  # another DLO
    assert not bad(nodes(replace(HEALTHY, nodes=(*NODES, second))))


def test_nodes_that_were_started_with_another_file():
    settings = Settings.load(DEFAULT)
    longer = replace(settings, rod=replace(settings.rod, length=0.5))
    found = nodes(HEALTHY, longer)
    one(found, "rod.length is 0.4", "0.5 in the parameter file", level=Level.WARNING)


def simulated(*, follow=True, **more):
    states = [replace(n, parameters=SHARED | {"use_sim_time": follow}) for n in NODES]
    return replace(HEALTHY, nodes=tuple(states), headers={}, **more)


def test_clocks():
    assert worst(clocks(simulated(clock={"/clock": (10.0, 12.0)}))) == Level.OK
    one(clocks(simulated()), "time stands still", "--clock")
    one(clocks(simulated(clock={"/clock": (1.0, 2.0)}, follow=False)), "without use_sim_time")
    paused = simulated(clock={"/clock": (5.0, 5.0)})
    one(clocks(paused), "stands still", level=Level.WARNING)
    players = {"/clock": tuple(Endpoint(f"/{n}", "c", True) for n in "ab")}
    one(clocks(simulated(clock={"/clock": (1.0, 2.0)}, topics=players)), "2 publishers")


def test_stamps_far_from_now():
    def stamped(topic, ahead):
        return replace(HEALTHY, headers={topic: Header("board", 1000.0 + ahead, 1000.0, 10)})

    one(clocks(stamped("/dlo/observed", 60.0)), "60.0 s ahead", "use_sim_time")
    one(clocks(stamped("/camera_info", -60.0)), "60.0 s behind", level=Level.WARNING)
    assert worst(clocks(stamped("/dlo/command", -60.0))) == Level.OK
    assert worst(clocks(stamped("/dlo/observed", -0.2))) == Level.OK


def test_frames_and_bases():
    shape = {"/dlo/observed": Header("world", 1000.0, 1000.0, 12)}
    found = bad(frames(replace(HEALTHY, headers=shape), Settings.load(DEFAULT)))
    assert [("world" in f.text, "12 control points" in f.text) for f in found] == [
        (True, False),
        (False, True),
    ]
    alone = replace(HEALTHY, frames=frozenset({"map", "camera"}))
    one(frames(alone), "'board' is in no transform", level=Level.WARNING)
    assert not frames(replace(HEALTHY, nodes=(), headers=shape))  # nothing to hold it against


# --- the tool --------------------------------------------------------------------------------


def test_the_tool_ends_with_1_where_something_is_wrong(monkeypatch, capsys, tmp_path):
    assert cli.main(["doctor", "--seconds", "0", "--params", str(DEFAULT)]) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    assert cli.main(["doctor", "--seconds", "0", "--params", str(tmp_path / "none.yaml")]) == 1
    assert "1 thing is wrong" in capsys.readouterr().out
    assert cli.main(["doctor", "--seconds", "-1"]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_the_tool_listens(monkeypatch, capsys):
    watching = pytest.importorskip("dlo_ros.nodes.graph_watch")
    monkeypatch.setattr(watching, "watch", lambda seconds: HEALTHY)
    assert cli.main(["doctor"]) == 0
    assert "/observer: works" in capsys.readouterr().out
    monkeypatch.setattr(watching, "watch", lambda seconds: simulated())
    assert cli.main(["doctor"]) == 1

    def fail(seconds):
        raise RuntimeError("failed to initialize\nrcl node")

    monkeypatch.setattr(watching, "watch", fail)
    assert cli.main(["doctor"]) == 1
    assert "ROS does not start: failed to initialize rcl node" in capsys.readouterr().out

    def without_kernels(seconds):
        raise KernelError("numba is not installed")

    monkeypatch.setattr(watching, "watch", without_kernels)
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "nothing can be heard: numba is not installed" in out and "ROS does not" not in out


def test_without_ros_the_rest_is_told(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delitem(sys.modules, "dlo_ros.nodes.graph_watch", raising=False)
    assert cli.main(["doctor"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "rclpy is not installed: the nodes" in out and "nothing can be heard without" in out
    assert "2 warnings" in out
