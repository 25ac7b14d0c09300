# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Processes of the demo: children that end or do not listen, their domain, this machine only."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dlo_ros.demo import processes
from dlo_ros.demo.network import FIRST_PORT, PORTS, free_domain, isolate, looks_free
from dlo_ros.demo.processes import Children, ProcessError


def child(children, code, monkeypatch):
    """Start a Python program in the place of an executable of the package."""
    real = subprocess.Popen

    def popen(command, **options):
        return real([sys.executable, "-c", code], **options)

    monkeypatch.setattr(subprocess, "Popen", popen)
    return children.start("observer", [])


def wait_for(path, text, seconds=10.0):
    deadline = time.monotonic() + seconds
    while text not in path.read_text():
        assert time.monotonic() < deadline, f"{path} never said {text!r}: {path.read_text()!r}"
        time.sleep(0.01)


READY = "import signal, time, sys; print('ready', flush=True)\n"


def test_children_are_interrupted_first(tmp_path, monkeypatch):
    # A shell that runs the tests in the background ignores interrupts, and so would a child.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code = (
        listen
        + READY
        + ("try: time.sleep(60)\nexcept KeyboardInterrupt: print('interrupted'); sys.exit(0)")
    )
    with Children(tmp_path, os.environ) as children:
        started = child(children, code, monkeypatch)
        wait_for(started.log, "ready")
        children.check()
    assert started.process.returncode == 0
    assert "interrupted" in started.log.read_text()


def test_children_that_do_not_listen_are_ended_by_force(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "INTERRUPT_TIMEOUT", 0.2)
    monkeypatch.setattr(processes, "TERMINATE_TIMEOUT", 0.2)
    code = "import signal\nfor s in (2, 15): signal.signal(s, signal.SIG_IGN)\n" + READY
    with pytest.raises(ZeroDivisionError), Children(tmp_path, os.environ) as children:
        started = child(children, code + "time.sleep(60)", monkeypatch)
        wait_for(started.log, "ready")
        raise ZeroDivisionError
    assert started.process.returncode == -signal.SIGKILL


def test_a_dead_child_is_named_with_its_last_words(tmp_path, monkeypatch):
    code = "print('one'); print('rod.length is missing'); exit(2)"
    with Children(tmp_path, os.environ) as children:
        started = child(children, code, monkeypatch)
        started.process.wait()
        with pytest.raises(ProcessError, match=r"observer ended with status 2: .*rod.length is"):
            children.check()


def test_a_child_that_should_run_may_not_end_well_either(tmp_path, monkeypatch):
    with Children(tmp_path, os.environ) as children:
        started = child(children, "pass", monkeypatch)
        started.process.wait()
        children.check(started)
        with pytest.raises(ProcessError, match="status 0: it printed nothing"):
            children.check()


def test_a_used_domain_is_seen():
    domain = free_domain()
    assert 1 <= domain <= 101
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", FIRST_PORT + PORTS * domain + 10))
        assert not looks_free(domain)
    assert looks_free(domain)


def test_nothing_leaves_this_machine(tmp_path, monkeypatch):
    for name in ("ROS_DOMAIN_ID", "ROS_LOG_DIR", "ROS_STATIC_PEERS"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    domain = isolate(tmp_path)
    assert os.environ["ROS_DOMAIN_ID"] == str(domain) and 1 <= domain <= 101
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "ROS_STATIC_PEERS" not in os.environ
    profile = Path(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text()
    assert re.findall(r"<address>(.*)</address>", profile) == ["127.0.0.1"]
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert isolate(tmp_path) == 42  # the user's choice
