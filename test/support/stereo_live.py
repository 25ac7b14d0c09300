# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Whether live nodes keep up with two cameras: `python test/support/stereo_live.py [--all] [BAG]`.

A recording of two cameras (default: the bundled `twisted`, 1280 x 720 at 30 Hz, compressed) is
played to the observer, or with --all to all three nodes, at the recording's own speed. Told are
shapes that came of the pairs that were played, latency from the stamp to the shape, and processor
time of each process for each shape. The machine's load counts: it is told, too.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from live_graph import Client, Process

from dlo_ros.demo.network import free_domain
from dlo_ros.recordings.bag import open_bag
from dlo_ros.synthesis.experiment import find_experiment, load_experiment
from dlo_ros.synthesis.synthesize import synthesize

TICKS = os.sysconf("SC_CLK_TCK")
QUIET = 3.0  # [s] after the recording, in which late shapes may come


def processor_time(pid: int) -> float:
    """Processor time of a process and its threads so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def measure(bag: Path, folder: Path, nodes: list[str], rate: float) -> None:
    """Play a bag to nodes and print what came of it."""
    with open_bag(bag) as recording:
        wanted = {c.topic: c.msgcount for c in recording.connections}
    pairs = min(n for t, n in wanted.items() if t.endswith("image_raw/compressed"))
    domain = free_domain()
    words = ("--ros-args", "--params-file", str(bag / "params.yaml"), "-p", "use_sim_time:=true")
    running = {name: Process(folder, name, *words, domain=domain) for name in nodes}
    client = Client(domain)
    try:
        client.wait_for_ready(*nodes)
        shapes = client.hear("dlo/observed")
        clock = client.hear("/clock", kind="rosgraph_msgs/msg/Clock")
        health = client.hear("/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray")
        before = {name: processor_time(p.process.pid) for name, p in running.items()}
        player = Process(folder, "play", str(bag), "--rate", str(rate), domain=domain)
        latency, count = [], 0
        quiet_since = None
        while quiet_since is None or time.monotonic() - quiet_since < QUIET:
            client.executor.spin_once(timeout_sec=0.01)
            for shape in shapes[count:]:
                stamp = shape.header.stamp
                if clock:
                    now = clock[-1].clock
                    latency.append(now.sec - stamp.sec + 1e-9 * (now.nanosec - stamp.nanosec))
            count = len(shapes)
            if quiet_since is None and not player.alive:
                quiet_since = time.monotonic()
        spent = {n: processor_time(p.process.pid) - before[n] for n, p in running.items()}
    finally:
        client.close()
        for process in running.values():
            process.interrupt(times=2)
    own = {v.key: v.value for m in health for s in m.status if "observer" in s.name
           for v in s.values}  # fmt: skip
    print(
        f"{count} shapes of {pairs} pairs at {30.0 * rate:g} Hz; latency median "
        f"{1e3 * np.median(latency):.0f} ms, 95 % {1e3 * np.quantile(latency, 0.95):.0f} ms; "
        f"processor time a shape: "
        + ", ".join(f"{n} {1e3 * s / max(count, 1):.0f} ms" for n, s in spent.items())
        + f"; dropped {own.get('dropped images')}; load {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path, nargs="?", help="a recording with params.yaml in it")
    parser.add_argument(
        "--all", action="store_true", help="all three nodes, not the observer alone"
    )
    parser.add_argument("--rate", type=float, default=1.0, help="speed, 1 is the recording's")
    arguments = parser.parse_args()
    nodes = ["observer", "simulator", "identifier"] if arguments.all else ["observer"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = arguments.bag
        if bag is None:
            bag = folder / "twisted"
            synthesize(load_experiment(find_experiment("twisted")), bag)
        measure(bag.resolve(), folder, nodes, arguments.rate)


if __name__ == "__main__":
    main()
