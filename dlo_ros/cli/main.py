# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""`dlo_ros NAME ...`: runs the nodes and tools by name, also where there is no ros2 command.

A tool is a module `dlo_ros.cli.NAME` with `add_arguments(parser)` and `run(arguments) -> int`; a
node is a module `dlo_ros.nodes.NAME` with `main(arguments) -> int`. Only the chosen one is
imported, so that tools which need no ROS run where there is none.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any

from dlo_ros import __version__
from dlo_ros.dependencies import missing
from dlo_ros.errors import (
    EXIT_DONE,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_UNUSABLE,
    DloError,
)
from dlo_ros.logs import HELP, OPTION, chosen, terminal_logging

DEBUG_VARIABLE = "DLO_ROS_DEBUG"

# Numba's function that looks up the class of a named tuple.
UNPICKLE = "_numba_unpickle"

ROS_ARGUMENTS = (
    "arguments of ROS: --params-file FILE, -p NAME:=VALUE, -r FROM:=TO, --log-level LEVEL, "
    "--enclave PATH"
)


@dataclass(frozen=True)
class Executable:
    """One name of `dlo_ros NAME` and `ros2 run dlo_ros NAME`.

    Args:
        name: the executable's name, as it is typed.
        summary: what the executable does, in one line.
        example: arguments of a typical call.
        node: whether it is a ROS node, which takes ROS arguments.
    """

    name: str
    summary: str
    example: str
    node: bool = False


EXECUTABLES: tuple[Executable, ...] = (
    Executable(
        "observer",
        "node: camera images in, observed splines out",
        "--ros-args --params-file params.yaml",
        node=True,
    ),
    Executable(
        "simulator",
        "node: imposed motion in, predicted splines out",
        "--ros-args --params-file params.yaml -p use_sim_time:=true",
        node=True,
    ),
    Executable(
        "identifier",
        "node: observed splines in, estimates of Young's modulus E and density mu out",
        "--ros-args --params-file params.yaml",
        node=True,
    ),
    Executable(
        "calibrate",
        "pictures of a chessboard or ChArUco board in, camera_info and the board's pose out",
        "--pattern chessboard:9x6:0.025 --output build/camera --board board.png views",
    ),
    Executable(
        "observe",
        "offline: a bag or image files in, observed splines out",
        "--params params.yaml --output observed.mcap recording",
    ),
    Executable(
        "predict",
        "offline: a bag's commands, or a motion from a file, in; predicted splines and forces out",
        "--params params.yaml --output predicted.mcap recording",
    ),
    Executable(
        "identify",
        "offline: bags in, the estimate of Young's modulus E and density mu out",
        "--params params.yaml --output build/estimate recording",
    ),
    Executable(
        "design",
        "ranks manipulations by their expected information about Young's modulus E and density mu, "
        "or by how well they separate two causes",
        "--params params.yaml --output build/design",
    ),
    Executable(
        "diagnose",
        "offline: bags in; the model's errors, their causes and the extended model out",
        "--params params.yaml --output build/diagnosis recording_1 recording_2",
    ),
    Executable(
        "import",
        "recordings of other robots, CSV or LeRobot's Parquet, in; a bag out",
        "--format csv --params params.yaml --output recording tables",
    ),
    Executable(
        "export",
        "the cable for MuJoCo, MJX, Gazebo, Isaac Sim or Newton, with its measured error",
        "--params build/estimate/estimate.yaml --format mjcf-chain --output cable.xml",
    ),
    Executable(
        "play",
        "plays a bag onto live topics, with /clock",
        "--rate 0.5 recording",
    ),
    Executable(
        "synthesize",
        "writes a bag of a simulated experiment, with images and the known truth",
        "config/experiments/c_shape.yaml --output build/c_shape",
    ),
    Executable(
        "doctor",
        "checks installation, ROS graph and parameters, in one page; exit status 1: an error",
        "--params params.yaml",
    ),
    Executable(
        "demo",
        "the main job end to end: a recording plays, the live nodes identify the rope",
        "--output build/demo",
    ),
)

NAMES = tuple(e.name for e in EXECUTABLES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one executable.

    Args:
        arguments: the executable's name and its own arguments; None: those of the process.

    Returns:
        Exit status: 0 done, 2 an input is unusable, 130 interrupted, 1 a defect of this program.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "_ARGCOMPLETE" in os.environ:  # a shell asks how a line may go on
        from dlo_ros.cli.completion import complete

        complete()
    try:
        status = _choose(words)
        sys.stdout.flush()
        return status
    except OSError as err:
        # Python must not complain at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(err, BrokenPipeError):  # the reader of a pipe (`| head`) has left
            return EXIT_DONE
        text = f"its output cannot be written ({err.strerror})"
        return _complain(" ".join(words[:1]), text, EXIT_UNUSABLE)


def _choose(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(overview())
        return EXIT_DONE if words else EXIT_UNUSABLE
    if words[0] == "--version":
        print(f"dlo_ros {__version__}")
        return EXIT_DONE
    chosen = next((e for e in EXECUTABLES if e.name == words[0]), None)
    if chosen is None:
        print(f"dlo_ros: '{words[0]}' is unknown; choose from {', '.join(NAMES)}", file=sys.stderr)
        return EXIT_UNUSABLE
    return _guarded(chosen, words[1:])


def overview() -> str:
    """The help text that lists all executables."""
    width = max(len(name) for name in NAMES)
    lines = [
        "usage: dlo_ros NAME [arguments]",
        "",
        "Watch, simulate and identify deformable linear objects.",
        "",
        *(f"  {e.name:<{width}}  {e.summary}" for e in EXECUTABLES),
        "",
        "dlo_ros NAME --help explains one of them; dlo_ros --version says the version.",
        "Example: dlo_ros demo --output build/demo",
    ]
    return "\n".join(lines)


def _guarded(executable: Executable, words: list[str]) -> int:
    """Run an executable so that no traceback reaches the user."""
    name = executable.name
    try:
        return _run_node(executable, words) if executable.node else _run_tool(executable, words)
    except DloError as err:
        return _complain(name, str(err), EXIT_UNUSABLE)
    except KeyboardInterrupt:
        return EXIT_DONE if executable.node else EXIT_INTERRUPTED
    except ModuleNotFoundError as err:
        message = missing(err.name or "")
        if message is None:
            return _defect(name, err)
        return _complain(name, message, EXIT_UNUSABLE)
    except BrokenPipeError:
        raise
    except OSError as err:
        where = f"{err.filename}: " if err.filename else ""
        return _complain(name, f"{where}{err.strerror or err}", EXIT_UNUSABLE)
    except Exception as err:
        return _defect(name, err)


def _defect(name: str, err: Exception) -> int:
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exception(err)
    hint = f"this is a defect of dlo_ros; {DEBUG_VARIABLE}=1 shows where"
    return _complain(name, f"{type(err).__name__}: {err} ({hint})", EXIT_FAILED)


def _complain(name: str, message: str, status: int) -> int:
    print(f"dlo_ros {name}: {' '.join(message.split())}", file=sys.stderr)
    return status


def parser_of(executable: Executable) -> argparse.ArgumentParser:
    """The parser of an executable's own arguments, whose `format_help` explains it."""
    parser = argparse.ArgumentParser(
        prog=f"dlo_ros {executable.name}",
        description=executable.summary,
        epilog=f"example: dlo_ros {executable.name} {executable.example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_arguments(executable, parser)
    return parser


def add_arguments(executable: Executable, parser: argparse.ArgumentParser) -> None:
    """Declare an executable's own arguments, and those that all have."""
    if executable.node:
        parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], help=ROS_ARGUMENTS)
    else:
        _loaded(f"dlo_ros.cli.{executable.name}").add_arguments(parser)
    parser.add_argument(OPTION, action="store_true", help=HELP)


def _loaded(name: str) -> Any:
    """A module with all that it imports, loaded without looking for garbage.

    Libraries leave none, and Python would look at their many objects again and again: a fifth of
    the time that loading takes, and as much once more while the module works.
    """
    if name not in sys.modules:
        enabled = gc.isenabled()
        gc.disable()
        try:
            return importlib.import_module(name)
        finally:
            gc.freeze()
            if enabled:
                gc.enable()
    return sys.modules[name]


def _run_tool(executable: Executable, words: list[str]) -> int:
    loading = signal.signal(signal.SIGINT, _stop)
    try:
        module = _loaded(f"dlo_ros.cli.{executable.name}")
        parsed = parser_of(executable).parse_args(words)
    except SystemExit as leaving:  # argparse has said why
        return int(leaving.code or 0)
    finally:
        signal.signal(signal.SIGINT, loading)
    before = signal.signal(signal.SIGINT, _interrupt)
    try:
        with terminal_logging(chosen(parsed.verbose)):
            return int(module.run(parsed))
    finally:
        if signal.getsignal(signal.SIGINT) is _interrupt:
            signal.signal(signal.SIGINT, before)


def _run_node(executable: Executable, words: list[str]) -> int:
    own = words[: words.index("--ros-args")] if "--ros-args" in words else words
    if "-h" in own or "--help" in own:
        parser_of(executable).print_help()
        return EXIT_DONE
    # While the libraries load there is nothing to end in order; the node takes over from here.
    before = {n: signal.signal(n, _leave) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        module = _loaded(f"dlo_ros.nodes.{executable.name}")
        return int(module.main(words))
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is _leave:
                signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Take one Ctrl-C; another one must not disturb what the first has begun to clean up.

    A compiled function that returns a named tuple calls Python to make it, and the process crashes
    where that raises. The exception is then raised in the caller's next line.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    code = frame.f_code if frame is not None else None
    making = code is not None and (code.co_name == UNPICKLE or code.co_filename.startswith("<"))
    if frame is None or frame.f_back is None or not making:
        raise KeyboardInterrupt

    def interrupt(*_: object) -> None:
        sys.settrace(None)
        raise KeyboardInterrupt

    frame.f_back.f_trace = interrupt
    sys.settrace(lambda *_: None)


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once, on request."""
    os._exit(EXIT_DONE)


def _stop(number: int, frame: FrameType | None) -> None:
    """End at once; raised within an import, an interrupt surfaces as whatever it met there."""
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
