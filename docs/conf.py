# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How Sphinx makes pages of this folder: `make docs`."""

import importlib.util
import os
import re
import sys
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.utils.math.latex2mathml import tex2mathml

os.environ["COLUMNS"] = "100"  # of the help texts
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dlo_ros import __version__  # noqa: E402
from dlo_ros.cli.main import EXECUTABLES, parser_of  # noqa: E402

project = "dlo_ros"
author = "dlo_ros maintainers"
version = release = __version__
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath", "attrs_inline"]
myst_heading_anchors = 3
html_theme = "sphinx_rtd_theme"
html_theme_options = {"navigation_depth": 2, "collapse_navigation": False}
html_title = f"dlo_ros {version}"
html_static_path = ["_static"]
html_css_files = ["wide_tables.css"]
html_show_sourcelink = False
html_math_renderer = "mathml"


def mathml(self, node, block):
    """A formula as MathML, which browsers draw by themselves: no script from elsewhere."""
    formula = tex2mathml(node.astext(), as_block=block)
    self.body.append(f'<div class="math">{formula}</div>' if block else formula)
    raise nodes.SkipNode


MOVED = {"CONTRIBUTING.md": "contributing.md", "QUALITY_DECLARATION.md": "quality.md"}


def files_of_the_root(app, name, source):
    """Put a file of the root in place of `<!-- file NAME -->`, its links as seen from here."""

    def there(match):
        text = (ROOT / match[1]).read_text().replace("](docs/", "](")
        for old, new in MOVED.items():
            text = text.replace(f"]({old})", f"]({new})")
        return text

    source[0] = re.sub(r"<!-- file (\S+) -->", there, source[0])


class ToolHelp(Directive):
    """The --help text of an executable."""

    required_arguments = 1

    def run(self):
        """Return the text as it is printed."""
        (chosen,) = [e for e in EXECUTABLES if e.name == self.arguments[0]]
        text = parser_of(chosen).format_help()
        return [nodes.literal_block(text, text, language="none")]


def renewed_tables(app):
    """Refuse to build from tables that are out of date."""
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs" / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    for name in reference.PAGES:
        text = (ROOT / "docs" / name).read_text()
        if reference.renewed(text) != text:
            raise RuntimeError(f"docs/{name}: its tables are out of date; make reference")


def setup(app):
    """Register what stands above."""
    app.add_directive("tool-help", ToolHelp)
    app.add_html_math_renderer(
        "mathml",
        (lambda self, node: mathml(self, node, False), None),
        (lambda self, node: mathml(self, node, True), None),
    )
    app.connect("builder-inited", renewed_tables)
    app.connect("source-read", files_of_the_root)
    return {"parallel_read_safe": True}
