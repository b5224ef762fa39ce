"""One robot with firmware and link, and the records of runs."""

import copy
import pickle
import threading

import numpy as np
import pandas
import pytest

import flixwalker
from flixwalker import Model, Robot
from flixwalker.table import _frame


def test_an_armed_robot_shakes_as_it_is_driven_and_walks() -> None:
    robot = Robot(Model("W"), seed=3, latency=0.02, loss=0.05)
    assert robot.state == "disarmed"
    robot.arm()
    robot.drive(f_hz=-30.0, theta_deg=30.0)
    robot.run(2.0)
    assert robot.f_hz == pytest.approx(-30.0, abs=1.0)
    assert robot.theta_deg == pytest.approx(30.0, abs=5.0)
    assert robot.position[0] ** 2 + robot.position[1] ** 2 > 0.05**2
    assert robot.energy > 1.0
    robot.drive(0.0, 0.0)
    robot.run(1.0)
    robot.disarm()
    robot.run(0.5)
    assert robot.state == "disarmed" and abs(robot.f_hz) < 1.0


def test_the_same_seed_gives_the_same_run() -> None:
    def end(seed: int) -> list[float]:
        robot = Robot(Model("W"), seed=seed)
        robot.arm()
        robot.drive(25.0, 0.0)
        robot.run(0.3)
        return robot.position

    assert end(1) == end(1) != end(2)


def test_settings_are_read_and_written_and_refusals_are_sentences() -> None:
    robot = Robot(Model("W"))
    assert robot.setting("frequency_ramp", 100.0) == 100.0
    assert robot.setting("frequency_ramp") == 100.0
    with pytest.raises(RuntimeError):
        robot.setting("no_such_setting")
    with pytest.raises(ValueError):
        robot.drive(200.0, 0.0)
    with pytest.raises(ValueError, match="seconds is NaN"):
        robot.run(float("nan"))
    with pytest.raises(ValueError, match="latency -1"):
        Robot(Model("W"), latency=-1.0)


def test_a_record_is_a_data_frame_for_each_topic(tmp_path) -> None:
    mcap = pytest.importorskip("mcap.writer")
    file = tmp_path / "run.mcap"
    with open(file, "wb") as out:
        writer = mcap.Writer(out, compression=mcap.CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("pose", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", "json", schema)
        for second in (5, 6):
            writer.add_message(channel, second * 10**9, b'{"pose": {"x": %d}}' % second, second * 10**9)
        writer.finish()
    frames = flixwalker.read_record(file)
    assert list(frames) == ["/pose"]
    assert frames["/pose"].index.tolist() == [0.0, 1.0]
    assert frames["/pose"]["pose.x"].tolist() == [5, 6]
    whole = file.read_bytes()
    changed = whole.replace(b'"x": 6', b'"x": 9')
    for damaged in [whole[:-1], whole[: len(whole) // 2], whole[:9], changed]:
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match="cut short or damaged .*`flix runs repair"):
            flixwalker.read_record(file)
    for other in [b"", b"time,f\n"]:
        file.write_bytes(other)
        with pytest.raises(ValueError, match="no record"):
            flixwalker.read_record(file)


def test_whole_numbers_of_a_record_stay_whole_where_rows_are_missing() -> None:
    time = 2**60 + 1
    frame = _frame([{"at": {"ns": time}, "x": 1.5, "n": 1}, {"at": {}, "n": 2}, {"at": {"ns": 3}, "n": 3}])
    assert frame["at.ns"][0] == time and pandas.isna(frame["at.ns"][1])
    assert frame["n"].dtype == np.int64 and np.isnan(frame["x"][1])


def test_a_robot_may_be_used_in_another_thread() -> None:
    robot = Robot(Model("W"))
    thread = threading.Thread(target=robot.run, args=(0.2,))
    thread.start()
    thread.join()
    assert robot.time == pytest.approx(0.2)


def test_a_copy_of_a_robot_goes_on_with_the_same_bits() -> None:
    robot = Robot(Model("W"), seed=2, heading=0.3, latency=0.02, loss=0.1)
    robot.setting("frequency_ramp", 150.0)
    robot.arm()
    robot.drive(28.0, 20.0)
    robot.run(0.3123)
    robot.drive(-30.0, -70.0)
    robot.run(0.07)
    state = robot.get_state()
    copied, sent = copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))
    other = Robot(Model("A"))
    other.set_state(state)
    for each in (robot, copied, sent, other):
        each.run(0.5)

    def seen(robot: Robot) -> tuple[object, ...]:
        return robot.time, robot.state, robot.position, robot.yaw, robot.energy

    assert seen(robot) == seen(copied) == seen(sent) == seen(other)
    for damaged in (b"", state[:-1], state.replace(b"Arm", b"Run")):
        with pytest.raises(ValueError, match="no state of a robot"):
            robot.set_state(damaged)
    with pytest.raises(ValueError, match="of release 9"):
        robot.set_state(state.replace(b'"release":"0', b'"release":"9'))


def test_time_passes_by_whole_ticks_of_the_software() -> None:
    robot = Robot(Model("W"))
    for part in (2.5e-4, 1e-9, 1.5e-6):
        with pytest.raises(ValueError, match="whole number of steps"):
            robot.run(part)
    robot.run(3e-4)
    assert robot.time == pytest.approx(3e-4)


def test_two_threads_run_a_robot_for_the_time_of_both() -> None:
    robot = Robot(Model("W"))
    threads = [threading.Thread(target=robot.run, args=(0.7,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert robot.time == pytest.approx(1.4)


def test_a_robot_takes_numbers_alone() -> None:
    model = Model("W")
    robot = Robot(model)
    for call in (
        lambda: Robot(model, seed=True),
        lambda: robot.drive(True, 0.0),
        lambda: robot.run(np.True_),
        lambda: robot.setting("frequency_ramp", True),
    ):
        with pytest.raises(TypeError, match="True is no number"):
            call()
    for call in (lambda: Robot(model, seed=-1), lambda: Robot(model, seed=2**64), lambda: Model.random(-1)):
        with pytest.raises(ValueError, match="a seed is -?[0-9]+: choose"):
            call()
    with pytest.raises(ValueError, match="rad"):
        Robot(model, heading=1e300)
