# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Nothing is evaluated, unpickled or handed to a shell; the demo listens to this machine only."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import pytest
import recordings_samples as samples
from conftest import ROOT

pytestmark = pytest.mark.live

FOLDERS = ("dlo_ros", "launch", "docs")
SOURCES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.is_file())
BUILTINS = {"eval", "exec", "compile", "__import__"}
ATTRIBUTES = {
    "os.system", "os.popen", "yaml.load", "yaml.full_load", "yaml.unsafe_load", "yaml.load_all",
    "pickle.load", "pickle.loads", "np.load", "numpy.load",
}  # fmt: skip
MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}


def dangers(tree: ast.AST):
    """Line and name of each construct that would run or unpack what somebody else wrote."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in BUILTINS or name in ATTRIBUTES:
                yield node.lineno, name
            for keyword in node.keywords:
                if keyword.arg in ("shell", "allow_pickle"):
                    yield node.lineno, f"{name}({keyword.arg}=...)"
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in names:
            if name.partition(".")[0] in MODULES:
                yield node.lineno, f"import {name}"


def test_no_source_evaluates_unpickles_or_uses_a_shell():
    assert len(SOURCES) > 200
    for path in SOURCES:
        found = list(dangers(ast.parse(path.read_text())))
        assert not found, f"{path.relative_to(ROOT)}: {found}"


def unquoted(script: str):
    """Lines of a shell script that evaluate a text, or expand one outside quotes."""
    for line in script.splitlines():
        code = "" if line.lstrip().startswith("#") else line
        bare = re.sub(r'"[^"]*"|\'[^\']*\'', "", code)
        if "$" in bare or "`" in code or "$(" in code or re.search(r"\beval\b", code):
            yield line


def test_the_scripts_expand_nothing_outside_quotes():
    assert SCRIPTS
    for path in SCRIPTS:
        assert not list(unquoted(path.read_text())), path.name


@pytest.mark.parametrize("line", ["exec $command", "eval x", 'echo "$(ls)"', "ls `pwd`"])
def test_the_search_of_scripts_finds_what_it_looks_for(line):
    assert list(unquoted(line)) == [line]


@pytest.mark.parametrize(
    "line",
    [
        "eval('1')",
        "yaml.load(text)",
        "subprocess.run(word, shell=True)",
        "import pickle",
        "np.load(path, allow_pickle=True)",
    ],
)
def test_the_search_above_finds_what_it_looks_for(line):
    assert list(dangers(ast.parse(line)))


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


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/udp").is_file(), reason="needs Linux's /proc")
def test_the_demos_nodes_listen_on_the_loopback_interface_only(tmp_path, monkeypatch):
    pytest.importorskip("rclpy")
    from live_graph import Client, Process

    from dlo_ros.demo.network import FIRST_PORT, PORTS, isolate

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
