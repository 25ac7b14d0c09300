# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Start, event loop and end of a node, such that neither an error nor Ctrl-C shows a traceback."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dlo_ros.errors import EXIT_DONE, EXIT_UNUSABLE, DloError
from dlo_ros.logs import PACKAGE, WARNINGS, LogChoice, chosen, package_logging, without_option
from dlo_ros.parameter_file import parameter_blocks

SIGNALS = (signal.SIGINT, signal.SIGTERM)


PATIENCE = 3.0
"""Seconds that a node which is still being built may take to end by itself."""


REPEATED = 5.0
"""Seconds before the same place in the code may warn again."""


LOG = "log directory"
"""What ROS complains of where it may not write in the home folder."""


class RosLog(logging.Handler):
    """Passes messages of the package's modules below the nodes to the node's log.

    Args:
        name: name of the node.
        level: lowest level of `logging` that is passed on.
    """

    def __init__(self, name: str, level: int = logging.WARNING) -> None:
        super().__init__(level)
        self._use(get_logger(name))
        self._last: dict[tuple[str, int], float] = {}

    def speak_for(self, node: Node) -> None:
        """Log under the full name of the node from now on; others do not appear on /rosout."""
        self._use(node.get_logger())

    def _use(self, logger: Any) -> None:
        self._logger = logger
        if self.level < logging.INFO:
            logger.set_level(LoggingSeverity.DEBUG)

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a message on; a warning of the same place only now and then."""
        # rclpy refuses one place in the code that logs with two severities.
        if record.levelno < logging.INFO:
            self._logger.debug(record.getMessage())
            return
        if record.levelno < logging.WARNING:
            self._logger.info(record.getMessage())
            return
        place, now = (record.pathname, record.lineno), time.monotonic()
        if now - self._last.get(place, -REPEATED) >= REPEATED:
            self._last[place] = now
            self._logger.warning(record.getMessage())


class Stop:
    """A request to end the process (Ctrl-C, or SIGTERM of a launch file).

    Args:
        interrupts: whether the first signal raises KeyboardInterrupt. Nodes only note it: raised
            inside a callback of some library it would be printed there, and `ros2 launch` sends a
            second one for the same Ctrl-C.
    """

    def __init__(self, interrupts: bool) -> None:
        self.requested = False
        self.building = not interrupts
        self._interrupts = interrupts

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        first, self.requested = not self.requested, True
        if not first:
            return
        if self._interrupts:
            raise KeyboardInterrupt
        if self.building:
            # Compiling takes long, and there is nothing yet that could be lost.
            patience = threading.Timer(PATIENCE, os._exit, (EXIT_DONE,))
            patience.daemon = True
            patience.start()


@contextmanager
def ros(arguments: Sequence[str], *, interrupts: bool = True) -> Iterator[Stop]:
    """ROS started, with signals that end it quietly; shut down on leaving.

    Args:
        interrupts: whether Ctrl-C raises KeyboardInterrupt, or is noted in `requested` only.
    """
    stop = Stop(interrupts)
    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        yield stop
    finally:
        with suppress(Exception):
            rclpy.try_shutdown()
        for number, handler in before.items():
            # After one Ctrl-C another one must not kill the process on its way out.
            signal.signal(number, signal.SIG_IGN if stop.requested else handler)


@contextmanager
def logging_to_ros(name: str, choice: LogChoice = WARNINGS) -> Iterator[RosLog]:
    """The package's warnings, and what was chosen besides, go to the log of a node.

    Raises:
        InputError: the chosen file cannot be written.
    """
    logger, handler = logging.getLogger(PACKAGE), RosLog(name, choice.shown)
    logger.addHandler(handler)
    try:
        with package_logging(choice):
            yield handler
    finally:
        logger.removeHandler(handler)


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
        name: name of the executable, for messages.
        make: builds the node, after ROS was started.
        arguments: arguments of the command line without the program's name; None: those of the
            process.

    Returns:
        Exit status: 0 ended on request, 2 a parameter or argument is unusable.
    """
    words, verbose = without_option(list(sys.argv[1:] if arguments is None else arguments))
    try:
        choice = chosen(verbose)
        for flag, path in pairwise(words):
            if flag == "--params-file":
                parameter_blocks(Path(path))  # whose messages a person understands
        with ros(words, interrupts=False) as stop, logging_to_ros(name, choice) as log:
            unknown = remove_ros_args(words)
            if unknown:
                return complain(
                    name, f"unknown argument '{unknown[0]}'; ROS arguments follow --ros-args"
                )
            node = make()
            log.speak_for(node)
            stop.building = False
            try:
                spin(node, stop, lambda: node.failure is not None)
                if node.failure is not None:
                    raise node.failure
            finally:
                with suppress(Exception):
                    node.destroy_node()
    except KeyboardInterrupt:
        return EXIT_DONE
    except DloError as err:
        return complain(name, str(err))
    except Exception as err:
        # ROS refuses arguments, parameter files, names and security settings by many exceptions.
        if not type(err).__module__.startswith("rclpy"):
            raise
        remedy = "; set ROS_LOG_DIR to a folder that can be written" if LOG in str(err) else ""
        return complain(name, f"{err}{remedy}")
    return EXIT_DONE


def complain(name: str, message: str) -> int:
    """Write one line to stderr; returns the exit status that goes with it."""
    print(f"dlo_ros {name}: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_UNUSABLE
