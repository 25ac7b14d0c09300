# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The exceptions of the package.

Every message is one line for a person: which input, what is wrong with it, what would be right.
"""

EXIT_DONE, EXIT_FAILED, EXIT_UNUSABLE, EXIT_INTERRUPTED = 0, 1, 2, 130
"""Exit statuses of every executable: done, a defect or something wrong, an input that cannot be
used, ended by Ctrl-C."""


class DloError(Exception):
    """Root of all errors that the package raises on purpose."""


class InputError(DloError):
    """A file, message or parameter cannot be used (exit status 2 of the command line tools)."""


class ParameterError(InputError):
    """A parameter is missing, has the wrong type or lies outside its range."""


class CommandError(InputError):
    """A `dlo/command` is malformed; it is refused whole."""


class RecordingError(InputError):
    """A bag cannot be read, lacks a topic, or cannot be written."""


class VisionError(DloError):
    """No credible DLO was found in an image; the message says why."""


class SimulationError(DloError):
    """The rod model could not be solved: no equilibrium, or a step that does not converge."""


class KernelError(DloError):
    """The numerical kernels cannot be compiled, or their machine code cannot be kept."""
