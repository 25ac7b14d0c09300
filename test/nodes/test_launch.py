# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Launch and configuration files, as far as they can be tested without a full ROS 2."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import recordings_samples as samples
import yaml
from fake_launch import evaluate

from dlo_ros.cli.main import EXECUTABLES
from dlo_ros.parameter_file import read_parameter_file
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
DLO, REPLAY = (ROOT / "launch" / f"{name}.launch.py" for name in ("dlo", "replay"))
NODES = [e.name for e in EXECUTABLES if e.node]
FOR = "--wait-for"


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> dict[str, str]:
    """Files that a launch may be given: parameters and three recordings."""
    folder = tmp_path_factory.mktemp("given")
    samples.SETTINGS.dump(folder / "params.yaml")
    everything, others = samples.messages(), [("/other", samples.messages()[0][1], 5)]
    kinds = {
        "recording": everything,
        "splines": samples.messages(images=False),
        "images": [m for m in everything if not m[0].startswith("/dlo/observed")],
        "neither": others,
    }
    bags = {name: str(samples.write_plain(folder / name, m)) for name, m in kinds.items()}
    return bags | {"params": str(folder / "params.yaml")}


def started(path, installed=(), **arguments):
    """The processes by executable."""
    return {p.executable: p for p in evaluate(path, installed=installed, **arguments).processes}


def test_the_default_parameter_file_names_every_parameter_with_its_default():
    path = CONFIG / "default.yaml"
    values = read_parameter_file(path)
    assert set(values) == set(TABLE)
    settings = Settings.load(path).flat()
    for parameter in TABLE.values():
        if parameter.default is not None:
            assert settings[parameter.name] == parameter.default, parameter.name


@pytest.mark.parametrize("path", (DLO, REPLAY), ids=lambda p: p.name)
def test_every_launch_argument_is_described_and_none_is_of_no_use(path, given):
    declared = evaluate(path, bag=given["recording"]).declared
    used = set(
        re.findall(
            r"[\"'](\w+)[\"']", re.sub(r"DeclareLaunchArgument\(\s*\"\w+\"", "", path.read_text())
        )
    )
    for name, argument in declared.items():
        assert len(argument.description) > 8, name
        assert name in used, f"{name} is declared, but not used"


def test_what_both_launch_files_take_is_the_same_but_for_how_a_replay_ends(given):
    """The values of replay's arguments win, so that a default that differs must be meant."""
    dlo, replay = (evaluate(path, bag=given["recording"]).values for path in (DLO, REPLAY))
    differ = {name for name in replay if replay[name] != dlo[name]}
    assert set(replay) < set(dlo) and differ == {"stay", "rviz"}


def test_the_three_nodes_start_with_a_camera_of_somebody_else(given):
    processes = started(DLO, params_file=given["params"])
    assert sorted(processes) == sorted(NODES)
    for name, process in processes.items():
        assert process.package == "dlo_ros" and process.namespace == ""
        assert process.parameters == (given["params"], {"use_sim_time": False})
        assert process.ros_arguments == ("--log-level", "info", "--enclave", f"/dlo/{name}")
        # The clock of somebody else's simulation keeps its name.
        assert "/clock" not in process.remappings


def test_splines_that_somebody_else_publishes_need_no_observer(given):
    """Such as `ros2 bag play` of a recording."""
    processes = started(DLO, params_file=given["params"], observe="false")
    assert set(processes) == {"simulator", "identifier"}


def test_without_a_parameter_file_it_is_said_that_the_rope_is_an_example(given, caplog):
    assert started(DLO)["observer"].parameters[0] == str(CONFIG / "default.yaml")
    (said,) = caplog.records
    assert said.levelname == "WARNING" and "EXAMPLE rope (0.4 m long, 4 mm thick)" in said.message
    rod = Settings.load(CONFIG / "default.yaml").rod
    assert (rod.length, rod.diameter) == (0.4, 0.004)
    caplog.clear()
    started(DLO, params_file=given["params"])
    assert not caplog.records


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"params_file": "/none.yaml"}, "params_file:=/none.yaml: no such file"),
        ({"bag": "/none"}, "bag:=/none: no such bag"),
        ({"bag": "neither"}, "holds neither images nor dlo/observed"),
        ({"bag": "splines", "observe": "true"}, "holds no images; give observe:=false"),
        ({"bag": "images", "observe": "false"}, "holds no dlo/observed; give observe:=true"),
        ({"bag": "images", "observe": "no"}, "observe:=no: give auto, true or false"),
        ({"bag": "images", "stay": ""}, "stay:=: give true or false"),
        ({"rviz": "true"}, "rviz needs the package rviz2, which is not installed"),
        ({"video_device": "/dev/video0"}, "install ros-$ROS_DISTRO-v4l2-camera"),
    ],
)
def test_what_cannot_be_is_told_before_anything_starts(given, arguments, reason):
    if "bag" in arguments:
        arguments = arguments | {"bag": given.get(arguments["bag"], arguments["bag"])}
    with pytest.raises(RuntimeError) as caught:
        evaluate(DLO, **arguments)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_namespace_camera_and_images_reach_the_nodes():
    arguments = {
        "namespace": "left", "image": "/cam/image_raw", "camera_info": "/cam/camera_info",
        "video_device": "/dev/video2", "large_images": "true", "use_sim_time": "true",
        "log_level": "debug", "enclave": "/left",
    }  # fmt: skip
    context = evaluate(DLO, installed={"v4l2_camera"}, **arguments)
    processes = {p.executable: p for p in context.processes}
    assert set(processes) == {*NODES, "v4l2_camera_node"}
    assert {p.namespace for p in processes.values()} == {"left"}
    wanted = {
        "image_raw": "/cam/image_raw",
        "image_raw/compressed": "/cam/image_raw/compressed",
        "camera_info": "/cam/camera_info",
    }
    for name in ("observer", "v4l2_camera_node"):
        assert processes[name].remappings == wanted
    for name in NODES:
        assert processes[name].parameters[1] == {"use_sim_time": True}
        assert processes[name].ros_arguments[-1] == f"/left/{name}"
    camera = {"video_device": "/dev/video2", "camera_info_url": ""}
    assert processes["v4l2_camera_node"].parameters == (camera,)
    assert Path(context.environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()


def test_a_bag_plays_into_the_namespace_on_simulated_time_of_its_own(given):
    processes = started(DLO, bag=given["recording"], rate="0.5", namespace="left")
    player = processes["play"]
    assert set(processes) == {*NODES, "play"} and not player.ends_all
    waits = [word for name in ("observer", "simulator", "identifier") for word in (FOR, name)]
    assert player.arguments == (given["recording"], "--rate", "0.5", "--wait", "600.0", *waits)
    assert {p.namespace for p in processes.values()} == {"left"}
    for name in NODES:
        assert processes[name].parameters[1] == {"use_sim_time": True}
    # Relative names are names in the namespace.
    assert {p.remappings["/clock"] for p in processes.values()} == {"clock"}
    remapped = player.remappings
    assert remapped["/dlo/command"] == "dlo/command"
    assert remapped["/image_raw/compressed"] == "image_raw/compressed"
    # What the nodes make anew must not meet what they made when it was recorded.
    assert remapped["/dlo/observed"] == "recorded/dlo/observed"
    assert {name.lstrip("/") for name in remapped} == {*topics.TYPES, "clock"}


def test_recorded_splines_are_played_without_observer_and_images(given):
    for bag, observe in (("recording", "false"), ("splines", "false"), ("splines", "auto")):
        processes = started(DLO, bag=given[bag], observe=observe)
        assert set(processes) == {"simulator", "identifier", "play"}
        player = processes["play"]
        assert player.arguments[-5:] == (FOR, "simulator", FOR, "identifier", "--no-images")
        assert player.remappings["/dlo/observed"] == "dlo/observed"
        assert player.remappings["/dlo/predicted"] == "recorded/dlo/predicted"
    for bag, observe in (("recording", "true"), ("images", "auto")):
        processes = started(DLO, bag=given[bag], observe=observe)
        assert set(processes) == {*NODES, "play"}
        assert "--no-images" not in processes["play"].arguments


def test_a_recording_without_an_index_is_left_to_the_player(given, tmp_path):
    """Which can say what is wrong with it."""
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: 1")
    assert set(started(DLO, bag=str(tmp_path))) == {*NODES, "play"}
    (file,) = Path(given["splines"]).glob("*.mcap")
    assert set(started(DLO, bag=str(file), observe="false")) == {"simulator", "identifier", "play"}


@pytest.mark.parametrize("name", [*NODES, "play", "v4l2_camera_node"])
def test_a_process_that_ends_with_an_error_ends_the_launch_with_one(given, name):
    context = evaluate(
        DLO,
        installed={"v4l2_camera"},
        video_device="/dev/video0",
        bag=given["recording"],
        stay="false",
    )
    (process,) = [p for p in context.processes if p.executable == name]
    with pytest.raises(RuntimeError, match=f"{name} ended with status 2"):
        process.on_exit(2)
    assert process.ends_all == (name == "play")
    for interrupted in (-2, 130):  # launch is told of a Ctrl-C as well, a moment later
        assert len(process.on_exit(interrupted)) == 1
    context.is_shutdown = True
    assert process.on_exit(2) == []


def test_replay_is_for_watching_and_ends_with_the_recording(given, monkeypatch):
    here = {"bag": given["recording"], "params_file": given["params"], "installed": {"rviz2"}}
    monkeypatch.setenv("DISPLAY", ":0")
    processes = started(REPLAY, **here)
    assert set(processes) == {*NODES, "play", "rviz2"} and processes["play"].ends_all
    assert processes["rviz2"].arguments == ("-d", str(CONFIG / "dlo.rviz"))
    assert processes["rviz2"].remappings == {"/clock": "clock"}
    silent = started(REPLAY, **here, rviz="false", stay="true")
    assert "rviz2" not in silent and not silent["play"].ends_all
    with pytest.raises(AssertionError, match="bag must be given"):
        evaluate(REPLAY)


def test_rviz_shows_where_it_can(given, monkeypatch, caplog):
    caplog.set_level("INFO")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for display, installed, reason in (
        (":0", (), "without RViz: rviz2 is not installed"),
        ("", ("rviz2",), "without RViz: there is no display"),
    ):
        monkeypatch.setenv("DISPLAY", display)
        caplog.clear()
        processes = started(
            REPLAY, installed=installed, bag=given["recording"], params_file=given["params"]
        )
        assert "rviz2" not in processes and caplog.messages == [reason]
    # Who asks for it gets it, or is told why not.
    assert "rviz2" in started(DLO, installed=("rviz2",), rviz="true", params_file=given["params"])


@pytest.mark.parametrize(("headless", "wanted"), [("", True), ("1", False)])
def test_optional_packages_are_declared_and_left_out_where_there_is_no_display(headless, wanted):
    package = pytest.importorskip("catkin_pkg.package").parse_package(str(ROOT / "package.xml"))
    package.evaluate_conditions({"ROS_DISTRO": "jazzy", "DLO_ROS_HEADLESS": headless})
    named = {d.name: d.evaluated_condition for d in package.exec_depends}
    assert named["rviz2"] is wanted and named["v4l2_camera"] and named["rclpy"]


@pytest.mark.parametrize("name", ["large_images", "this_machine"])
def test_profiles_of_fast_dds_are_well_formed(name):
    root = ElementTree.parse(CONFIG / f"fastdds_{name}.xml").getroot()
    texts = {e.tag.partition("}")[2]: (e.text or "").strip() for e in root.iter()}
    assert texts["segment_size"] == str(64 * 1024 * 1024)
    assert texts.get("address") == ("127.0.0.1" if name == "this_machine" else None)


# --- what other tools show -------------------------------------------------------------------


def known(topic: str) -> bool:
    return topic == "/diagnostics" or topic.lstrip("/") in topics.TYPES


def test_rviz_shows_space_where_there_are_several_cameras(given, tmp_path):
    params = tmp_path / "params.yaml"
    params.write_text("/**: {ros__parameters: {vision: {cameras: [left, top, back]}}}")
    here = {"installed": {"rviz2"}, "rviz": "true", "params_file": str(params)}
    rviz = started(DLO, **here)["rviz2"]
    assert rviz.arguments == ("-d", str(CONFIG / "dlo_space.rviz"))
    assert rviz.remappings == {"right/dlo/overlay": "top/dlo/overlay"}
    params.write_text("/**: {ros__parameters: {vision.cameras: [a, right]}}")
    assert started(DLO, **here)["rviz2"].remappings == {"left/dlo/overlay": "a/dlo/overlay"}
    for text in ("/**: {ros__parameters: {vision: 3}}", "- [", "just words", ""):
        params.write_text(text)
        assert started(DLO, **here)["rviz2"].arguments == ("-d", str(CONFIG / "dlo.rviz"))


def test_rviz_in_space_looks_at_the_topics_of_the_interface():
    view = yaml.safe_load((CONFIG / "dlo_space.rviz").read_text())["Visualization Manager"]
    shown = {d["Topic"]["Value"] for d in view["Displays"] if "Topic" in d}
    overlays = {topics.of_camera(name, topics.OVERLAY) for name in ("left", "right")}
    assert shown == {topics.MARKERS, topics.OBSERVED_POINTS, *overlays}
    assert "rviz_default_plugins/TF" in [d["Class"] for d in view["Displays"]]
    assert view["Global Options"]["Fixed Frame"] == TABLE["frame_id"].default


def test_rviz_looks_at_the_topics_of_the_interface():
    """Relative ones, so that RViz in a namespace shows the DLO of that namespace."""
    view = yaml.safe_load((CONFIG / "dlo.rviz").read_text())["Visualization Manager"]
    shown = {d["Topic"]["Value"] for d in view["Displays"] if "Topic" in d}
    assert shown == {topics.MARKERS, topics.OVERLAY, topics.OBSERVED_POINTS}
    assert view["Global Options"]["Fixed Frame"] == TABLE["frame_id"].default


def test_plotjuggler_plots_what_the_interface_has():
    root = ElementTree.parse(CONFIG / "plotjuggler_layout.xml").getroot()
    subscribed = root.find(".//selected_topics").get("value").split(";")
    assert all(known(topic) for topic in subscribed)
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert len(curves) == 7
    for curve in curves:
        (topic,) = [t for t in subscribed if curve.startswith(t + "/")]
        field = curve.removeprefix(topic + "/")
        kind = topics.TYPES[topic.lstrip("/")]
        expected = {
            "std_msgs/msg/Float64": r"data",
            "geometry_msgs/msg/PoseArray": r"poses\[9\]/position/[xz]",
        }
        assert re.fullmatch(expected[kind], field), curve
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.get("count")) == len(splitter) == len(splitter.get("sizes").split(";"))


def test_foxglove_shows_what_the_interface_has():
    layout = json.loads((CONFIG / "foxglove_layout.json").read_text())
    panels = layout["configById"]

    def placed(node):
        return {node} if isinstance(node, str) else placed(node["first"]) | placed(node["second"])

    assert placed(layout["layout"]) == set(panels)
    shown = set(panels["3D!dlo"]["topics"])
    shown.add(panels["Image!overlay"]["imageMode"]["imageTopic"])
    shown.add(panels["DiagnosticSummary!health"]["topicToRender"])
    for panel in panels.values():
        shown |= {path["value"].partition(".")[0] for path in panel.get("paths", [])}
    assert all(known(topic) for topic in shown)
    assert {"/dlo/err", "/dlo/young_modulus", "/dlo/density", "/dlo/markers"} < shown


def test_the_aggregator_finds_each_node_whatever_its_namespace():
    tree = yaml.safe_load((CONFIG / "diagnostics_aggregator.yaml").read_text())
    parameters = tree["analyzers"]["ros__parameters"]
    analyzers = {k: v for k, v in parameters.items() if isinstance(v, dict)}
    assert set(analyzers) == set(NODES)
    for name, analyzer in analyzers.items():
        code = (ROOT / "dlo_ros" / "nodes" / f"{name}.py").read_text()
        _, task = re.search(r'super\(\).__init__\("(\w+)", "(\w+)"', code).groups()
        assert analyzer["contains"] == [f"{name}: {task}"]
        assert analyzer["type"] == "diagnostic_aggregator/GenericAnalyzer"
