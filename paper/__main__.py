# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`python -m paper [--output DIR] [--seed N]`: tables, figures and the automatic procedure."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from dlo_ros.report.elements import figure, markup, measured, number, paragraph, table
from dlo_ros.report.page import Section, page, write_page
from paper.figures import FIGURES, panels, picture
from paper.results import Automatic, Results, results


def main() -> int:
    """Write report.html and table.json; 1 where an ordering of the paper does not come out."""
    parser = argparse.ArgumentParser(prog="python -m paper", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/paper"), metavar="DIR")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the noise")
    arguments = parser.parse_args()
    found = results(arguments.seed)
    arguments.output.mkdir(parents=True, exist_ok=True)
    write_page(arguments.output / "report.html", html(found))
    (arguments.output / "table.json").write_text(json.dumps(tree(found), indent=2) + "\n")
    for row in found.rows:
        print(
            f"{row.run.title:18} E {row.material[0]:.0e} mu {row.material[1]:.0f}: "
            f"ERR {1e3 * row.err:6.2f} mm (paper {row.paper:.3f})"
        )
    for automatic in found.automatic:
        e = automatic.estimate
        err = ", ".join(f"{name} {1e3 * v:.2f}" for name, v in automatic.err.items())
        print(f"identified from {automatic.source}: E/mu {e.specific_modulus:.5g}; ERR [mm] {err}")
    for claim, holds in found.checks:
        print(f"{'holds' if holds else 'FAILS'}: {claim}")
    print(f"written to {arguments.output}: report.html, table.json")
    return 0 if all(holds for _, holds in found.checks) else 1


def tree(found: Results) -> dict[str, object]:
    """The numbers for programs."""
    return {
        "table": [
            {
                "experiment": r.run.name, "young_modulus": r.material[0],
                "density": r.material[1], "err": r.err, "err_mean": r.mean, "paper": r.paper,
            }
            for r in found.rows
        ],
        "automatic": [
            {
                "source": a.source, "specific_modulus": a.estimate.specific_modulus,
                "std": a.estimate.specific_modulus_std, "err": a.err,
            }
            for a in found.automatic
        ],
        "checks": [{"claim": claim, "holds": holds} for claim, holds in found.checks],
    }  # fmt: skip


def html(found: Results) -> str:
    """The report for a person."""
    rows = [
        [r.run.title, f"{r.material[0]:.0e}", f"{r.material[1]:.0f}", number(1e3 * r.err, "mm"),
         f"{r.paper:.3f}"]
        for r in found.rows
    ]  # fmt: skip
    headers = ["experiment", "E [Pa]", "mu [kg/m^3]", "ERR at the end", "ERR in the paper"]
    text = (
        "The recordings are simulated by the discrete rod with E = 5e7 Pa and mu = 2500 kg/m^3 and "
        "measured with 0.3 mm of noise. The paper's ERR is in units that it does not state: its "
        "order counts. Its rope was real, so its best ERR has an error of the model in it."
    )
    claims = table(
        ["claim", "holds"], [[claim, "yes" if holds else "no"] for claim, holds in found.checks]
    )
    sections = [
        Section("ERR as in Table IV", table(headers, rows) + paragraph(text) + claims),
        Section("The automatic procedure", "".join(_automatic(a) for a in found.automatic)),
    ]
    for title, name, sets, times in FIGURES:
        caption = "Solid: the observed final shape; dashed: the simulation at that instant."
        shown = picture(panels(found.recorded[name], sets, times))
        sections.append(Section(f"{title}: {name}", figure(shown, caption)))
    best = found.automatic[-1].estimate
    headline = measured(best.specific_modulus, best.specific_modulus_std, "m^2/s^2")
    summary = f'<p class="headline">{markup(f"E/mu identified: {headline} (true: 20000)")}</p>'
    return page("The paper's experiments", summary, sections)


def _automatic(found: Automatic) -> str:
    e = found.estimate
    words = f"From {found.source}: E/mu = {measured(e.specific_modulus, e.specific_modulus_std)}."
    rows = [[name, number(1e3 * err, "mm")] for name, err in found.err.items()]
    return (
        paragraph(words)
        + "".join(paragraph(s) for s in found.statement)
        + table(["experiment", "ERR at the end"], rows)
    )


if __name__ == "__main__":
    raise SystemExit(main())
