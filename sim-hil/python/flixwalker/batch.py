"""Thousands of robots, read and commanded as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _flixwalker
from ._flixwalker import Model


class Batch(_flixwalker.Batch):
    """Create robots that stand still at the origin, shaken at 0 Hz.

    Parameters
    ----------
    models
        One a robot.
    precision
        ``"single"`` (24 bits, the faster) or ``"double"`` (53 bits: bit for bit the robot that is simulated alone).
    threads
        How many; all cores if none is given. A robot's bits do not depend on it, nor on the other robots.

    Attributes
    ----------
    position : (n, 3)
        Of the body's origin in the world, m; z is up.
    orientation : (n, 4)
        Unit quaternion w, x, y, z from body to world.
    velocity, angular_velocity : (n, 3)
        Of the body, world axes, m/s and rad/s.
    yaw : (n,)
        Heading, rad, positive to the left.
    energy : (n,)
        What the ideal motors have put in since the last reset, J.
    alive : (n,) of bool
        False once a robot has moved as none does: reset it. Its other values are those of a moment before.

    The arrays are written in place by `run` and `reset`: copy what you want to keep.

    Raises
    ------
    ValueError
        If a model is refused or cannot walk.
    """

    def set_drive(
        self, f_hz: ArrayLike, theta_rad: ArrayLike, robots: Iterable[int] | None = None
    ) -> None:
        """Shake robots at another frequency and direction from now on.

        The first drive after a reset is there at once. From one to the next the rotors go as the robot's software lets them,
        with its default settings: f along a ramp of 200 Hz/s, through rest where it changes its sign, and theta the short way,
        900 degrees a second at most.

        Parameters
        ----------
        f_hz
            -120 to 120 Hz, one for all or one a robot; positive turns the top rotor clockwise seen from above.
        theta_rad
            Direction of the line of force, rad, positive to the right.
        robots
            Which; all if none are named.
        """
        super().set_drive(_numbers(f_hz), _numbers(theta_rad), _whole(robots))

    def reset(
        self,
        seeds: ArrayLike,
        robots: Iterable[int] | None = None,
        models: Sequence[Model] | None = None,
        positions: ArrayLike | None = None,
        headings: ArrayLike | None = None,
    ) -> None:
        """Put robots back to a start that each seed disturbs a little (1 mm, 5 mrad).

        Parameters
        ----------
        seeds
            One a robot.
        robots
            Which; all if none are named.
        models
            New ones, one a robot; as before if none are given.
        positions : (k, 2)
            Where on the floor, m; the origin if none are given.
        headings : (k,)
            rad, positive to the left; 0 if none are given.
        """
        super().reset(
            whole_seeds(seeds),
            _whole(robots),
            None if models is None else list(models),
            None if positions is None else np.ascontiguousarray(positions, dtype=np.float64),
            None if headings is None else _numbers(headings),
        )


def whole_seeds(seeds: ArrayLike) -> list[int]:
    """Return seeds as whole numbers.

    Raises
    ------
    ValueError
        If one of them is none, or outside 0 to 2**64 - 1.
    """
    whole = [int(seed) for seed in np.atleast_1d(np.asarray(seeds, dtype=object)).ravel()]
    for seed in whole:
        if not 0 <= seed < 2**64:
            raise ValueError(f"a seed is {seed}: choose whole numbers from 0 to 2**64 - 1")
    return whole


def _numbers(values: ArrayLike) -> np.ndarray:
    return np.atleast_1d(np.asarray(values, dtype=np.float64))


def _whole(robots: Iterable[int] | None) -> list[int] | None:
    return None if robots is None else [int(robot) for robot in robots]
