import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

class Model:
    """A robot as data: dimensions, masses, legs, contact, electronics.

    `Model("W")` takes a model that comes with the simulator (`models()`) or reads a TOML file.
    """

    def __init__(self, name: str) -> None: ...
    @staticmethod
    def from_toml(text: str) -> Model:
        """Read a model from TOML. Raises ValueError that names the key and what it may be."""
    @staticmethod
    def random(seed: int) -> Model:
        """Draw a robot that nobody has built."""
    @property
    def name(self) -> str: ...
    def to_toml(self) -> str: ...
    def to_dict(self) -> dict[str, Any]:
        """Return all fields, nested; units are in their names."""
    def mjcf(self, step: float) -> str:
        """Return the same robot for MuJoCo, with this step in s."""
    def __getitem__(self, path: str) -> Any:
        """Return a field by its path, for example `model["legs.fl.friction"]`. Raises KeyError."""
    def replace(self, fields: dict[str, Any]) -> Model:
        """Return a model with other values in these fields. Raises KeyError or ValueError."""

class Batch:
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    velocity: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    yaw: NDArray[np.float64]
    energy: NDArray[np.float64]
    alive: NDArray[np.bool_]
    def __init__(
        self, models: Sequence[Model], precision: str = "single", threads: int | None = None
    ) -> None: ...
    def __len__(self) -> int: ...
    @property
    def time(self) -> float:
        """Simulated time since the batch was made, s."""
    def model(self, robot: int) -> Model: ...
    def run(self, seconds: float, step: float = 1e-4) -> None:
        """Advance all robots by so many seconds in steps of 1e-6 to 1e-3 s; other Python threads run meanwhile."""

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
