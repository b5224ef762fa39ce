"""Batches: what a robot does, alone and in company."""

import collections
import copy
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

import numpy as np
import pytest

from flixwalker import Batch, Film, Model, mobility, walk

MODEL = Model("W")


def moved(robots: int, precision: str = "single", threads: int | None = None) -> np.ndarray:
    batch = Batch([MODEL] * robots, precision, threads)
    batch.reset(range(robots))
    batch.set_drive(30.0, 0.1 * np.arange(robots))
    batch.run(0.05)
    return batch.position.copy()


def test_a_robots_bits_do_not_depend_on_company_or_threads() -> None:
    for precision in ("single", "double"):
        many = moved(40, precision, threads=2)
        assert (moved(40, precision, threads=1) == many).all()
        assert (moved(7, precision) == many[:7]).all()


def test_arrays_are_written_in_place() -> None:
    batch = Batch([MODEL] * 3)
    position = batch.position
    before = position.copy()
    batch.set_drive([30.0, -30.0, 0.0], 0.5)
    batch.run(0.05)
    assert position is batch.position
    assert (np.abs(position - before)[:2].max(axis=1) > 1e-4).all()


def test_single_and_double_agree_before_chaos_takes_over() -> None:
    assert np.abs(moved(5) - moved(5, "double")).max() < 1e-4


def test_a_reset_robot_starts_anew_while_the_others_walk_on() -> None:
    batch = Batch([MODEL] * 4)
    batch.reset(range(4))
    start = batch.position.copy()
    batch.set_drive(30.0, 0.5)
    batch.run(0.05)
    walked = batch.position.copy()
    batch.reset([2], robots=[2])
    assert (batch.position[2] == start[2]).all()
    assert (batch.position[[0, 1, 3]] == walked[[0, 1, 3]]).all()
    assert batch.energy[2] == 0.0


def test_a_time_is_a_whole_number_of_steps_and_long_steps_are_said_to_be_off() -> None:
    batch = Batch([MODEL])
    for seconds in (4e-5, 0.12345):
        with pytest.raises(ValueError, match="choose a whole number of steps"):
            batch.run(seconds)
    assert batch.time == 0.0
    batch.run(0.3, 1e-4)
    with pytest.warns(UserWarning, match="off by more than 1 %"):
        batch.run(0.01, 1e-3)


def test_a_change_of_drive_takes_the_time_of_a_ramp() -> None:
    batch = Batch([MODEL] * 2)
    batch.set_drive(30.0, [0.0, 0.0])
    batch.run(0.5)
    before = batch.energy.copy()
    batch.set_drive([30.0, -30.0], 0.0)
    batch.run(0.5)
    # The one whose rotors turn about pays for it.
    spent = batch.energy - before
    assert spent[1] > 0.0 and spent[1] != spent[0]


def test_bad_input_says_what_to_do() -> None:
    batch = Batch([MODEL] * 3)
    with pytest.raises(ValueError, match="f_hz has 2 values: give 1 or 3"):
        batch.set_drive([1.0, 2.0], 0.0)
    with pytest.raises(ValueError, match="f_hz holds NaN"):
        batch.set_drive(np.nan, 0.0)
    with pytest.raises(ValueError, match="-120 to 120 Hz"):
        batch.set_drive(1000.0, 0.0)
    with pytest.raises(IndexError, match="robot 3: this batch has 0 to 2"):
        batch.set_drive(1.0, 0.0, robots=[3])
    with pytest.raises(ValueError, match="step is 0.01"):
        batch.run(1.0, 0.01)
    stiff = MODEL.replace({"contact.stiffness_n_per_m": 1e6})
    with pytest.raises(ValueError, match="stable up to .* choose that or less"):
        Batch([stiff] * 2).run(0.1, 1e-3)
    with pytest.raises(ValueError, match="positions hold inf"):
        batch.reset([1], robots=[0], positions=[[np.inf, 0.0]])
    with pytest.raises(ValueError, match="1 seeds for 3 robots"):
        batch.reset([1])
    with pytest.raises(ValueError, match="bench-fixed has no legs"):
        Batch([Model("bench-fixed")])
    with pytest.raises(ValueError, match='"single" or "double"'):
        Batch([MODEL], "half")
    with pytest.raises(ValueError, match="one model at least"):
        Batch([])


def test_walks_are_those_of_the_studies() -> None:
    table = walk(MODEL, 30.0, [0.0, 60.0], seeds=[1, 2], seconds=0.2)
    alone = walk(MODEL, 30.0, 60.0, seeds=2, seconds=0.2)
    assert table["forward_m_s"][1] == alone["forward_m_s"][0]
    assert table["upright"].all()
    with pytest.raises(ValueError, match="-120 to 120 Hz"):
        walk(MODEL, 500.0, 0.0)


def test_a_walk_that_fails_is_a_row_that_says_why_and_the_others_are_whole() -> None:
    soft = {f"legs.{leg}.friction": 0.9 for leg in ("fl", "fr", "rl", "rr")}
    good, legless = MODEL.replace(soft), Model("bench-fixed")
    seeds = [1, 2**63 + 1, 2**53 + 1]
    table = walk([good, legless, good], 30.0, 20.0, seeds, seconds=0.2)
    assert table["failure"].tolist()[::2] == ["", ""] and "has no legs" in table["failure"][1]
    assert np.isnan(table["forward_m_s"][1]) and not table["upright"][1]
    assert table["seed"].tolist() == seeds and table["seed"].dtype == np.uint64
    alone = walk(good, 30.0, 20.0, seeds[2], seconds=0.2)
    assert all(table[name][2] == alone[name][0] for name in table)


def test_mobility_is_a_row_a_walk() -> None:
    frame = mobility(MODEL, [-30, 30], [0, 90], [1, 2, 3], seconds=0.05)
    assert len(frame) == 12
    assert set(frame.columns) >= {"f_hz", "theta_deg", "seed", "forward_m_s", "yaw_rad_s"}


def test_a_film_becomes_a_page() -> None:
    batch = Batch([MODEL])
    film = Film(MODEL)
    with pytest.raises(ValueError, match="frame"):
        film.to_html("empty")
    for _ in range(3):
        film.shoot(batch, 0)
        batch.run(0.01)
    assert "<title>a walk" in film.to_html("a walk")


def test_a_seed_that_is_none_and_a_read_only_array_are_refused() -> None:
    batch = Batch([MODEL] * 2)
    with pytest.raises(ValueError, match="a seed is -1"):
        batch.reset([0, -1])
    with pytest.raises(ValueError, match="a seed is -3"):
        walk(MODEL, 30.0, 0.0, seeds=-3, seconds=0.1)
    batch.position.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        batch.run(1e-3)


@pytest.mark.parametrize("robots", [[1.7], ["1"], [1, 1], [True, False], np.ones((2, 2), dtype=int)])
def test_robots_that_are_no_numbers_and_no_mask_are_refused(robots: object) -> None:
    with pytest.raises(ValueError, match="robots"):
        Batch([MODEL] * 3).set_drive(30.0, 0.0, robots=robots)


def test_a_mask_and_numbers_from_the_end_mean_what_they_mean_to_numpy() -> None:
    def moved_by(robots: object) -> np.ndarray:
        batch = Batch([MODEL] * 3)
        batch.set_drive(30.0, 0.5, robots=robots)
        batch.run(0.05)
        return np.flatnonzero(np.abs(batch.position[:, :2]).max(axis=1) > 1e-4)

    assert moved_by(np.array([False, False, True])).tolist() == [2]
    assert moved_by([-1]).tolist() == [2]
    assert moved_by(np.array([True, False, True])).tolist() == [0, 2]


@pytest.mark.parametrize("seeds", [[0.5, 1.0], ["3", "4"], [-1, 2], [True, False], [2**64, 0]])
def test_seeds_that_are_no_whole_numbers_are_refused(seeds: object) -> None:
    with pytest.raises(ValueError, match="seed"):
        Batch([MODEL] * 2).reset(seeds)


def test_texts_are_no_numbers_and_one_model_is_no_list() -> None:
    with pytest.raises(ValueError, match="f_hz holds '3'"):
        Batch([MODEL]).set_drive(["3"], 0.0)
    with pytest.raises(TypeError, match="give a list, one a robot"):
        Batch(MODEL)


def test_another_thread_may_look_while_one_runs() -> None:
    batch = Batch([MODEL] * 8)
    batch.set_drive(30.0, 0.5)
    runner = threading.Thread(target=batch.run, args=(2.0,))
    runner.start()
    times = [batch.time]
    while runner.is_alive():
        times.append(batch.time)
    runner.join()
    assert times == sorted(times) and batch.time == pytest.approx(2.0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_batch_runs_in_a_process_that_was_forked() -> None:
    batch = Batch([MODEL] * 40, threads=2)
    batch.set_drive(30.0, 0.5)
    batch.run(0.01)
    child = multiprocessing.get_context("fork").Process(target=batch.run, args=(0.05,))
    child.start()
    child.join(60)
    assert child.exitcode == 0
    batch.run(0.05)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("copied", [copy.deepcopy, copy.copy, lambda batch: pickle.loads(pickle.dumps(batch))])
def test_a_copy_goes_on_with_the_same_bits(precision: str, copied: Callable[[Batch], Batch]) -> None:
    batch = Batch([MODEL, MODEL.stranger(3), MODEL], precision, threads=1)
    batch.reset([1, 2, 3])
    batch.set_drive(30.0, 0.5)
    batch.run(0.0521)
    batch.set_drive([-30.0, 10.0, 30.0], 0.1)
    batch.run(0.0113)
    other = copied(batch)
    assert type(other) is Batch and other.threads == 1 and other.time == batch.time
    before = batch.position.copy()
    other.run(0.1)
    assert (batch.position == before).all()
    batch.run(0.1)
    for name in ("position", "orientation", "velocity", "angular_velocity", "yaw", "energy", "alive"):
        assert (getattr(batch, name) == getattr(other, name)).all()
    assert [other.model(robot) for robot in range(3)] == [batch.model(robot) for robot in range(3)]


def test_a_state_is_gone_back_to_and_one_of_something_else_is_refused() -> None:
    batch = Batch([MODEL] * 2)
    batch.set_drive(30.0, [0.1, 0.7])
    batch.run(0.05)
    state = batch.get_state()
    batch.run(0.2)
    first = batch.position.copy()
    batch.reset([5, 6], models=[MODEL.stranger(1)] * 2)
    batch.set_state(state)
    assert batch.time == pytest.approx(0.05)
    batch.run(0.2)
    assert (batch.position == first).all() and batch.model(0) == MODEL
    with pytest.raises(ValueError, match="of 2 robots: this batch has 1"):
        Batch([MODEL]).set_state(state)
    for damaged in (b"", state[:-1], state[:50] + b"x" + state[51:]):
        with pytest.raises(ValueError, match="damaged"):
            batch.set_state(damaged)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer sends signals here")
def test_who_handles_a_signal_may_look_at_the_robots_that_run() -> None:
    script = """
import signal
from flixwalker import Batch, Model
seen = []
batch = Batch([Model("W")] * 16, threads=1)
batch.set_drive(30.0, 0.3)
signal.signal(signal.SIGALRM, lambda *_: seen.append((batch.time, batch.get_state())))
signal.setitimer(signal.ITIMER_REAL, 0.05, 0.05)
while not seen:
    batch.run(0.5)
seen.clear()
while not seen:
    batch.reset(range(16))
signal.setitimer(signal.ITIMER_REAL, 0)
"""
    subprocess.run([sys.executable, "-c", script], timeout=60, check=True)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_state_is_set_in_a_process_that_was_forked() -> None:
    batch = Batch([MODEL] * 64, threads=1)
    state = batch.get_state()
    batch.set_state(state)
    child = multiprocessing.get_context("fork").Process(target=batch.set_state, args=(state,))
    child.start()
    child.join(60)
    assert child.exitcode == 0


def test_robots_are_reset_where_they_stand() -> None:
    batch = Batch([MODEL] * 3, threads=1)
    batch.set_drive(30.0, 0.3)
    batch.run(0.2)
    at = batch.position[1:2, :2].copy()
    batch.reset([1], robots=[1], positions=batch.position[1:2, :2])
    assert np.allclose(batch.position[1, :2], at, atol=2e-3) and batch.energy[1] == 0.0


def test_what_cannot_be_shown_does_not_happen() -> None:
    batch = Batch([MODEL] * 4, threads=1)
    batch.position.shape = (3, 4)
    with pytest.raises(ValueError, match="shape"):
        batch.run(0.01)
    batch.position.shape = (4, 3)
    batch.yaw.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        batch.run(0.01)
    assert batch.time == 0.0
    with pytest.raises(ValueError, match="positions hold"):
        Batch([MODEL]).reset([1], positions=[[1e300, 0.0]])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_process_that_was_forked_while_robots_ran_says_so() -> None:
    script = """
import os, threading, time, warnings
from flixwalker import Batch, Model
warnings.simplefilter("ignore")
batch = Batch([Model("W")] * 4000, threads=1)
runs = threading.Thread(target=batch.run, args=(0.2,))
runs.start()
time.sleep(0.3)
child = os.fork()
if child == 0:
    try:
        batch.time
    except RuntimeError as error:
        os._exit(0 if "forked" in str(error) else 1)
    os._exit(2)
_, status = os.waitpid(child, 0)
runs.join()
assert os.waitstatus_to_exitcode(status) == 0 and batch.time > 0.19
"""
    subprocess.run([sys.executable, "-c", script], timeout=120, check=True)


def test_a_film_is_shown_while_another_thread_shoots() -> None:
    batch = Batch([MODEL] * 64, threads=1)
    film = Film(MODEL)
    film.shoot(batch, 0)
    runs = threading.Thread(target=batch.run, args=(1.0,))
    shoots = threading.Thread(target=film.shoot, args=(batch, 0))
    runs.start()
    shoots.start()
    for _ in range(20):
        assert "x" in film.to_html("x")
    runs.join()
    shoots.join()


def test_what_is_no_number_or_too_large_is_refused_in_a_sentence() -> None:
    batch = Batch([MODEL] * 2)
    for call in (lambda: batch.run(True), lambda: batch.model(True), lambda: batch.run(0.1, np.True_)):
        with pytest.raises(TypeError, match="True is no number"):
            call()
    for wrong in ([np.array(True), 3.0], [np.ma.array(1.0, mask=True), 2.0], {1.0, 2.0}):
        with pytest.raises(ValueError, match="f_hz"):
            batch.set_drive(wrong, 0)
    with pytest.raises(ValueError, match="masked"):
        batch.reset([1, 2], positions=[np.ma.array([1.0, 2.0], mask=[1, 0])] * 2)
    with pytest.raises(ValueError, match="2 dimensions"):
        batch.reset([1], robots=[0], positions=[0.0, 0.0])
    with pytest.raises(ValueError, match="rad"):
        batch.reset([1, 2], headings=[0.0, 1e300])
    with pytest.raises(TypeError, match="one a robot"):
        batch.reset([1, 2], models=MODEL)
    batch.reset((seed for seed in (3, 4)), robots=iter([1, 0]))
    with pytest.raises(ValueError, match="masked"):
        batch.set_drive(30.0, 0.0, np.ma.array([True, True], mask=[0, 1]))
    for mixed in (collections.deque([True, 2.0]), collections.UserList([True, 2.0])):
        with pytest.raises(ValueError, match="true or false"):
            batch.set_drive(mixed, 0.0)
    with pytest.raises(TypeError, match="no number"):
        batch.run(np.array(True))
    with pytest.raises(ValueError, match="holds 2.5"):
        batch.reset([1, 2.5])
    with pytest.raises(ValueError, match="reference"):
        Film(MODEL, 0.01, [[0.0, np.nan]])
    with pytest.raises(ValueError, match="set"):
        batch.reset([1], robots={0})


def test_seeds_of_mobility_are_whole_numbers_of_64_bits() -> None:
    seeds = [2**63 + 1, 0]
    assert mobility(MODEL, [10.0], 0, seeds, 0.01)["seed"].tolist() == seeds
    for wrong in ([True, 1], bytearray(b"\1")):
        with pytest.raises(ValueError, match="seeds"):
            mobility(MODEL, [10.0], 0, wrong, 0.01)
    with pytest.raises(ValueError, match="f_hz"):
        mobility(MODEL, [True, 10.0], 0, 0, 0.01)
