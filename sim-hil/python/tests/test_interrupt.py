"""Ctrl-C, as somebody presses it in the middle of a long call."""

import copy
import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from flixwalker import Batch, Model, Robot, mobility, walk
from flixwalker.env import FlixWalkerVectorEnv

MODEL = Model("W")
MANY = 100_000


def walked_robot() -> Robot:
    robot = Robot(MODEL)
    robot.run(30.0)
    return robot


def slow_env() -> FlixWalkerVectorEnv:
    envs = FlixWalkerVectorEnv(64, "speed", interval=1e4, seconds=1e5)
    envs.reset(seed=1)
    return envs


#: What is made, and how it is kept busy for longer than anybody waits.
LONG = {
    "one walk": (lambda: None, lambda _: walk(MODEL, 30.0, 0.0, seconds=1e4)),
    "many walks": (lambda: None, lambda _: walk(MODEL, 30.0, 0.0, np.arange(2000), seconds=1e3)),
    "mobility": (lambda: None, lambda _: mobility(MODEL, seconds=1e4)),
    "one robot of a batch": (lambda: Batch([MODEL]), lambda batch: batch.run(1e5)),
    "many robots": (lambda: Batch([MODEL] * MANY), lambda batch: batch.run(1e3)),
    "many starts": (lambda: Batch([MODEL] * 20_000), lambda batch: [batch.reset(range(20_000)) for _ in range(1000)]),
    "many new robots": (lambda: None, lambda _: [Batch([MODEL] * MANY) for _ in range(1000)]),
    "an environment": (slow_env, lambda envs: envs.step(np.zeros((64, 2)))),
    "a robot with its software": (lambda: Robot(MODEL), lambda robot: robot.run(1e5)),
    "a copy of it": (walked_robot, lambda robot: [copy.deepcopy(robot) for _ in range(1000)]),
}


@pytest.fixture(autouse=True)
def _keyboard():
    # A program that a shell started in the background ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("what", LONG)
def test_ctrl_c_ends_every_long_call_within_a_second_of_computing(what: str) -> None:
    make, call = LONG[what]
    made, pressed = make(), []

    def press() -> None:
        pressed.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.5, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        call(made)
    # A second of each of two cores, however busy the machine is with others.
    assert time.process_time() - pressed[0] < 2.0
    if isinstance(made, Batch) and len(made) < MANY:
        # Its arrays are those of where it came to, and it goes on from there.
        assert (made.time > 0.0) == (what == "one robot of a batch")
        assert (copy.deepcopy(made).position == made.position).all()
        made.run(0.01)
