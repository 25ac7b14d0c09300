# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The command line: one module for each tool, `main` to choose between them."""
