"""What is given, with numpy's meaning, or refused in a sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

#: Kinds of arrays that hold numbers (numpy.dtype.kind): whole ones with and without a sign, and fractions.
WHOLE, NUMBERS = "iu", "iuf"
#: Threads at most.
MOST_THREADS = 1024


def is_whole(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def refuse_less_than_one(name: str, count: Any) -> None:
    if not is_whole(count) or count < 1:
        raise ValueError(f"{name} is {count!r}: choose a whole number, 1 or more")


def _stranger(values: Any) -> str | None:
    """Return what a list, or one in it, holds that numpy takes for numbers: true for 1, bytes, what is masked."""
    if np.ma.is_masked(values):
        return "masked values"
    if isinstance(values, (bool, np.bool_)) or getattr(values, "dtype", None) == bool:
        return "true or false"
    if isinstance(values, (bytes, bytearray, memoryview)):
        return "bytes"
    if isinstance(values, Sequence) and not isinstance(values, (str, range)):
        return next((found for found in map(_stranger, values) if found), None)
    return None


def of_kind(name: str, values: Any, kinds: str, what: str) -> np.ndarray:
    """Return an array of any shape whose values are of these kinds (numpy.dtype.kind).

    Raises
    ------
    ValueError
        If they are not, or some are masked.
    """
    if isinstance(values, Iterator):
        values = list(values)
    if isinstance(values, (set, frozenset)):
        raise ValueError(f"{name} is a set, which has no order: give {what}")
    found = _stranger(values)
    is_mask = found == "true or false" and "b" in kinds and np.asarray(values).dtype.kind == "b"
    if found and not is_mask:
        raise ValueError(f"{name} holds {found}: give {what}")
    array = np.asarray(values)
    if array.dtype.kind == "f" and "f" not in kinds and not hasattr(values, "dtype"):
        # Numpy makes floats of a list in which some whole numbers take 64 bits.
        array = np.array(values, dtype=object)
    if array.dtype.kind == "O" and array.size and all(is_whole(value) for value in array.flat):
        # Whole numbers that fit no type together, such as seeds of 64 bits beside small ones.
        return array
    if array.dtype.kind not in kinds and not array.size:
        # Of nothing numpy makes floats.
        return np.zeros(array.shape, dtype=np.float64 if "f" in kinds else np.int64)
    if array.dtype.kind not in kinds:
        each = np.array(values, dtype=object).ravel() if array.dtype.kind == "O" or "f" not in kinds else array.ravel()
        bad = next((it for it in each.tolist() if np.asarray(it).dtype.kind not in kinds), each.tolist()[0])
        raise ValueError(f"{name} holds {bad!r}: give {what}")
    return array


def _array(name: str, values: Any, kinds: str, what: str) -> np.ndarray:
    array = of_kind(name, values, kinds, what)
    if array.ndim > 1:
        raise ValueError(f"{name} has the shape {array.shape}: give one, or a list of them")
    return np.atleast_1d(array)


def number(name: str, value: Any) -> float:
    """Return one number."""
    array = of_kind(name, value, NUMBERS, "a number")
    if array.ndim:
        raise ValueError(f"{name} has the shape {array.shape}: give one number")
    return float(array)


def numbers(name: str, values: Any) -> np.ndarray:
    """Return numbers, one or a list, as an array."""
    return _array(name, values, NUMBERS, "numbers").astype(np.float64)


def table(name: str, values: Any, dimensions: int | None = None) -> np.ndarray:
    """Return numbers in any shape, or of so many dimensions, as an array."""
    array = of_kind(name, values, NUMBERS, "numbers")
    if dimensions is not None and array.ndim != dimensions:
        raise ValueError(f"{name} has the shape {array.shape}: give one of {dimensions} dimensions")
    return np.ascontiguousarray(array, dtype=np.float64)


def threads(count: Any) -> int | None:
    """Return how many threads are meant; none means one for each core."""
    if count is not None and not (is_whole(count) and 1 <= count <= MOST_THREADS):
        raise ValueError(f"threads is {count!r}: choose 1 to {MOST_THREADS}, or none for one a core")
    return count


def seeds(values: Any) -> list[int]:
    """Return seeds as whole numbers.

    Raises
    ------
    ValueError
        If one of them is none, or outside 0 to 2**64 - 1.
    """
    whole = [int(seed) for seed in of_kind("seeds", values, WHOLE, "whole numbers").flat]
    for seed in whole:
        if not 0 <= seed < 2**64:
            raise ValueError(f"a seed is {seed}: choose whole numbers from 0 to 2**64 - 1")
    return whole


def some_seeds(values: Any) -> list[int | None]:
    """Return seeds of which some may be none."""
    if isinstance(values, (str, bytes, bytearray, memoryview, set, frozenset, Mapping)):
        raise ValueError(f"seeds is {values!r}: give a list of whole numbers")
    return [None if each is None else seed(each) for each in values]


def seed(value: Any) -> int:
    """Return one seed as a whole number."""
    if np.ndim(value):
        raise ValueError(f"a seed is {value!r}: give a whole number")
    return seeds(value)[0]


def chosen(robots: Any, count: int) -> list[int] | None:
    """Return which robots of so many are meant: their numbers, or those where a mask is true; none means all.

    Raises
    ------
    ValueError
        If a mask has another length, or a robot is named twice.
    IndexError
        If there is no such robot.
    """
    if robots is None:
        return None
    given = of_kind("robots", list(robots) if isinstance(robots, range) else robots, "b" + WHOLE, "whole numbers, or a mask")
    if given.dtype.kind == "b":
        if given.shape != (count,):
            raise ValueError(f"robots is a mask of the shape {given.shape}: give ({count},)")
        return [int(robot) for robot in np.flatnonzero(given)]
    whole = [int(robot) for robot in _array("robots", given, WHOLE, "whole numbers, or a mask")]
    for robot in whole:
        if not -count <= robot < count:
            raise IndexError(f"robot {robot}: this batch has 0 to {count - 1}")
    # From the end, as numpy counts.
    whole = [robot % count for robot in whole]
    if len(set(whole)) < len(whole):
        raise ValueError(f"robots names one twice: {whole}")
    return whole
