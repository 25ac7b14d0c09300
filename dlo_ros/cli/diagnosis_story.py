# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis as answers to three questions: how wrong, why, with what gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.cli.diagnosis_words import clear_side, is_sized, remedies, values
from dlo_ros.cli.effect_words import clause, either, mm, title
from dlo_ros.cli.error_places import how_wrong, immaterial, plain_error
from dlo_ros.cli.set_up_table import is_far_off, labels_of, set_up_is_off, setup_lines
from dlo_ros.diagnosis import Diagnosis, NamedEffect
from dlo_ros.identification.force_scale import POWERS
from dlo_ros.identification.identifiability import enumerated, rounded
from dlo_ros.inference.parameter import split_name
from dlo_ros.inference.thresholds import IDENTIFIED
from dlo_ros.report.diagnosis_content import Question, SetupRow
from dlo_ros.report.elements import measured, percent

QUESTION_ERROR = "How wrong is my simulation?"
QUESTION_CAUSE = "Why?"
QUESTION_GAIN = "What do I gain?"
QUESTION_REMEDY = "What can I do about it by hand?"
AS_FITTED = "the set-up as fitted"
RIVALS_NAMED = 2
"""Rivals that the headline names."""
OTHERWISE = "with other numbers than those told here, "
COUNTS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
OVERLAP = (
    "The share of each cause, in brackets, is how much of the error comes back where that cause "
    "alone is left out and the rest is fitted again. Causes can stand in for one another, so "
    "shares need not add up to 100 %."
)
HALF = 0.5
"""Sum of the causes' shares below which it is told what has the others."""
BESIDE = (
    "The rest of the error goes with a set-up that is off {} its tolerances (see the table), or "
    "with what the set-up and the causes do for one another."
)
UNSIZED = (
    "That it acts is certain; how strongly, these data do not determine: the numbers are those of "
    "the best fit."
)
UNSIZED_TOGETHER = (
    "Certain is that they act, but not how strongly (the numbers are those of the best fit): {}."
)
WEIGHT = (
    "Shapes tell masses, forces and moments only in proportion to the weight of the DLO, which the "
    "parameter file guesses: weigh it, and state rod.density with density_std."
)
LOAD = "Load {} in place of your parameter file (--params of the tools, --params-file of the nodes)"


@dataclass(frozen=True)
class Story:
    """The result of a diagnosis in sentences.

    Args:
        headline: the result in one sentence.
        answers: answers to the three questions.
        remedies: what a person can do about each cause; empty: there is no cause.
        setup: numbers of the set-up, the most clearly wrong first.
        advice: the next recording to make.
    """

    headline: str
    answers: tuple[Question, ...]
    remedies: tuple[str, ...]
    setup: tuple[SetupRow, ...]
    advice: str


def story(found: Diagnosis, length: float, file: str) -> Story:
    """The result of a diagnosis in sentences.

    Args:
        length: length of the DLO [m].
        file: name of the file that holds the extended model.
    """
    return Story(
        headline(found),
        (
            Question(QUESTION_ERROR, how_wrong(found, length)),
            Question(QUESTION_CAUSE, _why(found)),
            Question(QUESTION_GAIN, _gain(found, file)),
        ),
        remedies(by_share(found.effects)),
        setup_lines(found),
        found.advice,
    )


def by_share(causes: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Causes, the one with the largest share of the error first."""
    return sorted(causes, key=lambda e: -(e.share or 0.0))


def extends(found: Diagnosis) -> bool:
    """Whether the extended model has effects that the plain one has not."""
    return found.extended.settings.effects != found.baseline.settings.effects


def headline(found: Diagnosis) -> str:
    """The result in a sentence."""
    err = plain_error(found)
    order = by_share(found.effects)
    causes = enumerated([_short(e, order) for e in order])
    off = "The simulation is off" if err is None else f"The simulation is {mm(err)} off"
    if found.verdict == "adequate":
        if immaterial(found):
            return f"The simulation agrees with the recordings; it is {mm(err)} off."
        if found.setup and extends(found):
            if causes and not set_up_is_off(found):
                return f"{off}, for {causes}: no more than a set-up within its tolerances may do."
            beside = f", and for {causes}" if causes else ""
            how = "off beyond" if _far_off(found) else "a little off within"
            return f"{off}, for a set-up that is {how} its tolerances{beside}."
        return f"{off}, and these data show no cause for it."
    if found.verdict == "explained":
        return f"{off}, and this is why: {causes}."
    if causes:
        return f"{off}, and this is part of why: {causes}."
    return f"{off}, and no cause that is known here is certain."


def _short(effect: NamedEffect, causes: Sequence[NamedEffect]) -> str:
    """A cause with its rivals, in few words.

    Args:
        causes: all causes; one may be a rival of another one, with other numbers.
    """
    own, named = title(effect.name, clear_side(effect)), {c.name for c in causes}
    rivals = [f"another {title(n)}" if n in named else title(n) for n in effect.rivals]
    if len(rivals) > RIVALS_NAMED:
        rivals = [f"one of {len(rivals)} others"]
    return f"{own} (or {', '.join(rivals)})" if rivals else own


def _why(found: Diagnosis) -> tuple[str, ...]:
    length = found.extended.settings.rod.length
    order = by_share(found.effects)
    sentences = _causes(order, length, found.extended.scale_std)
    shares = [e.share for e in order if e.share is not None]
    if found.verdict == "explained" and shares and sum(shares) < HALF:
        sentences.append(BESIDE.format("beyond" if _far_off(found) else "within"))
    if len(shares) > 1:
        sentences.insert(0, OVERLAP)
    if found.verdict == "adequate" and order and immaterial(found):
        sentences.insert(0, "Nothing that matters is wrong. This is certain all the same.")
    if found.verdict == "adequate":
        if found.setup and extends(found) and (not order or set_up_is_off(found)):
            sentences.append(_slight(found))
        elif not sentences:
            sentences.append(
                "Nothing that matters is wrong."
                if immaterial(found)
                else "The data show no cause for certain."
            )
    elif found.verdict == "unexplained" and not sentences and _nothing_left(found):
        sentences.append(
            f"No cause is certain. The set-up{_within(found)} leaves an error that matters; "
            "with effects of which none is certain (extended.yaml holds them) "
            f"{_left(found)} are left, which do not matter."
        )
    elif found.verdict == "unexplained":
        beside = "The remaining error" if sentences else "Nothing is certain. The error"
        doubt = ", and what is unknown may be a part of what is told above" if sentences else ""
        if not sentences and extends(found):
            beside = f"No cause is certain; the set-up{_within(found)} explains a part. The rest"
        known = f"is explained by no cause that is known here{doubt}"
        sentences.append(f"{beside} ({_left(found)}) {known}.")
        sentences += _uncertain(found, length)
    return tuple(sentences)


def _slight(found: Diagnosis) -> str:
    """How far off the set-up of an adequate model is."""
    far, places = _far_off(found), sum(row.notable for row in setup_lines(found))
    if far:
        return f"The set-up is off by more than twice the tolerance in {far}: see the table."
    if not places:
        return (
            "No number of the set-up is off for certain; together, each within twice its "
            "tolerance, they explain a part."
        )
    where = "one place" if places == 1 else "several places"
    return f"The set-up is a little off in {where}, each within twice its tolerance: see the table."


def _within(found: Diagnosis) -> str:
    """Clause that says how far off the fitted set-up is."""
    far = _far_off(found)
    return f", off by more than twice the tolerance in {far}," if far else " within its tolerances"


def _far_off(found: Diagnosis) -> str:
    """Titles of the set-up's effects that are far beyond their tolerance, with their numbers."""
    labels, far = labels_of(found), dict[str, list[str]]()
    for name, n in found.setup.items():
        if is_far_off(name, n):
            effect = split_name(name)[0]
            which = labels[name].removeprefix(title(effect)).removeprefix(", ")
            far.setdefault(title(effect), []).append(which)
    return enumerated([_placed(what, which) for what, which in far.items()])


def _placed(what: str, which: Sequence[str]) -> str:
    """The title of an effect with which of its numbers are meant, or how many."""
    text = f"{len(which)} numbers" if len(which) > 1 else which[0]
    return f"{what} ({text})" if text else what


def _nothing_left(found: Diagnosis) -> bool:
    """Whether the extended model leaves nothing that matters, on any data."""
    left = [x for x in (found.extended.err_holdout, found.extended.err_train) if x is not None]
    enough = found.material_err
    return extends(found) and enough is not None and bool(left) and max(left) < enough


def _left(found: Diagnosis) -> str:
    """The error that is left: on held-out data, or where it matters."""
    if not extends(found):
        return mm(plain_error(found))
    held, learned, enough = (
        np.nan if x is None else x
        for x in (found.extended.err_holdout, found.extended.err_train, found.material_err)
    )
    if held < enough < learned:
        return f"{mm(learned)} on the recordings learned from"
    return mm(found.extended.err_holdout)


def _causes(order: Sequence[NamedEffect], length: float, scale_std: float) -> list[str]:
    """Sentences on all causes, and on those of which the data do not determine the strength.

    Args:
        order: the causes, as they are told.
        length: length of the DLO [m].
        scale_std: see `Fitted`.
    """
    sentences = [_cause(e, order, length) for e in order]
    unsized = [k for k, e in enumerate(order) if not is_sized(e, length)]
    if len(unsized) == 1:
        sentences[unsized[0]] += f" {UNSIZED}"
    elif unsized:
        sentences.append(
            UNSIZED_TOGETHER.format(enumerated([title(order[k].name) for k in unsized]))
        )
    units = {n.unit for k in unsized for n in order[k].parameters.values()}
    if scale_std > IDENTIFIED and not units.isdisjoint(POWERS):
        sentences.append(WEIGHT)
    return sentences


def _cause(effect: NamedEffect, causes: Sequence[NamedEffect], length: float) -> str:
    share = f" ({percent(effect.share)} of the error)" if effect.share else ""
    text = f"Certain{share}: "
    if effect.rivals:
        text = (
            f"One of these {_count(effect)} is certain{share}, "
            "but the data do not determine which: "
        )
    text += f"{_with_rivals(effect, length, causes)}."
    if effect.share == 0.0:
        text += " The simulation comes as near without it."
    return text


def _uncertain(found: Diagnosis, length: float) -> list[str]:
    """Sentences on causes that may act, the largest share first, with what may act in their place.

    Of rivals of one another the first tells both.
    """
    told: set[str] = set()
    sentences = []
    for effect in by_share(found.uncertain):
        if effect.name in told:
            continue
        told |= {effect.name, *effect.rivals}
        what = f"one of these {_count(effect)}" if effect.rivals else "this"
        share = f"{percent(effect.share)} of the error" if effect.share else "a part of it"
        sentences.append(f"Not certain, but {what} may be {share}: {_with_rivals(effect, length)}.")
    return sentences


def _with_rivals(effect: NamedEffect, length: float, causes: Sequence[NamedEffect] = ()) -> str:
    """The clause of a cause with its numbers, and those of its rivals.

    Args:
        causes: causes that are told besides; a rival among them would have other numbers.
    """
    told = {c.name for c in causes}
    numbers = f" ({values(effect, length)})" if effect.parameters else ""
    own = f"{clause(effect.name, clear_side(effect))}{numbers}"
    rivals = (f"{OTHERWISE if r in told else ''}{clause(r)}" for r in effect.rivals)
    return either([own, *rivals])


def _count(effect: NamedEffect) -> str:
    """Number of a cause and its rivals, in words."""
    count = 1 + len(effect.rivals)
    return COUNTS.get(count, str(count))


def _worse(found: Diagnosis) -> bool:
    """Whether the extended model clearly predicts what no fit has seen worse than the plain one."""
    after, enough = found.extended.err_holdout, found.material_err
    matters = after is not None and (enough is None or after > enough)
    return found.gain is not None and found.gain.high < 0.0 and matters


def _less_than_learned(found: Diagnosis) -> list[str]:
    """Sentence on why held-out data may be predicted better than those learned from are fitted."""
    more = [
        f"{mm(fitted.err_train)} {when}"
        for fitted, when in ((found.baseline, "before"), (found.extended, "after"))
        if fitted.err_train is not None and fitted.err_holdout is not None
        and mm(fitted.err_train) != mm(fitted.err_holdout) and fitted.err_holdout < fitted.err_train
    ]  # fmt: skip
    if not more:
        return []
    return [
        f"On the data learned from the error is larger ({', '.join(more)}): a wrong model shows "
        "more in some shapes and motions than in others."
    ]


def _gain(found: Diagnosis, file: str) -> tuple[str, ...]:
    before, after = found.baseline.err_holdout, found.extended.err_holdout
    value, std = found.extended.specific_modulus
    known = (
        measured(value, std, "m^2/s^2") if std else f"{rounded(value)} m^2/s^2, how well unknown"
    )
    load = LOAD.format(file)
    if not extends(found):
        return (f"{load}: it holds what was fitted, E/mu = {known}. Nothing is added to it.",)
    sentences = []
    if before is None or after is None:
        sentences.append(f"On data that were not used: {mm(before)} before, {mm(after)} after.")
    else:
        change = f"{mm(before)} before, {mm(after)} after"
        gain = found.gain
        if gain is not None and gain.value > 0.0:
            low, high = (f"{100.0 * v:.0f}" for v in (gain.low, gain.high))
            # Pictures that do not differ, as of one pose, give no interval.
            interval = f" (95 % interval {low} to {high} %)" if low != high else ""
            change += f", {percent(gain.value)} less{interval}"
        elif _worse(found):
            change += ", so the extended model predicts these data worse"
        else:
            change += ", so nothing is gained there"
        sentences.append(f"On data that were not used: {change}.")
        if found.material_err is not None and after > found.material_err:
            digits = 2 if mm(after) != mm(found.material_err) else 4
            matters = f"the {mm(found.material_err, digits)} that do not matter"
            left = "That" if digits == 2 else f"That is {mm(after, digits)}, which"
            sentences.append(f"{left} is still more than {matters}.")
            if found.verdict != "unexplained":
                sentences.append("Fitted to these data as well, the model leaves less than that.")
        sentences += _less_than_learned(found)
    what = AS_FITTED
    if found.effects:
        several = len(found.effects) > 1
        what = f"{'these causes' if several else 'this cause'}, all else that was fitted"
    if _worse(found):
        plain = rounded(found.baseline.specific_modulus[0])
        sentences.append(
            f"Do not use {file} for such manipulations: it holds {what}, learned from the other "
            f"data, which does not hold there. The plain model with E/mu = {plain} m^2/s^2 is "
            "nearer."
        )
        return tuple(sentences)
    sentences.append(f"{load}: it holds {what}, and E/mu = {known}.")
    open_ = [title(e.name) for e in by_share(found.effects) if e.rivals]
    if open_:
        sentences.append(
            f"Of causes that the data do not tell apart it holds the first: {enumerated(open_)}."
        )
    own = [e.name for e in found.effects if any(n.own for n in e.parameters.values())]
    if own:
        events = enumerated([title(name) for name in own])
        keys = enumerated([f"effects.{name}" for name in own])
        sentences.append(
            f"What differs between recordings ({events}) happened once in each of them, and the "
            f"file holds the mean. Take {keys} out of it for motions in which nothing of the kind "
            "happens."
        )
    return tuple(sentences)
