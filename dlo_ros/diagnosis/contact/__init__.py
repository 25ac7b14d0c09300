# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for pegs that a DLO may have hit."""
