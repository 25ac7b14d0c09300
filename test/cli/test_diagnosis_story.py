# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a person reads first of a diagnosis: how wrong, why, what is gained, and the set-up."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from diagnoses import DEGREE, KNOWN, LENGTH, MASS, SETUP, answers, case, found
from html_check import checked

from dlo_ros.cli.diagnosis_output import WIDTH, report, summary, tree
from dlo_ros.cli.diagnosis_story import headline
from dlo_ros.cli.diagnosis_words import is_sized, rows
from dlo_ros.cli.set_up_table import setup_lines
from dlo_ros.diagnosis import Gain, NamedEffect, Number, SetupNumber
from dlo_ros.effects import effects
from dlo_ros.identification.identifiability import enumerated
from dlo_ros.report.diagnosis import diagnosis_page

SLIP = NamedEffect(
    "clamp_slip",
    {
        "length": Number(0.0294, 0.0003, "m"),
        "onset": Number(0.65, 0.41, "s", {"0_push": 0.247, "3_pendulum": 1.08}),
    }, (), 0.67,
)  # fmt: skip


BENT = {"clamp_angle.start": SetupNumber(-8.0 * DEGREE, 0.4 * DEGREE, 3.0 * DEGREE, "rad")}


def test_moments_of_each_recordings_own_are_told():
    made = case(causes=[SLIP])
    _, why, gain = answers(made)
    assert "(29.4 +- 0.3 mm of free length gained, at 0.25 to 1.1 s, depending on the" in why
    assert "(slip through a clamp) happened once in each of them, and the file holds the" in gain
    assert "Take effects.clamp_slip out of it for motions in which nothing" in gain
    length, onset = tree(made)["effects"][0]["parameters"].values()
    assert onset["own"] == {"0_push": 0.247, "3_pendulum": 1.08} and "own" not in length
    _, (_, shown, _) = rows(SLIP, LENGTH)
    assert shown == "247 ms in 0_push, 1.1 s in 3_pendulum"


def test_how_wrong_why_and_what_is_gained():
    wrong, why, gain = answers(case())
    assert "2.4 mm off on average (0.60 % of the length), on data that were not used" in wrong
    assert "0.10 mm off; less than 0.20 mm does not matter" in wrong
    assert why == (
        "Certain (71 % of the error): a mass is fixed to the DLO (mass 31 +- 2 g, at "
        "250 +- 4 mm from the start)."
    )
    assert "2.4 mm before, 0.63 mm after, 74 % less (95 % interval 60 to 81 %)" in gain
    assert "That is still more than the 0.20 mm that do not matter. Fitted to these data as" in gain
    assert (
        "still more than the 0.20 mm that do not matter." in answers(case(verdict="unexplained"))[2]
    )
    assert "still more" not in answers(case(after=1.5e-4))[2]
    close = answers(case(after=2.04e-4))[2]  # 0.20 of 0.20 mm, to two digits
    assert "That is 0.2040 mm, which is still more than the 0.2000 mm that do not matter" in close
    assert "Load extended.yaml" in gain and "5000 +- 12 m^2/s^2" in gain


def test_it_is_told_what_has_the_rest_of_the_error():
    rest = "The rest of the error goes with a set-up that is off within its tolerances"
    assert rest in answers(case(causes=[replace(MASS, share=0.06)]))[1]
    assert rest not in answers(case())[1]
    far = case(causes=[replace(MASS, share=0.06)], setup=BENT)
    assert "a set-up that is off beyond its tolerances (see the table)" in answers(far)[1]


def test_a_cause_that_changes_nothing_on_other_data_is_told_as_that():
    (_, why, _) = answers(case(causes=[replace(MASS, share=0.0)]))
    assert "The simulation comes as near without it." in why


def test_pictures_that_do_not_count_are_told():
    said = (
        "128 of 1288 pictures (first 128) do not count: the observed shape is grossly wrong there."
    )
    made = replace(case(), left_out=said)
    assert answers(made)[0].endswith(said)


def test_rivals_are_told_as_one_of_them():
    made = case(causes=[replace(MASS, rivals=("constant_force", "clamp_angle"))])
    (_, why, gain) = answers(made)
    assert why.startswith(
        "One of these three is certain (71 % of the error), but the data do not determine which: "
        "a mass"
    )
    assert "or an even force, such as a draught" in why
    assert "Certain:" not in why
    assert "Of causes that the data do not tell apart it holds the first: mass on the DLO." in gain
    assert "tell apart" not in answers(case())[2]


def test_what_nothing_explains_is_told_as_that():
    made = case("unexplained")
    assert headline(made).endswith("this is part of why: mass on the DLO.")
    told = answers(made)[1]
    assert "The remaining error (0.63 mm) is explained by no cause that is known here, and" in told
    bare = case("unexplained", causes=())
    assert headline(bare).endswith("no cause that is known here is certain.")
    assert "The error (2.4 mm) is explained by no cause" in answers(bare)[1]
    assert "Nothing is added" in answers(bare)[2]
    fitted = case("unexplained", causes=(), setup=SETUP)
    told = answers(fitted)[1]
    assert "the set-up within its tolerances explains a part. The rest (0.63 mm) is" in told
    assert "it holds the set-up as fitted" in answers(fitted)[2]
    near = replace(fitted.extended, err_train=6e-4, err_holdout=1.5e-4)  # 0.20 mm do not matter
    told = answers(replace(fitted, extended=near))[1]
    assert "The rest (0.60 mm on the recordings learned from) is explained by no" in told
    enough = replace(fitted.extended, err_train=1.8e-4, err_holdout=1.5e-4)
    told = answers(replace(fitted, extended=enough))[1]
    assert "The set-up within its tolerances leaves an error that matters; with" in told
    assert told.endswith("(extended.yaml holds them) 0.15 mm are left, which do not matter.")
    far = case("unexplained", causes=(), setup=SETUP | BENT)
    beyond = "off by more than twice the tolerance in direction of a clamp (at the start)"
    assert f"No cause is certain; the set-up, {beyond}, explains a part." in answers(far)[1]
    twice = BENT | {"clamp_angle.end": BENT["clamp_angle.start"]}
    many = case("unexplained", causes=(), setup=SETUP | twice)
    assert "the tolerance in direction of a clamp (2 numbers), explains" in answers(many)[1]


def test_what_may_act_is_told_with_all_that_may_act_in_its_place():
    (cause, *_) = case("unexplained").effects
    fitted = case("unexplained", causes=(), setup=SETUP)
    alone = replace(cause, share=0.2, rivals=(), rival_values={})
    told = answers(replace(fitted, uncertain=(alone,)))[1]
    assert "Not certain, but this may be 20 % of the error: " in told
    several = replace(alone, share=None, rivals=("constant_force", "camera_rotation"))
    told = answers(replace(fitted, uncertain=(several,)))[1]
    assert "Not certain, but one of these three may be a part of it: " in told
    assert told.endswith("; or the camera is turned against the board.")
    turned = replace(several, name="camera_rotation", parameters={}, rivals=(several.name,))
    assert answers(replace(fitted, uncertain=(several, turned)))[1] == told
    assert "Not certain" not in answers(fitted)[1]


def test_adequate_says_whether_it_is_as_good_as_matters():
    assert "agrees with the recordings; it is 0.15 mm" in headline(case("adequate", (), 1.5e-4))
    assert "no cause" in headline(case("adequate", (), 4e-3))
    tolerated = case("adequate", (), 4e-3, setup=SETUP)
    assert "4.0 mm off, for a set-up that is a little off" in headline(tolerated)
    assert "within twice its tolerance: see the table" in answers(tolerated)[1]
    assert "and for mass on the DLO" in headline(case("adequate", setup=SETUP))
    exact = {k: replace(n, value=0.0) for k, n in SETUP.items() if k.startswith("clamp")}
    made = case("adequate", setup=exact)
    assert headline(made).endswith(
        "for mass on the DLO: no more than a set-up within its tolerances may do."
    )
    assert "a little off in several places" not in answers(made)[1]
    quiet = case("adequate", (), 4e-3, setup=exact)
    assert "No number of the set-up is off for certain; together" in answers(quiet)[1]
    one = case("adequate", (), 4e-3, setup=exact | {k: SETUP[k] for k in list(SETUP)[:1]})
    assert "a little off in one place, each within" in answers(one)[1]
    small = case("adequate", before=1.5e-4)
    assert answers(small)[1].startswith("Nothing that matters is wrong. This is certain all the")
    assert "Nothing that matters" not in answers(case("adequate"))[1]
    far = case("adequate", (), 4e-3, setup=SETUP | BENT)
    assert headline(far).endswith("for a set-up that is off beyond its tolerances.")
    told = answers(far)[1]
    beyond = "off by more than twice the tolerance in direction of a clamp (at the start): see the"
    assert beyond in told


def test_words_are_joined_as_people_do():
    assert enumerated([]) == ""
    assert enumerated(["a"]) == "a"
    assert enumerated(["a", "b"]) == "a and b"
    assert enumerated(["a", "b", "c"]) == "a, b and c"


def test_one_pose_has_no_interval():
    gain = answers(replace(case(), gain=Gain(0.74, 0.74, 0.74)))[2]
    assert "74 % less." in gain and "interval" not in gain


def test_many_rivals_are_counted_in_the_headline():
    rivals = ("constant_force", "clamp_angle", "plasticity")
    assert "mass on the DLO (or one of 3 others)" in headline(
        case(causes=[replace(MASS, rivals=rivals)])
    )


def test_a_rival_that_is_a_cause_itself_would_have_other_numbers():
    kink = NamedEffect("intrinsic_curvature", {}, ())
    turned = NamedEffect("clamp_angle", {}, ("intrinsic_curvature",))
    made = case(causes=[kink, turned])
    assert headline(made).endswith("direction of a clamp (or another curvature at rest).")
    assert "; or with other numbers than those told here, the DLO is curved" in answers(made)[1]
    alone = case(causes=[turned])
    assert headline(alone).endswith("direction of a clamp (or curvature at rest).")
    assert "; or the DLO is curved" in answers(alone)[1]


def test_less_on_held_out_data_than_on_those_learned_from_has_its_reason():
    made = case()  # as much on both
    reason = "a wrong model shows more in some shapes and motions than in others."
    assert reason not in answers(made)[2]
    larger = replace(made, baseline=replace(made.baseline, err_train=4.2e-3))
    assert f"data learned from the error is larger (4.2 mm before): {reason}" in answers(larger)[2]
    both = replace(larger, extended=replace(made.extended, err_train=0.9e-3))
    assert f"(4.2 mm before, 0.90 mm after): {reason}" in answers(both)[2]
    smaller = replace(made, baseline=replace(made.baseline, err_train=1e-3))
    assert reason not in answers(smaller)[2]


def test_no_gain_is_no_gain():
    made = replace(case(after=3e-3), gain=Gain(-0.25, -0.6, 0.1))
    assert "nothing is gained" in answers(made)[2] and "Load extended" in answers(made)[2]


def test_a_model_that_predicts_worse_is_not_to_be_used():
    """Unless what it misses does not matter."""
    worse = Gain(-0.25, -0.3, -0.2)
    gain = answers(replace(case(after=3e-3), gain=worse))[2]
    assert "2.4 mm before, 3.0 mm after, so the extended model predicts these data worse" in gain
    assert "Do not use extended.yaml for such manipulations" in gain and "Load" not in gain
    assert "plain model with E/mu = 5000 m^2/s^2 is nearer" in gain
    small = replace(case(before=1.2e-4, after=1.5e-4), gain=worse)
    assert "Load extended.yaml" in answers(small)[2]


def test_what_cannot_be_simulated_is_no_number():
    made = case(before=None)
    assert headline(made).startswith("The simulation is off, and this is why")
    assert "cannot be simulated" in answers(made)[0]


def test_a_phrase_that_names_two_sides_names_its_own():
    for name, effect in effects().items():
        pairs = [pair for q in effect.quantities() for pair in q.sides if all(pair)]
        phrase = effect.report_phrase()
        if " or " not in phrase or not pairs:
            continue
        told = [f"{above} or {below}" in phrase for above, below in pairs]
        assert any(told) or not re.search(r"(more|larger|longer|too \w+) or ", phrase), name
    twist = effects()["twisting_stiffness"]
    assert "is smaller than that" in twist.report_phrase("smaller")
    soft = NamedEffect("stiff_segment", {"ratio": Number(0.5, 0.1, "")}, ())
    assert headline(case(causes=[soft])).endswith("this is why: softer segment.")


@pytest.mark.parametrize("made", [case(), case(setup=SETUP), case("unexplained", ()), found()])
def test_no_line_of_the_terminal_is_wider_than_a_screen(made):
    lines = summary(made, LENGTH, Path("build/diagnosis"))
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith(f"{made.verdict}: ")
    for question in ("How wrong is my simulation?", "Why?", "What do I gain?"):
        assert question in lines
    assert "build/diagnosis/extended.yaml" in "\n".join(lines)


def test_the_page_begins_with_the_answers_and_ends_with_the_trace():
    made = case(setup=SETUP)
    page = diagnosis_page(report(made, KNOWN))
    checked(page)
    places = [
        page.index(f">{words}")
        for words in (
            "How wrong is my simulation?", "Why?", "What do I gain?", "Where and when",
            "The causes in numbers", "Your set-up, as far as the data determine it",
            "What to record next",
        )
    ]  # fmt: skip
    assert places == sorted(places)
    assert "3 numbers that may well be right" in page
    assert "\N{PLUS-MINUS SIGN} 0.4 degrees" in page
    assert "says which side is positive in report.json" in page
    assert "degrees clockwise</td><td>3.0 degrees</td><td>clockwise</td>" in page
    assert page.index(">camera</th>") < page.index(">camera scale<") < page.index(">clamps</th>")


def test_a_single_shape_is_shown_along_the_rope():
    made = found(frames=1)
    page = diagnosis_page(report(made, KNOWN))
    checked(page)
    assert "distance [mm]" in page and "ERR [mm]" not in page
    assert "ERR [mm]" in diagnosis_page(report(found(), KNOWN))


@pytest.mark.parametrize(
    ("effect", "key", "value", "std", "unit", "sentence"),
    [
        ("length_error", "difference", -0.0021, 0.0003, "m",
         "the DLO is shorter than the parameter file says (by 2.1 +- 0.3 mm)"),
        ("length_error", "difference", 0.0021, 0.0003, "m",
         "the DLO is longer than the parameter file says (by 2.1 +- 0.3 mm)"),
        ("length_error", "difference", 0.0002, 0.0003, "m",
         "the DLO is longer or shorter than the parameter file says (0.2 +- 0.3 mm longer)"),
        ("command_delay", "delay", -0.02, 0.003, "s",
         "the DLO does not move when the command says, but earlier (by 20 +- 3 ms)"),
        ("air_drag", "coefficient", 0.03, 0.002, "N s/m^2",
         "the air slows the DLO more than the parameter file says (by 0.030 +- 0.002 N s/m^2)"),
        ("camera_scale", "ratio", 1.02, 0.002, "",
         "the camera shows everything too small (ratio 1.020 +- 0.002)"),
        ("stiff_segment", "ratio", 0.5, 0.1, "",
         "one part of the DLO is softer than the rest (ratio 0.50 +- 0.10)"),
        ("stiff_segment", "ratio", 11.0, 9.0, "",  # by its logarithm it is far from 1
         "one part of the DLO is stiffer than the rest (ratio 11 +- 9). That it acts is certain"),
        ("stiff_segment", "ratio", 0.6, 0.25, "",
         "one part of the DLO is stiffer or softer than the rest (ratio 0.6 +- 0.2)"),
        ("stiffness_gradient", "change", -0.3, 0.05, "",
         "the DLO is stiffer towards the start (by 30 +- 5 %)"),
        ("clamp_angle", "end", -0.1, 0.01, "rad",
         "direction than the command says (at the end 5.7 +- 0.6 degrees counterclockwise)"),
        ("gravity_tilt", "angle", 0.1, 0.01, "rad",
         "the board does not hang plumb (5.7 +- 0.6 degrees counterclockwise)"),
        ("constant_force", "x", -0.1, 0.01, "N/m", "(0.100 +- 0.010 N/m to the left)"),
    ],
)  # fmt: skip
def test_a_cause_says_its_side_in_words(effect, key, value, std, unit, sentence):
    cause = NamedEffect(effect, {key: Number(value, std, unit)}, ())
    assert sentence in answers(case(causes=[cause]))[1]
    ((_, shown, meaning),) = rows(cause, LENGTH)
    q = next(q for q in effects()[effect].quantities() if q.name == key)
    side = q.side(value)
    # As in the sentence the word stands for the sign, and the table says which side is positive.
    assert side and shown.endswith(f" ({side})" if q.neutral else f" {side}") and shown[0] != "-"
    assert meaning.endswith(f"{'above 1' if q.neutral else 'positive'}: {q.side(q.neutral + 1.0)}")


def test_what_was_fitted_beside_the_set_up_is_told_with_it():
    """A damping that the file guesses has no tolerance; where it is not determined that is said."""
    fitted = SETUP | {
        "air_drag.coefficient": SetupNumber(0.03, 0.004, None, "N s/m^2"),
        "internal_damping.relaxation_time": SetupNumber(0.01, None, None, "s"),
        "surface_friction.force": SetupNumber(0.2, None, None, "N/m", 0.02),
        "stiff_segment.centre": SetupNumber(0.12, 0.004, None, "m"),
    }
    made = case(setup=fitted)
    lines = {line.name: line for line in setup_lines(made)}
    drag = lines["air drag"]
    assert (drag.off, drag.tolerance, drag.notable) == ("0.030 +- 0.004 N s/m^2 more", "none", True)
    unknown = lines["internal damping"]
    assert (unknown.off, unknown.tolerance, unknown.notable) == ("not determined", "none", False)
    light = lines["friction with the board"]
    assert light.off == "0.20 +- 0.02 N/m, at the extended file's density" and light.notable
    place = lines["stiffer or softer segment, its middle"]
    assert (place.off, place.notable) == ("120 +- 4 mm", False)
    told = tree(made)["setup"]
    assert told["air_drag.coefficient"] == {
        "value": 0.03, "std": 0.004, "tolerance": None, "unit": "N s/m^2"
    }  # fmt: skip
    assert told["internal_damping.relaxation_time"]["std"] is None
    text = "\n".join(summary(made, LENGTH, Path("build/diagnosis")))
    assert "air drag" in text and "0.030 +- 0.004 N s/m^2 more" in text
    page = diagnosis_page(report(made, KNOWN))
    checked(page)
    assert "more</td><td>none" in page and "not determined</td><td>none" in page
    adequate = case("adequate", (), 4e-3, setup=fitted)
    assert "within twice its tolerance" in answers(adequate)[1]


def test_a_cause_may_be_certain_and_its_strength_unknown():
    """The mass of a plug, say, where nothing tells the weight of the DLO itself."""
    numbers = {"mass": Number(0.03, 0.04, "kg"), "extent": Number(0.07, 0.0004, "m")}
    plug = NamedEffect("connector", numbers, (), 0.5)
    assert not is_sized(plug, LENGTH) and is_sized(MASS, LENGTH)
    told = answers(case(causes=[plug]))[1]
    assert told.endswith("the numbers are those of the best fit.")
    assert "how strongly" not in answers(case())[1]
    both = case(causes=[plug, replace(plug, name="quadratic_drag", parameters={
        "coefficient": Number(0.1, 0.2, "N s^2/m^3")})])  # fmt: skip
    two = answers(both)[1]
    assert "): plug at the free end and drag that grows with the square of speed." in two
    assert two.count("how strongly") == 1 and "weigh it" not in two
    guessed = replace(both, extended=replace(both.extended, scale_std=0.7))
    assert "only in proportion to the weight of the DLO" in answers(guessed)[1]
    # A scale that is known tells nothing of it.
    rubs = {"moment": Number(0.08, 0.09, "N m"), "curvature": Number(0.25, 0.1, "1/m")}
    assert not is_sized(NamedEffect("hysteresis", rubs, ()), LENGTH)
    # Of a vector one component is enough, and what has no std says nothing against it.
    moved = NamedEffect("clamp_offset", {"end": Number((0.002, 1e-5), (4e-4, 3e-4), "m")}, ())
    assert is_sized(moved, LENGTH)
    level = {"offset": Number(-0.8, 0.003, "m"), "angle": Number(-4e-4, 2e-3, "rad")}
    assert is_sized(NamedEffect("wall", level, ()), LENGTH)
    assert is_sized(NamedEffect("point_mass", {"mass": Number(0.03, None, "kg")}, ()), LENGTH)


def test_causes_stand_by_their_share():
    turned = NamedEffect(
        "gravity_tilt", {"angle": Number(0.03, 0.001, "rad")}, (), share=0.8, rival_values={}
    )
    made = case(causes=[MASS, turned])
    assert headline(made).index("tilt") < headline(made).index("mass")
    (_, why, _) = answers(made)
    # The meaning of a share stands before the first of them.
    assert why.index("The share of each cause, in") < why.index("80 %") < why.index("71 %")
    assert "The share of each cause" not in answers(case())[1]
