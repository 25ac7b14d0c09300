# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Explanation of recordings by the joint model: the set-up within tolerances, and causes."""
