import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str

class Model:
    """A robot as data: dimensions, masses, legs, contact, electronics.

    `Model("W")` takes a model that comes with the simulator (`models()`) or reads a TOML file.
    """

    def __init__(self, name: str | os.PathLike[str]) -> None: ...
    @staticmethod
    def from_toml(text: str) -> Model:
        """Read a model from TOML. Raises ValueError that names the key and what it may be."""
    @staticmethod
    def random(seed: int) -> Model:
        """Draw a robot that nobody has built."""
    def scattered(self, share: float, seed: int) -> Model:
        """Return the same robot built again: every number of its mechanics off by this share (standard deviation)."""
    def stranger(self, seed: int) -> Model:
        """Return it with other friction left and right, 50 g somewhere, other legs, on a floor that may fall."""
    @property
    def name(self) -> str: ...
    def to_toml(self) -> str: ...
    def to_dict(self) -> dict[str, Any]:
        """Return all fields, nested; units are in their names."""
    def mjcf(self, step: float) -> str:
        """Return the same robot for MuJoCo, with this step in s."""
    def __getitem__(self, path: str) -> Any:
        """Return a field by its path, for example `model["legs.fl.friction"]`. Raises KeyError."""
    def __contains__(self, path: str) -> bool:
        """Return whether the model has a field of this path."""
    def replace(self, fields: dict[str, Any]) -> Model:
        """Return a model with other values in these fields. Raises KeyError or ValueError.

        ``legs.length_mm``, ``width_mm`` and ``thickness_mm`` set the segments, the standing height and the inertia, not the
        stiffness: warns when they alone change.
        """

class Batch:
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    velocity: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    yaw: NDArray[np.float64]
    energy: NDArray[np.float64]
    alive: NDArray[np.bool_]
    def __init__(
        self,
        models: Sequence[Model],
        precision: str = "single",
        threads: int | None = None,
        state: bytes | None = None,
    ) -> None: ...
    def __len__(self) -> int: ...
    @property
    def time(self) -> float:
        """Simulated time since the batch was made, s."""
    @property
    def threads(self) -> int | None:
        """How many it was made for; none means all cores."""
    def model(self, robot: int) -> Model: ...
    def get_state(self) -> bytes:
        """Return models, robots and time, for `set_state` of this release."""
    def set_state(self, state: bytes) -> None:
        """Go on from what `get_state` returned, with the same bits.

        Raises ValueError if it is damaged, of another release, or of another number of robots.
        """
    def run(self, seconds: float, step: float = 1e-4) -> None:
        """Advance all robots by so many seconds in steps of 1e-6 to 1e-3 s, a whole number of them; other Python threads run meanwhile."""

class Robot:
    """Create one robot with its own software, just powered up, and an operator who connects to it over a link.

    All times are the robot's. Slower than a `Batch`: some 20 times real time.

    Parameters
    ----------
    model
        The robot.
    seed
        Of its wiring, sensor errors, noise and start.
    heading
        At the start, rad, positive to the left, to 1000000.
    latency, loss
        Of the link, each way: 0 to 10 s; share of datagrams, 0 to 0.9.

    Raises
    ------
    ValueError
        If the model is refused or cannot walk, or a value is out of its range.
    RuntimeError
        From every method: the robot refused, has a fault, or did not answer; the sentence says what.
    """

    def __init__(
        self,
        model: Model,
        seed: int = 0,
        heading: float = 0.0,
        latency: float = 0.005,
        loss: float = 0.0,
    ) -> None: ...
    def arm(self) -> None:
        """Connect, align the motors if need be, and arm: some seconds of the robot's time."""
    def disarm(self) -> None: ...
    def drive(self, f_hz: float, theta_deg: float) -> None:
        """Command f (-35 to 35 Hz) and theta (-90 to 90 degrees, right positive) from now on; `run` lets it happen."""
    def run(self, seconds: float) -> None:
        """Let time pass: a whole number of the software's ticks of 0.1 ms. Other Python threads run meanwhile."""
    def get_state(self) -> bytes:
        """Return how the robot was made, what was asked of it since, and when, for `set_state` of this release."""
    def set_state(self, state: bytes) -> None:
        """Become the robot of that state, with the same bits: it is powered up and asked the same anew, in as long as that took.

        `copy.deepcopy` and `pickle` do so too. Raises ValueError if it is no such state, or of another release.
        """
    def setting(self, name: str, value: float | None = None) -> float:
        """Return a setting of the software, as `flix parameters list` names it; set it first if a value is given."""
    @property
    def time(self) -> float:
        """Since power-up, s."""
    @property
    def state(self) -> str:
        """Of the robot's software, for example ``"armed"``."""
    @property
    def faults(self) -> str: ...
    @property
    def position(self) -> list[float]:
        """Of the body's origin in the world, m."""
    @property
    def yaw(self) -> float:
        """Heading, rad, positive to the left."""
    @property
    def f_hz(self) -> float:
        """At which it truly shakes."""
    @property
    def theta_deg(self) -> float:
        """In which it truly shakes, -90 to 90."""
    @property
    def energy(self) -> float:
        """Given by the battery so far, J."""

class Film:
    """What was seen of a robot, as a page for the browser: a frame every `interval` seconds, and a path on the floor."""

    def __init__(
        self, model: Model, interval: float = 0.005, reference: Sequence[Sequence[float]] = ()
    ) -> None: ...
    def shoot(self, batch: Batch, robot: int) -> None:
        """Keep a frame of a robot when one is due."""
    def to_html(self, title: str) -> str: ...
    def write(self, path: str | os.PathLike[str], title: str) -> str: ...

def models() -> list[str]:
    """Return the names of the models that come with the simulator."""

def paper_pairs() -> list[tuple[str, float, float]]:
    """Return the nine modes of the paper's Tables III and IV: name, f in Hz, theta in degrees."""

def walk(
    models: Sequence[Model],
    f_hz: NDArray[np.float64],
    theta_deg: NDArray[np.float64],
    seeds: Sequence[int],
    seconds: float = 8.0,
    step: float = 1e-4,
    threads: int | None = None,
) -> dict[str, NDArray[Any]]: ...
