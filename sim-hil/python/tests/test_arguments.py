"""Whatever is given means what it means to numpy and Gymnasium, or is refused: nothing else happens."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from flixwalker import Batch, Model, walk
from flixwalker.env import FlixWalkerVectorEnv

ROBOTS = 3
MODEL = Model("W")
SENTENCE = (ValueError, TypeError, IndexError)
KINDS = st.sampled_from(
    ["?", "i1", "u1", ">i4", "i8", "u8", "f2", "f4", ">f8", "f8", "g", "c16", "U2", "S2", "O", "M8[s]"]
)
SHAPES = st.sampled_from([(), (0,), (1,), (2,), (ROBOTS,), (ROBOTS, 1), (1, 2), (ROBOTS, 2), (2, ROBOTS)])
few = settings(
    max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@st.composite
def anything(draw: st.DrawFn) -> object:
    """An array of any kind, shape and layout, or what numpy would make one of."""
    kind, shape = np.dtype(draw(KINDS)), draw(SHAPES)
    elements = {
        "i": st.integers(-3, 4),
        "u": st.integers(0, 4),
        "f": st.sampled_from([0.0, -1.0, 1.0, 2.0, 0.5, 30.0, 120.5, np.nan, np.inf]),
        "O": st.sampled_from([0, 1, 2**63, 2**64, -1, 0.5, None, "1", True]),
    }.get(kind.kind)
    array = draw(arrays.arrays(kind, shape, elements=elements))
    layout = draw(st.sampled_from(["whole", "reversed", "strided", "fortran", "read-only", "masked", "list"]))
    if layout == "reversed" and array.ndim:
        return array[::-1]
    if layout == "strided" and array.ndim:
        return np.repeat(array, 2, axis=0)[::2]
    if layout == "fortran":
        return np.asfortranarray(array)
    if layout == "read-only":
        array.flags.writeable = False
    if layout == "masked":
        return np.ma.masked_array(array, np.zeros(shape, dtype=bool) if draw(st.booleans()) else True)
    return array.tolist() if layout == "list" else array


def is_plain(values: object, kinds: str) -> bool:
    """Is it numbers of these kinds, none of them masked?"""
    if np.ma.is_masked(values):
        return False
    array = np.asarray(values)
    if array.dtype.kind == "O" and array.size:
        return all(isinstance(each, int) and not isinstance(each, bool) for each in array.flat)
    return array.dtype.kind in kinds or not array.size


def state(batch: Batch) -> bytes:
    return batch.get_state()


@few
@given(anything())
def test_a_drive_is_one_number_or_one_a_robot(f_hz: object) -> None:
    batch, same = Batch([MODEL] * ROBOTS, threads=1), Batch([MODEL] * ROBOTS, threads=1)
    array = np.asarray(f_hz)
    right = is_plain(f_hz, "iuf") and array.shape in [(), (1,), (ROBOTS,)]
    plain = np.broadcast_to(array.astype(np.float64), ROBOTS) if right else np.zeros(ROBOTS)
    if right and (np.abs(plain) <= 120.0).all():
        batch.set_drive(f_hz, 0.1)
        same.set_drive(np.ascontiguousarray(plain), 0.1)
    else:
        with pytest.raises(SENTENCE):
            batch.set_drive(f_hz, 0.1)
    assert state(batch) == state(same)


@few
@given(anything())
def test_robots_are_those_that_numpy_would_take(robots: object) -> None:
    batch, same = Batch([MODEL] * ROBOTS, threads=1), Batch([MODEL] * ROBOTS, threads=1)
    array = np.asarray(robots)
    mask = array.dtype == bool and array.shape == (ROBOTS,) and not np.ma.is_masked(robots)
    if mask or (is_plain(robots, "iu") and array.ndim <= 1 and all(-ROBOTS <= int(each) < ROBOTS for each in array.flat)):
        meant = np.arange(ROBOTS)[array if mask else array.astype(np.int64)].ravel().tolist()
        if len(set(meant)) == len(meant):
            batch.set_drive(30.0, 0.1, robots=robots)
            same.set_drive(30.0, 0.1, robots=meant)
            assert state(batch) == state(same)
            return
    with pytest.raises(SENTENCE):
        batch.set_drive(30.0, 0.1, robots=robots)
    assert state(batch) == state(same)


@few
@given(anything())
def test_seeds_are_whole_numbers_one_a_robot(seeds: object) -> None:
    batch, same = Batch([MODEL] * ROBOTS, threads=1), Batch([MODEL] * ROBOTS, threads=1)
    array = np.asarray(seeds)
    whole = [int(seed) for seed in array.flat] if is_plain(seeds, "iu") else []
    if len(whole) == ROBOTS and all(0 <= seed < 2**64 for seed in whole):
        batch.reset(seeds)
        same.reset(whole)
    else:
        with pytest.raises(SENTENCE):
            batch.reset(seeds)
    assert state(batch) == state(same)


@few
@given(anything(), st.booleans())
def test_positions_and_headings_are_numbers_in_their_shape(values: object, heading: bool) -> None:
    batch, same = Batch([MODEL] * ROBOTS, threads=1), Batch([MODEL] * ROBOTS, threads=1)
    name = "headings" if heading else "positions"
    array = np.asarray(values)
    shapes = [(), (1,), (ROBOTS,)] if heading else [(ROBOTS, 2)]
    right = is_plain(values, "iuf") and array.shape in shapes
    plain = array.astype(np.float64) if right else array
    if right and np.isfinite(plain).all():
        batch.reset(range(ROBOTS), **{name: values})
        same.reset(range(ROBOTS), **{name: np.broadcast_to(plain, shapes[-1])})
    else:
        with pytest.raises(SENTENCE):
            batch.reset(range(ROBOTS), **{name: values})
    assert state(batch) == state(same)


@few
@given(st.floats(), st.sampled_from([1e-6, 1e-4, 2.5e-4, 0.0, -1e-4, 1e-2, np.nan]))
def test_a_time_is_a_whole_number_of_steps_or_refused(seconds: float, step: float) -> None:
    batch = Batch([MODEL], threads=1)
    try:
        batch.run(min(seconds, 2e-3), step)
    except ValueError:
        assert batch.time == 0.0
    else:
        assert batch.time == pytest.approx(min(seconds, 2e-3), abs=1e-12)


@settings(few, max_examples=200)
@given(anything(), st.booleans())
def test_actions_are_one_a_robot(actions: object, modes: bool) -> None:
    envs, same = (
        FlixWalkerVectorEnv(ROBOTS, actions="modes" if modes else "pair", interval=2e-3, threads=1) for _ in range(2)
    )
    envs.reset(seed=1)
    same.reset(seed=1)
    array = np.asarray(actions)
    right = is_plain(actions, "iu" if modes else "iuf") and array.shape == same.action_space.shape
    if right and not modes:
        plain = array.astype(np.float64)
        right = bool(np.isfinite(plain).all())
    elif right:
        plain = array.astype(object)
        right = all(0 <= action < 9 for action in plain)
        plain = plain.astype(np.int64) if right else plain
    if right:
        envs.step(actions)
        same.step(np.clip(plain, -1.0, 1.0) if not modes else plain)
    else:
        with pytest.raises(SENTENCE):
            envs.step(actions)
    assert state(envs.batch) == state(same.batch)


@few
@given(anything())
def test_a_walk_takes_numbers_alone(f_hz: object) -> None:
    array = np.asarray(f_hz)
    if is_plain(f_hz, "iuf") and (np.abs(array.astype(np.float64)) <= 120.0).all():
        plain = array.astype(np.float64)
        table = walk(MODEL, f_hz, 10.0, seconds=5e-4, threads=1)
        assert (table["f_hz"] == np.atleast_1d(plain).ravel()).all() and len(table["path_m"]) == array.size
    else:
        with pytest.raises(SENTENCE):
            walk(MODEL, f_hz, 10.0, seconds=5e-4, threads=1)


@pytest.mark.parametrize("threads", [0, -1, 1.5, "2", True, 10**6])
def test_threads_are_a_number_of_them(threads: object) -> None:
    with pytest.raises(ValueError, match="threads is"):
        Batch([MODEL], threads=threads)
    with pytest.raises(ValueError, match="threads is"):
        walk(MODEL, 30.0, 0.0, threads=threads)


@pytest.mark.parametrize(
    "wrong",
    [{"path": [["0", "0"]] * 3}, {"path": [[np.nan, 0.0]] * 3}, {"interval": np.nan}, {"seconds": np.nan}, {"seconds": -1.0}],
)
def test_an_environment_of_what_is_no_number_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FlixWalkerVectorEnv(2, **wrong)


@pytest.mark.parametrize("mask", [[1, 0], [True], ["a", "b"]])
def test_a_mask_of_resets_is_boolean(mask: object) -> None:
    envs = FlixWalkerVectorEnv(2)
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="seeds holds 1.5"):
        envs.reset(seed=1.5)


@pytest.mark.parametrize("f_hz", [[30, True], [[30.0], [False]], bytearray(b"ab"), (1.0, np.True_)])
def test_true_and_bytes_are_no_numbers(f_hz: object) -> None:
    with pytest.raises(ValueError, match="f_hz"):
        Batch([MODEL] * 2).set_drive(f_hz, 0.0)


@pytest.mark.parametrize("value", [float("nan"), 1j, Decimal("0.5"), np.longdouble(0.5), np.inf])
def test_what_is_no_plain_number_is_refused_with_its_field(value: object) -> None:
    with pytest.raises(ValueError, match="legs.mass_g is"):
        MODEL.replace({"legs.mass_g": value})


def test_a_walk_of_a_part_of_a_step_is_refused() -> None:
    with pytest.raises(ValueError, match="whole number of steps"):
        walk(MODEL, 30.0, 10.0, seconds=0.0015, step=1e-3)
