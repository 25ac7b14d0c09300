# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Watch, simulate and identify deformable linear objects (cables, ropes, hoses)."""

__version__ = "0.1.0"
