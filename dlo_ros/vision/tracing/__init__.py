# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tracing: from ridges to the ordered centreline of a DLO and its ends."""
