# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Logging of the steps of tools and nodes: `--verbose` and the variable `DLO_ROS_LOG`.

Modules write to `logging.getLogger(__name__)`: warnings are for the user and always shown, `info`
are the steps of a computation, `debug` what happened within a step.
"""

from __future__ import annotations

import logging
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from dlo_ros.errors import InputError

VARIABLE = "DLO_ROS_LOG"
OPTION = "--verbose"
HELP = f"log each step on stderr; more, or into a file, by {VARIABLE}=debug|info|warning[:FILE]"

PACKAGE = "dlo_ros"
LEVELS: Mapping[str, int] = {
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warning": logging.WARNING,
}


@dataclass(frozen=True)
class LogChoice:
    """The user's choice of log level and file.

    Args:
        level: lowest level of `logging` at which messages are shown.
        file: file to which messages are added; empty: the terminal, or the node's log.
    """

    level: int
    file: str = ""

    @property
    def shown(self) -> int:
        """Level from which messages appear on the terminal, or in the node's log."""
        return logging.WARNING if self.file else self.level


def chosen(verbose: bool, variables: Mapping[str, str] = os.environ) -> LogChoice:
    """The user's choice.

    Args:
        verbose: whether `--verbose` was given, which logs at least the steps.
        variables: the environment's variables.

    Raises:
        InputError: the variable cannot be understood.
    """
    text = variables.get(VARIABLE, "")
    name, _, file = text.partition(":")
    if name and name.lower() not in LEVELS:
        raise InputError(
            f"{VARIABLE} is '{text}'; give {', '.join(LEVELS)}, with :FILE for a file, "
            "such as debug:steps.log"
        )
    level = LEVELS[name.lower()] if name else logging.WARNING
    return LogChoice(min(level, logging.INFO) if verbose else level, file)


def without_option(words: list[str]) -> tuple[list[str], bool]:
    """The words without `--verbose`, and whether it was among them; what follows --ros-args is
    ROS's.
    """
    end = words.index("--ros-args") if "--ros-args" in words else len(words)
    own = [word for word in words[:end] if word != OPTION]
    return [*own, *words[end:]], len(own) < end


class Lines(logging.Formatter):
    """Warnings as a user reads them, steps with their time and the module that they are of."""

    def __init__(self) -> None:
        super().__init__("%(levelname)s: %(message)s")
        self._steps = logging.Formatter(
            "%(asctime)s.%(msecs)03d %(name)s: %(message)s", datefmt="%H:%M:%S"
        )

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        if record.levelno < logging.WARNING:
            return self._steps.format(record)
        return super().format(record)


class Terminal(logging.Filter):
    """A filter that shows the first few different messages of one kind, and counts the others.

    Args:
        level: lowest level at which messages are shown; below a warning, all of them are shown.
    """

    SHOWN = 3

    def __init__(self, level: int) -> None:
        super().__init__()
        self._level = level
        self._seen: dict[tuple[str, int], Counter[str]] = {}
        self._last: logging.LogRecord | None = None
        self._shown = True

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a message is shown; those of one place in the code are of one kind."""
        if record.levelno < self._level:
            return False
        if self._level < logging.WARNING:
            return True
        if record is not self._last:  # every handler asks about it
            text = record.getMessage()
            seen = self._seen.setdefault((record.pathname, record.lineno), Counter())
            seen[text] += 1
            self._last, self._shown = record, seen[text] == 1 and len(seen) <= self.SHOWN
        return self._shown

    def report_repeats(self) -> None:
        """Print how often the same message, or a similar one, was repeated."""
        for seen in self._seen.values():
            first, again = next(iter(seen)), seen.total() - min(len(seen), self.SHOWN)
            if again:
                times = "once more" if again == 1 else f"{again} times more"
                print(f"WARNING: {times}, this or the like: {first}", file=sys.stderr)


WARNINGS = LogChoice(logging.WARNING)
"""The default: warnings alone."""


@contextmanager
def package_logging(choice: LogChoice) -> Iterator[None]:
    """The package's messages from the chosen level on, into the file where there is one.

    Raises:
        InputError: the file cannot be written.
    """
    logger, before = logging.getLogger(PACKAGE), logging.getLogger(PACKAGE).level
    handler: logging.Handler | None = None
    if choice.file:
        try:
            handler = logging.FileHandler(choice.file)
        except OSError as err:
            raise InputError(
                f"{VARIABLE} names {choice.file}, which cannot be written ({err.strerror})"
            ) from err
        handler.setFormatter(Lines())
        logger.addHandler(handler)
    logger.setLevel(choice.level)
    try:
        yield
    finally:
        logger.setLevel(before)
        if handler is not None:
            logger.removeHandler(handler)
            handler.close()


@contextmanager
def terminal_logging(choice: LogChoice) -> Iterator[None]:
    """Logging of a tool: warnings, and the chosen level, on stderr.

    Raises:
        InputError: see `package_logging`.
    """
    logging.basicConfig(level=logging.WARNING)
    # A font that is missing is replaced; a user need not do anything about it.
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    root, terminal = logging.getLogger(), Terminal(choice.shown)
    for handler in root.handlers:
        if type(handler) is logging.StreamHandler:
            handler.setFormatter(Lines())
        handler.addFilter(terminal)
    try:
        with package_logging(choice):
            yield
    finally:
        for handler in root.handlers:
            handler.removeFilter(terminal)
        terminal.report_repeats()
