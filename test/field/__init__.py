# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings with everything that a real set-up has at once, for `diagnose` to find the causes."""

from field.generate import Case, draw

__all__ = ["Case", "draw"]
