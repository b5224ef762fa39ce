"""Simulate thousands of Flix-Walker robots.

The robot shakes itself at a frequency f and in a direction theta; that pair alone selects how it moves. Here a batch
of robots, each with its own model, start and shaking, is stepped by the simulator's own engine.

    >>> import flixwalker
    >>> batch = flixwalker.Batch([flixwalker.Model("W")] * 32)
    >>> batch.set_drive(f_hz=30.0, theta_rad=[0.05 * i for i in range(32)])
    >>> batch.run(0.5)
    >>> batch.position.shape
    (32, 3)
"""

from ._flixwalker import Film, Model, Robot, __version__, models, paper_pairs
from .batch import Batch
from .table import mobility, read_record, read_table, walk

__all__ = [
    "Batch",
    "Film",
    "Model",
    "Robot",
    "__version__",
    "mobility",
    "models",
    "paper_pairs",
    "read_record",
    "read_table",
    "walk",
]

try:
    import gymnasium as _gymnasium
except ImportError:
    # The simulator serves without it.
    pass
else:
    _gymnasium.register(
        id="FlixWalker-v0",
        entry_point="flixwalker.env:FlixWalkerEnv",
        vector_entry_point="flixwalker.env:FlixWalkerVectorEnv",
        max_episode_steps=240,
    )
    _gymnasium.register(
        id="FlixWalker-v1",
        entry_point="flixwalker.env:newest",
        vector_entry_point="flixwalker.env:newest_vector",
        max_episode_steps=240,
    )
