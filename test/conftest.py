# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the tests share: a quiet, local ROS graph of their own, and the folder of measured data."""

import os
from pathlib import Path

import pytest

from dlo_ros.compilation import compile_first
from dlo_ros.demo import network
from dlo_ros.kernel_parts import STAGES

ROOT = Path(__file__).resolve().parent.parent

# Before any test imports rclpy: messages with wrong field types fail, and nothing leaves this
# machine, whatever the user's shell says. Each run of the tests has a domain of its own, so that
# two may run side by side.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_STATIC_PEERS", None)
if "PYTEST_XDIST_WORKER" in os.environ:  # workers inherit the domain of the run
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    # Two workers that look for a free domain at once must not find the same.
    worker = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    network.DOMAINS = network.DOMAINS[worker :: int(os.environ["PYTEST_XDIST_WORKER_COUNT"])]
os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Measured recordings beside the repository; the test is skipped where they are absent."""
    folder = Path(os.environ.get("DLO_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"measured data are not at {folder} (DLO_SHARED_DATA says where)")
    return folder


@pytest.fixture(scope="module", autouse=True)
def compiled_kernels(request: pytest.FixtureRequest) -> None:
    """Before nodes run against deadlines; a fresh workspace of `colcon test` has none."""
    if request.node.get_closest_marker("live"):
        compile_first(tuple(STAGES), print)


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory):
    """Nodes on wall time that nothing was sent to yet."""
    from live_system import GUESS, System  # needs rclpy

    with System(tmp_path_factory.mktemp("waiting"), GUESS) as system:
        system.ready()
        yield system


@pytest.fixture
def same_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every run takes the same steps and solves them exactly."""
    monkeypatch.setattr("dlo_ros.rod.integration.STEP_SHARE", 1e3)
    monkeypatch.setattr("dlo_ros.rod.integration.NEWTON_SHARE", 1e-11)
    monkeypatch.setattr("dlo_ros.command.Command.corners", lambda command, *_: command.times)
