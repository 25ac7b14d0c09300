# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the SROS2 policies in config/sros2 allow, as full names."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "config" / "sros2"


@dataclass(frozen=True)
class Policy:
    """The rights of one node."""

    enclave: str
    node: str
    publish: frozenset[str]
    subscribe: frozenset[str]
    reply: frozenset[str]
    request: frozenset[str]


def read_policy(node: str, namespace: str | None = None) -> Policy:
    """The policy of a node, its names resolved in the profile's or another namespace."""
    root = ElementTree.parse(FOLDER / f"{node}.policy.xml").getroot()
    assert root.tag == "policy" and root.get("version") == "0.2.0"
    (enclave,) = root.findall("./enclaves/enclave")
    (profile,) = enclave.findall("./profiles/profile")
    prefix = (profile.get("ns") if namespace is None else namespace).rstrip("/")
    name = profile.get("node")

    def full(text: str) -> str:
        if text.startswith("/"):
            return text
        if text.startswith("~/"):
            return f"{prefix}/{name}{text[1:]}"
        return f"{prefix}/{text}"

    rights: dict[str, set[str]] = {k: set() for k in ("publish", "subscribe", "reply", "request")}
    for block in profile:
        assert block.tag in ("topics", "services") and set(block.attrib.values()) == {"ALLOW"}
        for right in block.attrib:
            names = [full(entry.text) for entry in block]
            assert names == sorted(names) and not rights[right] & set(names), names
            rights[right] |= set(names)
    return Policy(enclave.get("path"), name, **{k: frozenset(v) for k, v in rights.items()})
