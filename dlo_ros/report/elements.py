# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Small pieces of HTML, and numbers in readable form."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape

UNKNOWN = "\N{EM DASH}"
WRAPPED = ' class="text"'

SIGNS = {"+-": "\N{PLUS-MINUS SIGN}", "^2": "\N{SUPERSCRIPT TWO}", "^3": "\N{SUPERSCRIPT THREE}"}


POWER = re.compile(r"(?<=[\d)])e([+-]\d{2,3})(?!\w)")
RAISED = str.maketrans(
    "-0123456789",
    "\N{SUPERSCRIPT MINUS}\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079",
)


def typeset(text: str) -> str:
    """Text as terminals show it (+-, m^2, 2.1e+07) with the signs of print."""
    for plain, sign in SIGNS.items():
        text = text.replace(plain, sign)
    return POWER.sub(lambda m: f"\N{MULTIPLICATION SIGN}10{str(int(m[1])).translate(RAISED)}", text)


def markup(text: str) -> str:
    """Plain text as HTML; what stands between backticks is code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(typeset(text)))


def paragraph(text: str) -> str:
    """Plain text as a paragraph; no line ends between a number and its per cent sign."""
    return f"<p>{markup(text).replace(' %', '&nbsp;%')}</p>"


def command(text: str) -> str:
    """A command for the terminal, as it has to be typed."""
    return f"<pre><code>{escape(text)}</code></pre>"


def figure(content: str, caption: str) -> str:
    """A picture (HTML or SVG) with its caption (plain text)."""
    return f"<figure>{content}<figcaption>{markup(caption)}</figcaption></figure>"


def table(headers: Sequence[str], rows: Sequence[Sequence[str]], wrapped: int = 0) -> str:
    """A table of plain text; the first column names the row.

    Args:
        headers: heads of the columns.
        rows: cells of each row.
        wrapped: column of sentences, which may take several lines; 0: there is none.
    """
    return _table(headers, f"<tbody>{_rows(rows, wrapped)}</tbody>")


def grouped_table(
    headers: Sequence[str], groups: Sequence[tuple[str, Sequence[Sequence[str]]]]
) -> str:
    """A table of plain text whose rows stand in groups, each below its title.

    Args:
        headers: heads of the columns.
        groups: title and rows of each group; the first cell names the row.
    """
    body = []
    for title, rows in groups:
        head = f'<tr><th scope="rowgroup" colspan="{len(headers)}">{markup(title)}</th></tr>'
        body.append(f"<tbody>{head}{_rows(rows)}</tbody>")
    return _table(headers, "".join(body))


def _table(headers: Sequence[str], body: str) -> str:
    """A table with heads of its columns."""
    head = "".join(f'<th scope="col">{markup(h)}</th>' for h in headers)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>{body}</table></div>'


def _rows(rows: Sequence[Sequence[str]], wrapped: int = 0) -> str:
    """Rows of a table, see `table`."""
    lines = []
    for first, *others in rows:
        cells = "".join(
            f"<td{WRAPPED if k == wrapped else ''}>{markup(cell)}</td>"
            for k, cell in enumerate(others, 1)
        )
        lines.append(f'<tr><th scope="row">{markup(first)}</th>{cells}</tr>')
    return "".join(lines)


def number(value: float | None, unit: str = "", digits: int = 3) -> str:
    """A number with its unit; a dash where it is unknown or unbounded."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    magnitude = abs(value)
    plain = value == 0.0 or 1e-3 <= magnitude < 1e5
    text = _plain(value, digits) if plain else f"{value:.{digits - 1}e}"
    return f"{text} {unit}".rstrip()


def measured(
    value: float | None, std: float | None, unit: str = "", *, sparing: bool = False
) -> str:
    """A value with its standard deviation to two digits, both to the same place.

    Args:
        sparing: whether one digit of the standard deviation is enough where it is 2 or more.
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{number(value, unit)} (std unknown)"
    place = _exponent(std, 2) - 1
    if sparing and std >= 1.95 * 10.0 ** (place + 1):
        place += 1
    exponent = math.floor(math.log10(max(abs(value), std)))
    if -3 <= exponent < 5 and place <= 0:
        return f"{_fixed(value, -place)} +- {std:.{-place}f} {unit}".rstrip()
    if -3 <= exponent < 5 and std < 1e5:
        return f"{_fixed(round(value, -place), 0)} +- {round(std, -place):.0f} {unit}".rstrip()
    # One power of ten for both, so that the eye can compare them.
    shown = min(max(exponent - place, 0), 6)
    scale = 10.0**exponent
    return f"({value / scale:.{shown}f} +- {std / scale:.{shown}f})e{exponent:+03d} {unit}".rstrip()


def millimetres(metres: float | None, digits: int = 3) -> str:
    """A length given in metres, shown in millimetres."""
    return number(None if metres is None else metres * 1e3, "mm", digits)


def percent(share: float) -> str:
    """A share in per cent, never all or nothing by rounding alone."""
    if 0.99 < share < 1.0:
        return "over 99 %"
    return "under 1 %" if 0.0 < share < 0.01 else f"{100.0 * share:.0f} %"


def _fixed(value: float, places: int) -> str:
    """A number with a fixed count of decimals, never minus zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


def _plain(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    decimals = max(digits - 1 - _exponent(value, digits), 0)
    return f"{value:.{decimals}f}"


def _exponent(value: float, digits: int) -> int:
    """Power of ten of a number's first digit, when the number is rounded: 1 of 9.97 to two."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])
