# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The thread that rehearses motions, without ROS."""

import threading
import time

from dlo_ros.nodes.rehearsal_thread import RehearsalThread, Request


def answered(thread, seconds=10.0):
    """The next answer, waited for."""
    deadline = time.monotonic() + seconds
    while (answer := thread.take()) is None and time.monotonic() < deadline:
        time.sleep(0.01)
    return answer


def test_a_motion_under_way_has_no_answer_after_a_reset():
    """Its stamps are those of a time that is over, as where a recording is played again."""
    thread, begun, go_on = RehearsalThread(), threading.Event(), threading.Event()

    def slow(simulation):
        begun.set()
        assert go_on.wait(10.0)
        return "old"

    thread.ask(Request(lambda: None, slow))
    assert begun.wait(10.0)
    thread.forget()
    go_on.set()
    thread.ask(Request(lambda: None, lambda simulation: "new"))
    answer = answered(thread)
    thread.stop()
    assert answer.found == "new" and thread.take() is None
