# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The commands on one rod over time, joined to one continuous motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlo_ros.command import END, NANOSECONDS, START, Command, Motion
from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray, SplineBasis

BRIDGE = 0.02  # [s] in which a command is reached that begins elsewhere than the one before
SAME_PLACE = 1e-6  # of L


@dataclass
class CommandTimeline:
    """The commands of a motion, each continued from the imposed values before it.

    Poses that are sent one by one jump from each to the next; no hand does, and a stiff rod that is
    moved in no time breaks. So a command that begins elsewhere is reached within `BRIDGE`.

    Args:
        motion: the commands; more may come.
        following: the command that the rod followed last.
        standing_in: commands that replace a given command, by its identity, beside the command
            itself.
        whole_path: distance that imposed points travel under the commands that were known first
            [m].
        began: stamp of the first observed shape [ns].
    """

    motion: Motion
    following: Command | None = None
    standing_in: dict[int, tuple[Command, Command]] = field(default_factory=dict)
    whole_path: float = 0.0
    began: int | None = None

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Be a deep copy, or another process's: copies of the commands have other identities."""
        self.__dict__.update(state)
        self.standing_in = {id(given[0]): given for given in self.standing_in.values()}

    def another(self) -> CommandTimeline:
        """A course of the same motion that goes its own way from here."""
        return replace(self, standing_in=dict(self.standing_in))

    def at(self, stamp: int, *, slips: bool) -> Command:
        """The command that holds at a stamp [ns].

        Args:
            slips: whether a grip slips, so that it matters how far the commands before have gone.

        Raises:
            InputError: there is none.
        """
        command = self.motion.at(stamp)
        if command is None:
            raise InputError("there is no dlo/command; the simulation needs to know what is held")
        if slips:
            self._count_paths()
        return self._stand_in(command)

    def _stand_in(self, command: Command) -> Command:
        return self.standing_in.get(id(command), (command, command))[1]

    def _count_paths(self) -> None:
        """Give every command the path of the imposed points under the commands before it.

        The whole path, over which a grip slips by its length, is that of the commands which were
        known first; where more follow, it slips on at the same rate.
        """
        commands = self.motion.commands
        if id(commands[-1]) in self.standing_in and all(
            self._stand_in(c).whole_path is not None for c in commands[-2:]
        ):
            return
        paths = self.motion.paths()
        self.whole_path = self.whole_path or paths[-1]
        for k, command in enumerate(commands):
            if self._stand_in(command).whole_path is None:
                before = 0.0
                if k:  # what came long ago may have been forgotten since
                    known = self._stand_in(commands[k - 1])
                    before = known.path_before + paths[k] - paths[k - 1]
                counted = replace(
                    self._stand_in(command), path_before=before, whole_path=self.whole_path,
                    began=self.began,
                )  # fmt: skip
                self.standing_in[id(command)] = command, counted

    def legs(self, now: int, stamps: Sequence[int]) -> list[list[int]]:
        """The stamps in groups that one command rules each, its last stop where it ends."""
        if not stamps:
            return []
        changes = sorted(c.stamp for c in self.motion.commands if now < c.stamp < stamps[-1])
        legs = []
        for until in [*changes, stamps[-1]]:
            leg = [s for s in stamps if now < s <= until]
            if not leg or leg[-1] < until:
                leg.append(until)
            legs.append(leg)
            now = until
        return [leg for leg in legs if leg]

    def begin(self, stamp: int, command: Command, q: FloatArray, basis: SplineBasis) -> Command:
        """The command (as `at` gave it) as it is followed from a stamp [ns] on.

        Args:
            q: control points of the rod now, shape (n, 4).
            basis: theirs.
        """
        before = self.following
        if before is None or before is command:
            return command
        here, turned = command.sample(stamp)
        old_position, old_rotation = before.sample(stamp)
        gap = 0.0
        for k, name in enumerate(command.names):
            if name in before.names:
                j = before.names.index(name)
                gap = max(gap, float(np.linalg.norm(here[k] - old_position[j])))
                if name in (START, END):
                    cosine = abs(float(turned[k] @ old_rotation[j]))
                    gap = max(gap, basis.length * 2.0 * float(np.arccos(min(cosine, 1.0))))
                    turned[k] = old_rotation[j]
                here[k] = old_position[j]
            elif name in (START, END):
                place = basis.evaluate(q[:, :3], np.array([basis.length * (name == END)]))[0]
                gap = max(gap, float(np.linalg.norm(here[k] - place)))
                here[k] = place
        if gap <= SAME_PLACE * basis.length:
            return command
        now = (stamp - command.stamp) / NANOSECONDS
        later = command.times > now + BRIDGE
        there, to = command.sample(stamp + round(BRIDGE * NANOSECONDS))
        unknown = np.full((2, *here.shape), np.nan)
        bridged = replace(
            command,
            times=np.concatenate([[now, now + BRIDGE], command.times[later]]),
            positions=np.concatenate([[here, there], command.positions[later]]),
            rotations=np.concatenate([[turned, to], command.rotations[later]]),
            velocities=np.concatenate([unknown, command.velocities[later]]),
            path_before=command.path_before + float(np.interp(now, command.times, command.path)),
            whole_path=command.whole_path,
        )
        for key, (given, standing) in list(self.standing_in.items()):
            if standing is command:
                self.standing_in[key] = given, bridged
                return bridged
        self.standing_in[id(command)] = command, bridged
        return bridged
