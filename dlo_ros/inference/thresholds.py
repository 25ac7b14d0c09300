# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The thresholds of inference, identification and diagnosis: all numbers that decide something.

A threshold decides whether something is named, believed, told, tried or left out. Each stands here
once, with what it decides and why it has its value; whoever needs one takes it from here, and the
same question is decided by the same number everywhere. A new one is the last resort. Settings of
the numerics (iterations, resolutions, where an iteration ends, how much is done at once) decide
how exact a result is and how long it takes: they stand where they are used.
"""

from __future__ import annotations

# Log evidence.
WORTH = 3.0
"""Gain in log evidence from which one model is preferred to another: 20 to 1, beyond which evidence
is called strong (Kass and Raftery, Bayes factors, 1995)."""
NAMED = 5.0
"""Loss of log evidence without a cause, from which the cause is named, and from which a model need
not be fitted at all: 150 to 1, called very strong there."""
INDISPENSABLE = 10.0 * WORTH
"""Loss of log evidence by the linearised posterior, from which no fit without a cause is tried, and
gain from which a fit with it is: a linear prediction may be wrong by several times, hardly by
ten. By fits, the loss from which an effect is there, whatever its size."""
PROMISING = 0.3
"""Predicted gain over the largest one, from which a proposal is simulated: the prediction is
linear, and no better than that."""
SAME_GAIN = 0.01
"""Share of a gain in log evidence up to which two models gain alike: no law is more exact than
that, and two effects may differ by less, such as a damping and a creep that soon dies out."""

# Standard deviations.
CERTAIN = 3.0
"""Standard deviations from which a number differs from another, and a picture from a model, for
certain: 1 in 370 of a normal variable."""
OUTLIER = 6.0
"""Robust standard deviations from which a single picture or message is an outlier: differences of
neighbours have longer tails than noise, as a motion is not even."""
BELIEVED = 4.0
"""Standard deviations up to which a value that was measured beforehand may be wrong: a fit that
pushes it further does the work of a cause that nobody names."""
IMMATERIAL = 0.3
"""Error over a standard deviation or residual up to which it does not matter: added to it in
quadrature it makes it larger by less than a twentieth."""
MUCH_LARGER = 2.0
"""Ratio of two deviations from which one is much larger: from a model that misses by so much more
no fit begins, and a residual of so much more than the noise is no noise."""
APART = 3.0
"""Ratio of what one recording shows to what the others do, from which it shows something of its
own: errors of one tracker and speeds of one experiment are within this factor of each other."""
IDENTIFIED = 0.25
"""Relative standard deviation below which the data determine a number: it is not zero, nor twice as
large, by four standard deviations."""
UNBOUNDED = 1.0
"""Relative standard deviation from which no standard deviation is given: the number may be zero."""

# Errors of shapes (ERR), one over another.
CLEARLY_LESS = 0.8
"""Error over another one, below which it is clearly less: fits that end in one minimum, some of
them early, differ by less."""
LOWERS = 0.1
"""Share of ERR that a cause must take away to be named: true causes have taken away a tenth and
more."""
SMALL_SHARE = 0.05
"""Share of a whole below which a part is negligible: effects that only compensate for the law of
another one, such as a segment for that of a gradient, have taken away a thirtieth of an error."""
OWN = 1.3
"""ERR over that of the measurement itself, up to which nothing is left to explain: what a model
lacks is less than the noise then."""
FAR = 0.4
"""ERR over that without a cause, below which it is named whatever little of the log evidence is
lost: errors that die out over time hold slow errors for cheap, however large they are."""
MOST_LEFT = 0.35
"""Share of the plain model's ERR that may be left where causes are named: where more is, a few
effects may stand for another one that nobody knows."""
MOST_LEFT_BY_MANY = 0.5
"""The same beside a set-up that is off in many ways: something is always left there."""

# The set-up.
BEYOND = 2.0
"""Tolerances from neutral, from which a number of the set-up may be a cause: 1 in 22 of those that
are right within their tolerance."""
FEW_DEPARTURES = 2
"""Things that depart from neutral for certain, up to which a set-up is off in few ways: of one with
errors of all kinds seven to nine do."""
NOTABLE = 0.2
"""Tolerances from neutral, from which a number of the set-up is off: two programs that simulate the
same DLO differ by less."""
UNDERSTATED = 2.0
"""Standard deviations that an error may be for each that a fit states: laws that are not the true
ones shift numbers, and so do errors fixed in space. Of 3000 numbers of the set-up in realistic
cases, 1 in 20 was more than 3.4 of them off, 1 in 100 more than 5."""

# The measurement.
TRACKER_ERROR = 0.01
"""Largest error over L of shapes: no tracker that deserves the name errs more, so that a motion is
seen, and a model is wrong, from there on."""
STAYING_SHARE = 0.1
"""Share of the error that stays which counts as the measurement's where the DLO does not move:
there nothing tells it from an error of the model."""
LARGEST_GAP = 0.1
"""Distance over L between measured points and their spline, beyond which they are not of one shape:
ten times a tracker's largest error."""
MOST_GROSS = 0.2
"""Share of the pictures up to which they may be grossly wrong: more are no exception."""
FEWEST = 10
"""Frames, messages or pictures from which anything is concluded from their scatter: it is known to
a quarter then."""
FEWEST_FRAMES = 4
"""Frames below which an error that dies out cannot be separated from one that stays: together they
have three numbers, and the noise a fourth."""
CHANCE = 0.01
"""Chance at which something that random numbers do as well is significant: the usual 1 in 100."""

# How a recording begins, and when.
LEAST_DELAY = 0.1
"""Delay [s] from which it is told: five times the tolerance of `command_delay`."""
UNEXPLAINED_MOTION = 0.1
"""Share of the ends' motion, and of what the command leaves as it is, that may be left with the
delay that explains most: where more is, it is another motion."""
FARTHER_THAN_LED = 5.0
"""Path of a point over the distance by which the command carries it, from which a DLO has been let
go or was in motion before: a DLO in equilibrium moves as its command does."""
STEADY = 0.7
"""Distance covered over the length of a path at least, where it is a motion, since noise goes to
and fro; and share of the path in one step at most: a picture that is wrong is a single step."""

# What is planned.
STEEPEST = 0.5
"""Displacement over L for a unit change of ln(E/mu), from which a manipulation is near a snap and
cannot be relied on: where 1 % more moves it by half of that, tolerances of the set-up decide
where it goes."""

# What was hit.
UNEXPLAINED_PICTURES = 0.3
"""Share of the outlier pictures that a peg may leave unexplained of the recordings in which it was
hit: its place is rough yet, and simulations judge it after that."""
SLACK = 1.5e-3
"""Depth [m] by which an observed shape may seem to reach into a peg or wall: noise, and the
spline's own error."""
