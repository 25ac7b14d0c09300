# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that change how and when a DLO is seen, or what is known of it; its physics stay."""
