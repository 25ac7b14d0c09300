# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The main job end to end: a recording plays, the nodes identify the DLO, a report is made."""
