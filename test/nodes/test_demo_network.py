# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The demo listens to this machine only."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import recordings_samples as samples

pytest.importorskip("rclpy")
from live_graph import Client, Process

from dlo_ros.demo.network import FIRST_PORT, PORTS, isolate

pytestmark = [pytest.mark.live, pytest.mark.slow]


def udp_sockets(pid: int) -> list[tuple[str, int]]:
    """Address and port of a process's UDP sockets."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            match = re.match(r"socket:\[(\d+)\]", str(entry.readlink()))
        except OSError:
            continue
        if match:
            inodes.add(match[1])
    found = []
    for table in ("udp", "udp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                address, port = fields[1].split(":")
                parts = [str(int(address[i : i + 2], 16)) for i in (6, 4, 2, 0)]
                found.append((".".join(parts), int(port, 16)))
    return found


@pytest.mark.skipif(not Path("/proc/net/udp").is_file(), reason="needs Linux's /proc")
def test_the_demos_nodes_listen_on_the_loopback_interface_only(tmp_path, monkeypatch):
    for name in ("ROS_DOMAIN_ID", "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, "")  # so that what isolate sets is undone afterwards
    monkeypatch.delenv("ROS_LOG_DIR")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")  # as a user may have it
    monkeypatch.setenv("ROS_STATIC_PEERS", "192.0.2.7")
    domain = isolate(tmp_path)
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "ROS_STATIC_PEERS" not in os.environ
    samples.SETTINGS.dump(tmp_path / "params.yaml")
    arguments = ("--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    node, client = Process(tmp_path, "identifier", *arguments, domain=domain), Client(domain)
    try:
        client.until(lambda: client.node.count_publishers("dlo/err"), 60.0, "the node")
        ports = range(FIRST_PORT + PORTS * domain, FIRST_PORT + PORTS * (domain + 1))
        listening = [address for address, port in udp_sockets(node.process.pid) if port in ports]
        assert len(listening) >= 2 and set(listening) == {"127.0.0.1"}, listening
    finally:
        client.close()
        node.interrupt()
