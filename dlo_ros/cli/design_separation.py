# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Manipulations by how well they separate rival explanations, such as `diagnose` names."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.cli.design_purpose import PANELS, Presentation, PresentedExperiment, panel
from dlo_ros.cli.effect_words import mm, title
from dlo_ros.effects import quantities
from dlo_ros.effects.registry import check
from dlo_ros.effects.start import Block
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.design.expected_information import POINTS, Noise, Plan
from dlo_ros.identification.design.model_discrimination import (
    REFITS,
    SEARCH_REFITS,
    Discrimination,
    discriminate,
)
from dlo_ros.identification.design.plausible_explanations import (
    AssumedEffect,
    plausible_explanation,
)
from dlo_ros.identification.identifiability import enumerated
from dlo_ros.inference.forecast import forecast
from dlo_ros.inference.parameter import split_name
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.thresholds import NAMED, WORTH
from dlo_ros.parameters import Settings
from dlo_ros.report.design import Panel
from dlo_ros.spline import SplineBasis

FINALISTS = 4
"""Candidates of a search that are fitted to the end, since few steps separate them too well."""
Rivals = Mapping[str, Block | None]
"""Effects by name with their values; None: nothing says how large they are."""


def named_rivals(
    settings: Settings, names: Sequence[str], report: Path | None
) -> tuple[Settings, Rivals]:
    """Rival effects with their values, and the settings without what is no cause of the report.

    Values are those of the report, else those of the parameter file.

    Args:
        settings: settings of the DLO.
        names: names of the effects; none: the first cause of the report and its rivals.
        report: report.json of `diagnose`; None: there is none.

    Raises:
        ParameterError: there is no such effect.
        InputError: the report is unusable or names no rivals, or an effect is named twice.
    """
    values: dict[str, Block] = {}
    if report is not None:
        causes, setup = _read(report)
        names = names or next(([n, *rivals] for n, (_, rivals) in causes.items() if rivals), ())
        if not names:
            raise InputError(f"{report}: names no rivals; name the effects: --apart EFFECT EFFECT")
        for name, (block, rivals) in causes.items():
            values |= {n: v for n, v in {**rivals, name: block}.items() if v}
        kept = {
            name: {k: v for k, v in block.items() if (name, k) not in setup}
            for name, block in settings.effects.items()
        }
        settings = settings.with_effects({name: block for name, block in kept.items() if block})
    for name in names:
        quantities(name)
    if len(set(names)) < len(names):
        raise InputError(f"--apart: {names[0]} is named twice; give two different effects")
    return settings, {n: values.get(n) or settings.effects.get(n) for n in names}


def _read(path: Path) -> tuple[dict[str, tuple[Block, dict[str, Block]]], set[tuple[str, str]]]:
    """Causes of a report with their values and their rivals', and keys of the set-up.

    Raises:
        ParameterError: a value is unusable.
        InputError: the file is no report.json of `diagnose`.
    """
    try:
        tree = json.loads(path.read_text())
        causes = {
            e["name"]: (
                _block(e["name"], {k: n["value"] for k, n in e["parameters"].items()}),
                {n: _block(n, e.get("rival_values", {}).get(n, {})) for n in e["rivals"]},
            )
            for e in tree["effects"]
        }
        setup = {
            split_name(name)[:2]
            for name, n in tree.get("setup", {}).items()
            if n.get("tolerance", 0.0) is not None
        }
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
    except (ValueError, KeyError, TypeError, AttributeError) as err:
        raise InputError(f"{path}: is no report.json of diagnose") from err
    return causes, setup


def _block(effect: str, values: Mapping[str, Any]) -> Block:
    return {key: check(effect, key, value) for key, value in values.items()}


def sized(rivals: Rivals, settings: Settings, plans: Sequence[Plan]) -> tuple[AssumedEffect, ...]:
    """Rival effects, of plausible sizes where nothing says how large they are.

    Args:
        rivals: see `named_rivals`.
        settings: settings of the DLO.
        plans: manipulations, by which plausible sizes are judged.

    Raises:
        ParameterError: there is no such effect.
        InputError: nothing says how large one may be, or a damping is only a guess.
        SimulationError: no manipulation can be simulated.
    """
    plain = settings.with_effects({k: v for k, v in settings.effects.items() if k not in rivals})
    recordings, shapes = [], []
    for plan in plans:
        try:
            shapes.append(forecast(plan.manipulation(), plain).predicted)
        except SimulationError:
            continue
        recordings.append(plan.manipulation())
    if not recordings:
        raise SimulationError("none of the manipulations can be simulated")
    seen = scene(plain, imposed_names(recordings), shapes)
    return tuple(plausible_explanation(n, plain, seen, b, plans) for n, b in rivals.items())


@dataclass(frozen=True)
class Separation:
    """The purpose to separate rival explanations.

    Args:
        settings: settings of the DLO.
        noise: measurement noise of the observer.
        rivals: the explanations.
    """

    settings: Settings
    noise: Noise
    rivals: tuple[AssumedEffect, ...]

    finalists = FINALISTS

    @property
    def what(self) -> str:
        """See `Purpose`."""
        return f"the manipulation that best separates {self._names}"

    @property
    def _names(self) -> str:
        return enumerated([title(r.effect) for r in self.rivals])

    def judge(self, plan: Plan, spans: int | None) -> Discrimination:
        """See `Purpose`."""
        refits = REFITS if spans is None else SEARCH_REFITS
        return discriminate(
            plan, self.settings, self.rivals, self.noise, spans=spans, refits=refits
        )

    def presented(self, ranking: Sequence[Discrimination]) -> Presentation:
        """See `Purpose`."""
        shown = tuple(self._experiment(d) for d in ranking)
        best = ranking[0]
        lines = [
            f"Log evidence by which each experiment separates {self._names}, the largest first:",
            *(f"  {d.gain:6.1f} {certainty(d.gain):<13}  {d.plan.name}" for d in ranking),
        ]
        headline = f"{best.plan.name}: {shown[0].reason}"
        if best.gain < WORTH:
            headline = (
                f"No manipulation that was tried separates {self._names}: it makes no difference "
                "which is named until one of them is measured by itself."
            )
        general = (
            "The log evidence is that for the true explanation over the other one, fitted instead "
            "with E, mu, damping and the set-up within its tolerances; the less of both "
            f"directions, and of all pairs. {WORTH:.0f} is twenty to one, {NAMED:.0f} is 150 to "
            "one, from which diagnose names a cause."
        )
        return Presentation(
            shown, headline, tuple(lines), f"The manipulation that separates {self._names}",
            ("log evidence", "result", "hardest pair"),
            "Solid: the true explanation; dashed: its rival, fitted to it.",
            (general, *map(_assumed, self.rivals)),
            {"apart": [{"name": r.effect, "parameters": dict(r.block)} for r in self.rivals]},
        )  # fmt: skip

    def _experiment(self, d: Discrimination) -> PresentedExperiment:
        true, rival = d.pair
        numbers = {
            "log_evidence": d.gain,
            "hardest": {"true": true, "fitted": rival},
            "pairs": [
                {"true": a, "fitted": b, "log_evidence": float(d.evidence[i, j])}
                for i, a in enumerate(d.effects)
                for j, b in enumerate(d.effects)
                if i != j
            ],
        }
        cells = (f"{d.gain:.1f}", certainty(d.gain), f"{title(true)}, {title(rival)}")
        return PresentedExperiment(d.plan.name, numbers, cells, self._reason(d), self._panels(d))

    def _reason(self, d: Discrimination) -> str:
        """Sentence on what a manipulation separates, where and when."""
        if not d.reliable:
            return (
                "It cannot be relied on: it brings the DLO near a snap-through, or folds it more "
                "sharply than can be simulated."
            )
        true, rival = map(title, d.pair)
        length = self.settings.rod.length
        basis = SplineBasis(self.settings.rod.control_points, length)
        u = np.linspace(0.0, length, POINTS)
        gap = basis.matrix(u) @ (d.forecast.predicted[:, :, :3] - d.imitation[:, :, :3])
        apart = np.linalg.norm(gap, axis=2)  # (F, U)
        frame, place = np.unravel_index(int(np.argmax(apart)), apart.shape)
        when = float(d.forecast.stamps[frame] - d.forecast.stamps[0]) * 1e-9
        where = f"{mm(float(apart.max()))} at u = {u[place]:.2f} m, {when:.1f} s after the start"
        if d.gain < WORTH:
            return (
                f"It does not separate {true} from {rival} (log evidence {d.gain:.1f}): fitted to "
                f"its shapes, {rival} differs from them by no more than {where}."
            )
        return (
            f"It separates {true} from {rival} by a log evidence of {d.gain:.0f}: "
            f"{certainty(d.gain)}. Fitted to its shapes, {rival} still differs from them, most by "
            f"{where}."
        )

    def _panels(self, d: Discrimination) -> tuple[Panel, ...]:
        frames = np.unique(np.linspace(0, len(d.imitation) - 1, PANELS).astype(int))
        times = (d.forecast.stamps - d.forecast.stamps[0]) * 1e-9
        return tuple(
            panel(float(times[k]), (d.forecast.predicted[k], d.imitation[k]), self.settings)
            for k in frames
        )


def certainty(evidence: float) -> str:
    """What a log evidence says of two explanations."""
    if evidence < WORTH:
        return "not separated"
    return "certain" if evidence >= NAMED else "likely"


def _assumed(rival: AssumedEffect) -> str:
    """Sentence on the size of an effect that is assumed."""
    numbers = ", ".join(
        f"{key} {np.array2string(np.asarray(value), precision=3, separator=', ')}"
        for key, value in rival.block.items()
    )
    return f"Assumed of {title(rival.effect)}: {numbers} (SI units)."
