# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection among fitted effects: the search, the verdict, pairs, and the time before a contact."""
