# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A ROS graph of one's own that stays on this machine."""

from __future__ import annotations

import os
import random
import socket
from pathlib import Path

from dlo_ros.share import shared_file

# Ports of a DDS domain begin here, 250 for each; above domain 101 they meet those that Linux gives
# to outgoing connections.
FIRST_PORT = 7400
PORTS = 250
DOMAINS = range(1, 102)

PROFILE = "config/fastdds_this_machine.xml"


def isolate(logs: Path) -> int:
    """Set the environment of this process and its children, where the user has not.

    Args:
        logs: folder into which ROS may write its own log files.

    Returns:
        The domain id.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_STATIC_PEERS", None)
    os.environ.setdefault("ROS_LOG_DIR", str(logs.resolve()))
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(shared_file(PROFILE))
    if not os.environ.get("ROS_DOMAIN_ID"):
        os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    return int(os.environ["ROS_DOMAIN_ID"])


def free_domain() -> int:
    """A domain id that no participant on this machine seems to use."""
    candidates = random.sample(DOMAINS, len(DOMAINS))
    return next((domain for domain in candidates if looks_free(domain)), candidates[0])


def looks_free(domain: int) -> bool:
    """Whether the ports that the first two participants of a domain listen on can be bound."""
    first = FIRST_PORT + PORTS * domain
    for port in (first + 10, first + 11, first + 12, first + 13):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True
