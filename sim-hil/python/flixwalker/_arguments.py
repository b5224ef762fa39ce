"""What is given, with numpy's meaning, or refused in a sentence."""

from __future__ import annotations

from typing import Any

import numpy as np

#: Kinds of arrays that hold numbers (numpy.dtype.kind): whole ones with and without a sign, and fractions.
WHOLE, NUMBERS = "iu", "iuf"


def _array(name: str, values: Any, kinds: str, what: str) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind == "O" and array.size and all(isinstance(value, int) for value in array.flat):
        # Whole numbers that fit no type together, such as seeds of 64 bits beside small ones.
        return array
    if array.dtype.kind not in kinds and array.size:
        raise ValueError(f"{name} holds {array.ravel().tolist()[0]!r}: give {what}")
    if array.ndim > 1:
        raise ValueError(f"{name} has the shape {array.shape}: give one, or a list of them")
    return np.atleast_1d(array)


def numbers(name: str, values: Any) -> np.ndarray:
    """Return numbers, one or a list, as an array."""
    return _array(name, values, NUMBERS, "numbers").astype(np.float64)


def seeds(values: Any) -> list[int]:
    """Return seeds as whole numbers.

    Raises
    ------
    ValueError
        If one of them is none, or outside 0 to 2**64 - 1.
    """
    whole = [int(seed) for seed in _array("seeds", np.ravel(np.asarray(values)), WHOLE, "whole numbers")]
    for seed in whole:
        if not 0 <= seed < 2**64:
            raise ValueError(f"a seed is {seed}: choose whole numbers from 0 to 2**64 - 1")
    return whole


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
    given = np.asarray(list(robots) if isinstance(robots, range) else robots)
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
