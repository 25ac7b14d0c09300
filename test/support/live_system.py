# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The three nodes as processes beside a client, and the swing that they see."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import recordings_samples as samples

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from live_graph import Client, Process

from dlo_ros.command import Command
from dlo_ros.demo.network import free_domain
from dlo_ros.parameters import Settings
from dlo_ros.spline import SplineBasis

N = 10
START = samples.START
TRUE_MODULUS = 1.0e7
GUESS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 4.0e6,
        "rod.density": 2000.0,
        "rod.control_points": N,
        "simulation.tolerance": 0.001,
    }
)
SHAPES = 75
EVERY = 40_000_000
NODES = ("observer", "simulator", "identifier")


def swing(stamp: int) -> Command:
    """One end clamped, pointing to the right; turned up and down, then held."""
    times = np.linspace(0.0, 2.0, 41)
    angle = 0.5 * np.sin(2 * math.pi * times) * np.minimum(1.0, 2.0 - times)
    rotations = np.zeros((len(times), 1, 4))
    rotations[:, 0, 1], rotations[:, 0, 3] = np.sin(angle / 2), np.cos(angle / 2)
    return Command(
        stamp=stamp,
        names=("start",),
        times=times,
        positions=np.zeros((len(times), 1, 3)),
        rotations=rotations,
        velocities=np.full((len(times), 1, 3), np.nan),
        control_points=N,
    )


def straight() -> np.ndarray:
    basis = SplineBasis(N, GUESS.rod.length)
    return np.column_stack([basis.greville, np.zeros((N, 3))])


class System:
    """The three nodes, and a client."""

    def __init__(self, folder: Path, settings: Settings, *words: str) -> None:
        params = folder / "params.yaml"
        settings.dump(params)
        self.folder = folder
        self.arguments = ("--ros-args", "--params-file", str(params), *words)
        self.domain = free_domain()
        self.started: list[Process] = []
        self.nodes = {name: self.start(name, *self.arguments) for name in NODES}
        self.client = Client(self.domain)
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        self._statuses = self.client.hear(
            "/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray"
        )

    def start(self, *words: str) -> Process:
        self.started.append(Process(self.folder, *words, domain=self.domain))
        return self.started[-1]

    def status(self, name: str) -> DiagnosticStatus | None:
        found = [s for m in self._statuses for s in m.status if s.name.startswith(f"{name}:")]
        return found[-1] if found else None

    def values(self, name: str) -> dict[str, str]:
        status = self.status(name)
        return {v.key: v.value for v in status.values} if status else {}

    def ready(self) -> None:
        self.client.wait_for_ready(*NODES)
        self._statuses.clear()  # of what came before
        self.client.until(
            lambda: all(self.status(name) for name in NODES), 10.0, "diagnostics of all nodes"
        )

    def all_alive(self) -> None:
        for name, process in self.nodes.items():
            assert process.alive, f"{name} died: {process.said}"

    def __enter__(self) -> System:
        return self

    def __exit__(self, *error: object) -> None:
        self.client.close()
        try:
            ends = {name: p.interrupt(times=2) for name, p in self.nodes.items()}
        finally:
            for process in self.started:
                process.process.kill()
        for name, process in self.nodes.items():
            assert ends[name] == 0 and "Traceback" not in process.said, f"{name}: {process.said}"


def stamp_of(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
