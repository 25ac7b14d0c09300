"""Starting, spinning and ending a node so that neither an error nor Ctrl-C shows a traceback."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dlo_ros.errors import DloError

DONE = 0
UNUSABLE = 2
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stop:
    """Whether somebody asked the process to end (Ctrl-C, or SIGTERM of a launch file).

    While a node is being built the first signal interrupts it; afterwards signals set a flag only,
    so that a second one, which `ros2 launch` sends for the same Ctrl-C, cannot disturb the ending.
    """

    def __init__(self) -> None:
        self.requested = False
        self.interrupts = True

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        self.requested = True
        if self.interrupts:
            self.interrupts = False
            raise KeyboardInterrupt


@contextmanager
def ros(arguments: Sequence[str]) -> Iterator[Stop]:
    """ROS started, with signals that end it quietly; shut down on leaving."""
    stop = Stop()
    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        yield stop
    finally:
        stop.interrupts = False
        with suppress(Exception):
            rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)


def spin(node: Node, stop: Stop, done: Callable[[], bool] = lambda: False) -> None:
    """Run the node's callbacks until it is asked to stop or `done` says so."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stop.requested and not done() and rclpy.ok():
            # Python runs signal handlers between two calls only, hence the time limit.
            try:
                executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                break
            except Exception as err:
                # A request that rclpy's own services choke on must not end the node.
                node.get_logger().error(f"a request failed ({type(err).__name__}: {err})")
                time.sleep(0.01)
    finally:
        executor.remove_node(node)
        with suppress(Exception):
            executor.shutdown(timeout_sec=1.0)


def run(name: str, make: Callable[[], Any], arguments: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C.

    Args:
        name: of the executable, for messages.
        make: builds the node, after ROS was started.
        arguments: of the command line without the program's name; those of the process where None.

    Returns:
        Exit status: 0 ended on request, 2 a parameter or argument is unusable.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with ros(words) as stop:
            unknown = remove_ros_args(words)
            if unknown:
                return complain(
                    name, f"unknown argument '{unknown[0]}'; ROS arguments follow --ros-args"
                )
            node = make()
            stop.interrupts = False
            try:
                spin(node, stop)
            finally:
                with suppress(Exception):
                    node.destroy_node()
    except KeyboardInterrupt:
        return DONE
    except DloError as err:
        return complain(name, str(err))
    except Exception as err:
        # ROS refuses arguments, parameter files, names and security settings by many exceptions.
        if not type(err).__module__.startswith("rclpy"):
            raise
        return complain(name, str(err))
    return DONE


def complain(name: str, message: str) -> int:
    """Write one line to stderr; returns the exit status that goes with it."""
    print(f"dlo_ros {name}: {' '.join(message.split())}", file=sys.stderr)
    return UNUSABLE
