"""Thousands of robots, read and commanded as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from numpy.typing import ArrayLike

from . import _arguments, _flixwalker
from ._flixwalker import Model


def _restored(kind: type[Batch], state: bytes, threads: int | None) -> Batch:
    return _flixwalker.Batch.__new__(kind, [], "single", threads, state)


def _each(models: Sequence[Model]) -> list[Model]:
    if isinstance(models, (Model, str)):
        raise TypeError(f"models is {models!r}: give a list, one a robot, such as [model] * 32")
    return list(models)


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
        What the ideal motors have put in since the last reset, J; from the first drive on also what brought the rotors to
        speed.
    alive : (n,) of bool
        False once a robot has moved as none does: reset it. Its other values are those of a moment before.

    The arrays are written in place by `run` and `reset`: copy what you want to keep. A batch that is copied
    (`copy.deepcopy`) or pickled goes on with the same bits, and so does one after `set_state`.

    Raises
    ------
    ValueError
        If a model is refused or cannot walk.
    """

    def __new__(
        cls, models: Sequence[Model], precision: str = "single", threads: int | None = None
    ) -> Batch:
        return super().__new__(cls, _each(models), precision, _arguments.threads(threads))

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (type(self), self.get_state(), self.threads), self.__dict__ or None

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
            Which, by their numbers or a mask; all if none are named.
        """
        super().set_drive(
            _arguments.numbers("f_hz", f_hz),
            _arguments.numbers("theta_rad", theta_rad),
            _arguments.chosen(robots, len(self)),
        )

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
            Which, by their numbers or a mask; all if none are named.
        models
            New ones, one a robot; as before if none are given.
        positions : (k, 2)
            Where on the floor, m, to 1000 km; the origin if none are given.
        headings : (k,)
            rad, positive to the left, to 1000000; 0 if none are given.
        """
        super().reset(
            _arguments.seeds(seeds),
            _arguments.chosen(robots, len(self)),
            None if models is None else _each(models),
            None if positions is None else _arguments.table("positions", positions, 2),
            None if headings is None else _arguments.numbers("headings", headings),
        )

