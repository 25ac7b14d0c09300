# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The shell of a report: one HTML file with its style and its script inside."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path

from dlo_ros import __version__
from dlo_ros.report.elements import markup


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it.

    Args:
        title: plain text.
        body: HTML.
    """

    title: str
    body: str


def page(title: str, summary: str, sections: Sequence[Section]) -> str:
    """A whole HTML document.

    Args:
        title: plain text, for the heading and the browser's tab.
        summary: HTML below the heading, what a hurried reader needs.
        sections: the rest, in order.
    """
    parts = [f"<section><h2>{markup(s.title)}</h2>\n{s.body}\n</section>" for s in sections]
    body = "\n".join(parts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<style>
{_asset("report.css")}</style>
</head>
<body>
<main>
<header><h1>{escape(title)}</h1>
{summary}
</header>
{body}
<footer>Made by dlo_ros {escape(__version__)}. A value \N{PLUS-MINUS SIGN} its standard deviation;
files are in SI units.</footer>
</main>
<script>
{_asset("player.js")}</script>
</body>
</html>
"""


def write_page(path: Path | str, html: str) -> None:
    """Write a document; whoever reads the file sees the old one or the whole new one.

    Raises:
        OSError: the folder cannot be made or the file cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(html)
        temporary.chmod(0o644)  # mkstemp makes files that only their owner may read
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _asset(name: str) -> str:
    return (resources.files("dlo_ros.report") / "assets" / name).read_text(encoding="utf-8")
