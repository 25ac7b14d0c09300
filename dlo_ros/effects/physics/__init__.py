# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that change the rod, what holds it or what it touches."""
