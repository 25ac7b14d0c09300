# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Launch and configuration files, as far as they can be tested without a full ROS 2."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml
from fake_launch import evaluate

from dlo_ros.cli.main import EXECUTABLES
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings, read_parameter_file
from dlo_ros.recordings import topics

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config"
DLO, REPLAY = (ROOT / "launch" / f"{name}.launch.py" for name in ("dlo", "replay"))
NODES = [e.name for e in EXECUTABLES if e.node]


def started(path, **arguments):
    """The processes by executable."""
    return {p.executable: p for p in evaluate(path, **arguments).processes}


def test_the_default_parameter_file_names_every_parameter_with_its_default():
    path = CONFIG / "default.yaml"
    values = read_parameter_file(path)
    assert set(values) == set(TABLE)
    settings = Settings.load(path).flat()
    for parameter in TABLE.values():
        if parameter.default is not None:
            assert settings[parameter.name] == parameter.default, parameter.name


@pytest.mark.parametrize("path", (DLO, REPLAY), ids=lambda p: p.name)
def test_every_launch_argument_is_described_and_none_is_of_no_use(path):
    declared = evaluate(path, bag="recording").declared
    used = set(
        re.findall(r'"(\w+)"', re.sub(r"DeclareLaunchArgument\(\s*\"\w+\"", "", path.read_text()))
    )
    for name, argument in declared.items():
        assert len(argument.description) > 8, name
        assert name in used, f"{name} is declared, but not used"


def test_the_three_nodes_start_with_a_camera_of_somebody_else():
    processes = started(DLO, params_file="params.yaml")
    assert sorted(processes) == sorted(NODES)
    for name, process in processes.items():
        assert process.package == "dlo_ros" and process.namespace == ""
        assert process.parameters == ("params.yaml", {"use_sim_time": False})
        assert process.ros_arguments == ("--log-level", "info", "--enclave", f"/dlo/{name}")
    assert started(DLO)["observer"].parameters[0] == str(CONFIG / "default.yaml")


def test_namespace_camera_and_images_reach_the_nodes():
    arguments = {
        "namespace": "left", "image": "/cam/image_raw", "camera_info": "/cam/camera_info",
        "video_device": "/dev/video2", "large_images": "true", "use_sim_time": "true",
        "log_level": "debug", "enclave": "/left",
    }  # fmt: skip
    context = evaluate(DLO, **arguments)
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


def test_a_bag_plays_into_the_namespace_on_simulated_time():
    processes = started(DLO, bag="recording", rate="0.5", namespace="left")
    player = processes["play"]
    assert set(processes) == {*NODES, "play"} and not player.ends_all
    assert player.arguments == ("recording", "--rate", "0.5")
    for name in NODES:
        assert processes[name].parameters[1] == {"use_sim_time": True}
    remapped = player.remappings
    assert remapped["/dlo/command"] == "left/dlo/command"
    assert remapped["/image_raw/compressed"] == "left/image_raw/compressed"
    # What the nodes make anew must not meet what they made when it was recorded.
    assert remapped["/dlo/observed"] == "left/recorded/dlo/observed"
    assert {name.lstrip("/") for name in remapped} == set(topics.TYPES)


def test_replay_is_for_watching_and_ends_with_the_recording():
    processes = started(REPLAY, bag="recording", params_file="params.yaml")
    assert set(processes) == {*NODES, "play", "rviz2"} and processes["play"].ends_all
    assert processes["rviz2"].arguments == ("-d", str(CONFIG / "dlo.rviz"))
    given = started(REPLAY, bag="recording", rviz="false", stay="true", observe="false")
    assert "rviz2" not in given and not given["play"].ends_all
    remapped = given["play"].remappings
    assert remapped["/dlo/observed"] == "/dlo/observed"
    assert remapped["/dlo/predicted"] == "/recorded/dlo/predicted"
    with pytest.raises(AssertionError, match="bag must be given"):
        evaluate(REPLAY)


@pytest.mark.parametrize("name", ["large_images", "this_machine"])
def test_profiles_of_fast_dds_are_well_formed(name):
    root = ElementTree.parse(CONFIG / f"fastdds_{name}.xml").getroot()
    texts = {e.tag.partition("}")[2]: (e.text or "").strip() for e in root.iter()}
    assert texts["segment_size"] == str(64 * 1024 * 1024)
    assert texts.get("address") == ("127.0.0.1" if name == "this_machine" else None)


# --- what other tools show -------------------------------------------------------------------


def known(topic: str) -> bool:
    return topic == "/diagnostics" or topic.lstrip("/") in topics.TYPES


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
