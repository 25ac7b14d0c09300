# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The time before a node takes data: its kernels are compiled by other processes and loaded.

Meanwhile the node answers parameters, services and diagnostics. Its latched topic `~/ready`
(std_msgs/Bool) says whether it takes data.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from rclpy.node import Node
from std_msgs.msg import Bool

from dlo_ros.compilation import REPORT_INTERVAL, BackgroundCompilation
from dlo_ros.nodes.qos import LATCHED

LOADING = "waiting for its compiled kernels"
"""State of a node whose kernels are compiled and are being loaded; takes a second or two."""


class Preparation:
    """Compilation and loading of a node's kernels.

    Args:
        node: node whose kernels are prepared; it calls `proceed` now and then.
        stages: names in `dlo_ros.compilation.STAGES`.
        load: function that returns when the compiled kernels are loaded; it is called in a thread
            of its own.

    Raises:
        KernelError: numba is not installed, or no folder for compiled code can be written.
    """

    def __init__(self, node: Node, stages: Sequence[str], load: Callable[[], object]) -> None:
        self.done = False
        self.state = LOADING
        self.error = ""
        self._node = node
        self._load = load
        self._publisher = node.create_publisher(Bool, "~/ready", LATCHED)
        self._publisher.publish(Bool(data=False))
        self._loading: threading.Thread | None = None
        self._compilation = BackgroundCompilation(stages)
        self._compiles = self._compilation.start()
        self._began = self._reported = time.monotonic()
        if self._compiles:
            self.state = str(self._compilation.poll())
            node.get_logger().info("compiling the numerical kernels, once; other nodes share them")

    def proceed(self) -> bool:
        """Look how far the preparation is; whether it has just ended well."""
        if self.done or self.error:
            return False
        if self._loading is None:
            progress = self._compilation.poll()
            self.error = progress.error
            self.state = str(progress)
            if progress.done:
                self.state = LOADING
                self._loading = threading.Thread(target=self._run, name="loading", daemon=True)
                self._loading.start()
            elif time.monotonic() - self._reported > REPORT_INTERVAL:
                self._reported = time.monotonic()
                self._node.get_logger().info(self.state)
            return False
        if self._loading.is_alive() or self.error:
            return False
        self.done = True
        return True

    def announce(self, state: str) -> None:
        """Let the graph know that the node takes data from now on.

        Args:
            state: the node's next task, for the log.
        """
        self._publisher.publish(Bool(data=True))
        took = time.monotonic() - self._began
        compiled = f"; the kernels compiled for {took:.0f} s" if self._compiles else ""
        self._node.get_logger().info(f"ready: {state}{compiled}")

    def stop(self) -> None:
        """End what this node alone has compiled."""
        self._compilation.stop()

    def _run(self) -> None:
        try:
            self._load()
        except Exception as err:  # the node ends with it
            self.error = f"the compiled kernels cannot be loaded ({type(err).__name__}: {err})"
