# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What nodes log: each problem once, diagnostics that have changed, warnings from below."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import recordings_samples as samples
from conftest import ROOT


@pytest.mark.slow
def test_logs_that_cannot_be_written_are_told_with_the_remedy(tmp_path):
    pytest.importorskip("rclpy")
    (tmp_path / "file").touch()
    done = subprocess.run(
        [sys.executable, "-m", "dlo_ros", "observer"],
        env=os.environ | {"ROS_LOG_DIR": str(tmp_path / "file" / "log")},
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.endswith("; set ROS_LOG_DIR to a folder that can be written\n")


class LoggingNode:
    """What `Health` asks of a node."""

    def __init__(self):
        self.logged = []

    def create_publisher(self, *_):
        return None

    def create_timer(self, *_, **__):
        return None

    def get_logger(self):
        return self

    def warning(self, message):
        self.logged.append(message)


def test_each_different_problem_is_logged_but_none_floods(monkeypatch):
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import diagnostics

    clock = [100.0]
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: clock[0])
    node = LoggingNode()
    health = diagnostics.Health(node, "test")
    for i in range(50):
        health.warn("dlo/command", f"time of point {i} is {i}.5 s")
        health.warn("dlo/command", "frame is map")
    assert node.logged == ["time of point 0 is 0.5 s", "frame is map"]
    clock[0] += diagnostics.REPEATED
    for word in ("a", "b", "c", "d", "e", "f"):
        health.warn("dlo/command", f"names {word}")
    health.warn("image", "too dark")
    assert node.logged[2:] == ["names a", "names b", "names c", "names d", "too dark"]


def test_diagnostics_come_out_of_turn_only_where_something_has_changed(monkeypatch):
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import diagnostics

    published, clock = [], [100.0]
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: clock[0])
    health = diagnostics.Health(LoggingNode(), "test")
    health._publisher = SimpleNamespace(publish=published.append)
    health._node.get_fully_qualified_name = lambda: "/test"
    health._node.get_clock = lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))

    def refreshed(**values: object) -> bool:
        clock[0] += 1.01 * diagnostics.FRESH
        before = len(published)
        health.values.update(values)
        health.refresh(("std", "known"))
        return len(published) > before

    health.publish()
    assert refreshed(std="unbounded", known=False)
    assert not refreshed(std="unbounded")
    assert refreshed(std=2.0)
    assert not refreshed(std=1.7) and not refreshed(other=5.0)
    assert refreshed(std=1.5)  # a quarter less than was told last
    assert refreshed(known=True) and refreshed(std=float("inf"))
    assert not refreshed(std=float("inf"))
    health.running("at work")
    assert refreshed()
    clock[0] -= 0.5 * diagnostics.FRESH
    assert not refreshed(std=1.0)  # ten a second at most
    assert published[-1].status[0].message == "at work"


def test_the_simulator_logs_what_has_visibly_changed():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.simulator import REPORTED_CHANGE, differs

    told = samples.SETTINGS
    rod = told.rod
    for factor, expected in ((1.0, False), (1.0 + 0.9 * REPORTED_CHANGE, False), (1.2, True)):
        for e, mu in ((factor, 1.0), (1.0, factor), (1.0 / factor, 1.0)):
            new = told.with_material(e * rod.young_modulus, mu * rod.density)
            assert differs(new, told) == expected, (e, mu)
    assert differs(replace(told, effects={"wall": {"offset": -1.0}}), told)


def test_warnings_from_below_reach_the_log_of_the_node(monkeypatch, capsys):
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import runtime

    heard = LoggingNode()
    monkeypatch.setattr(runtime, "get_logger", lambda name: heard)
    below = logging.getLogger("dlo_ros.rod.simulation")
    with runtime.logging_to_ros("simulator"):
        for i in range(5):
            below.warning("the equilibrium %d is unstable", i)
        below.warning("another")
    assert heard.logged == ["the equilibrium 0 is unstable", "another"]
    below.warning("afterwards")
    assert len(heard.logged) == 2
    assert "unstable" not in capsys.readouterr().err


def test_warnings_from_below_carry_the_full_name_of_the_node(monkeypatch):
    """The logger of `observer` alone is none of /left/observer, and is not on /rosout."""
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import runtime

    short, full = LoggingNode(), LoggingNode()
    monkeypatch.setattr(runtime, "get_logger", lambda name: short)
    below = logging.getLogger("dlo_ros.rod.simulation")
    with runtime.logging_to_ros("simulator") as log:
        log.speak_for(full)
        below.warning("unstable")
    assert (short.logged, full.logged) == ([], ["unstable"])


def test_steps_from_below_reach_the_log_of_the_node_on_request(monkeypatch, tmp_path):
    pytest.importorskip("rclpy")
    from dlo_ros.logs import LogChoice
    from dlo_ros.nodes import runtime

    told = []

    class Node:
        def set_level(self, level):
            told.append(level.name)

        def __getattr__(self, severity):
            return lambda text: told.append(f"{severity}: {text}")

    monkeypatch.setattr(runtime, "get_logger", lambda name: Node())
    below = logging.getLogger("dlo_ros.rod.simulation")
    with runtime.logging_to_ros("simulator", LogChoice(logging.DEBUG)):
        below.debug("a")
        below.info("b")
    with runtime.logging_to_ros("simulator", LogChoice(logging.DEBUG, str(tmp_path / "log"))):
        below.info("c")
    below.info("d")
    assert told == ["DEBUG", "debug: a", "info: b"]
    assert (tmp_path / "log").read_text().endswith("dlo_ros.rod.simulation: c\n")
