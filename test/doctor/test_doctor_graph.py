# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Findings of `doctor` on a graph of nodes: topics, QoS, clocks, frames, nodes that disagree."""

from dataclasses import replace

import pytest
from doctor_graphs import DEFAULT, HEALTHY, NODES, POSES, SHARED, bad, one, simulated, with_topic

from dlo_ros.cli import doctor
from dlo_ros.doctor.connections import connections, quality
from dlo_ros.doctor.finding import Level, worst
from dlo_ros.doctor.graph import Endpoint, Graph, Header, NodeState
from dlo_ros.doctor.node_states import nodes
from dlo_ros.doctor.times_and_frames import clocks, frames
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics


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
        one(found, word, "/b receives nothing from /a", "qos_overrides./dlo/observed.subscription")


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
    one(connections(graph), "never receives it", level=Level.WARNING)


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
