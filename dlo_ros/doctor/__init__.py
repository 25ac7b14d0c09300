# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is installed, heard and mismatched: findings with what to do about them.

Each module judges one part and returns findings. What needs ROS hands a `graph.Graph` over, so that
all judgements run, and are tested, without it.
"""
