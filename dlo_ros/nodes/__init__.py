# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The three ROS 2 nodes and the player, thin shells around the stages; only here ROS is used."""
