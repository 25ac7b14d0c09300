# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A node of an installed package runs."""

import signal
import subprocess

import pytest
from installing import copied_sources, environment_of, fresh_environment, pip_install
from live_graph import DOMAIN, Client
from recordings_samples import SETTINGS

pytestmark = pytest.mark.live


@pytest.mark.slow
def test_an_installed_node_runs(tmp_path):
    prefix = tmp_path / "venv"
    pip_install(fresh_environment(prefix), copied_sources(tmp_path / "source"))
    SETTINGS.dump(tmp_path / "params.yaml")
    executable = prefix / "lib" / "dlo_ros" / "observer"
    environment = environment_of(
        prefix, ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST"
    )
    client = Client()
    with (tmp_path / "log").open("w+") as log:
        arguments = ("--ros-args", "--params-file", tmp_path / "params.yaml")
        node = subprocess.Popen(
            [executable, *arguments], env=environment, stdout=log, stderr=subprocess.STDOUT
        )
        try:
            # The installation has no bytecode yet, and kernels that compile take processors.
            client.until(lambda: "observer" in client.node.get_node_names(), 60.0, "observer")
            node.send_signal(signal.SIGINT)
            assert node.wait(timeout=20) == 0
        finally:
            client.close()
            node.kill()
        assert "Traceback" not in (tmp_path / "log").read_text()
