# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Findings about the installation, the ROS graph and parameters, with their remedies.

Each module judges one part and returns findings. What needs ROS hands a `graph.Graph` over, so that
all judgements run, and are tested, without it.
"""
