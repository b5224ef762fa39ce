"""Walks as tables: a column a quantity."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arguments, _flixwalker
from ._flixwalker import Model

if TYPE_CHECKING:
    import pandas
    import pyarrow

# What a record begins with (the MCAP specification's magic bytes).
MCAP = b"\x89MCAP0\r\n"


def walk(
    models: Model | Sequence[Model],
    f_hz: ArrayLike,
    theta_deg: ArrayLike,
    seeds: ArrayLike = 0,
    seconds: float = 8.0,
    step: float = 1e-4,
    threads: int | None = None,
) -> dict[str, np.ndarray]:
    """Walk robots, each at its f and theta from a heading of its own, and return how they went.

    What is given once is used for all.

    Parameters
    ----------
    models
        The robots.
    f_hz, theta_deg
        -120 to 120 Hz; -90 to 90 degrees, positive to the right.
    seeds
        Of the disturbed starts.
    seconds
        Simulated time, s.
    step
        Of the integration, s.
    threads
        How many; all cores if none is given.

    Returns
    -------
    dict
        Columns f_hz, theta_deg, seed, then, as means over the walk in the body's axes: forward_m_s, lateral_m_s (left
        positive), yaw_rad_s (left positive); energy_j of the ideal motors, path_m, cost_of_transport, upright; and failure:
        why a robot was refused or moved as none does, else empty. A row that failed is NaN, and the others are whole.

    Raises
    ------
    ValueError
        If f, theta, a seed or a time is out of its range.
    """
    given = [models] if isinstance(models, Model) else list(models)
    seeds = _arguments.of_kind("seeds", seeds, _arguments.WHOLE, "whole numbers")
    which, f, theta, seed = np.broadcast_arrays(
        np.arange(len(given)),
        _arguments.table("f_hz", f_hz),
        _arguments.table("theta_deg", theta_deg),
        np.array(_arguments.seeds(seeds), dtype=np.uint64).reshape(seeds.shape),
    )
    which, f, theta, seed = (np.atleast_1d(column).ravel().copy() for column in (which, f, theta, seed))
    walked = _flixwalker.walk(
        [given[i] for i in which], f, theta, [int(s) for s in seed], seconds, step, _arguments.threads(threads)
    )
    walked["failure"] = np.array(walked["failure"], dtype=np.str_)
    return {"f_hz": f, "theta_deg": theta, "seed": seed, **walked}


def mobility(
    model: Model,
    f_hz: ArrayLike = (-35, -30, -20, -10, 10, 20, 30, 35),
    theta_deg: ArrayLike = (-90, -60, -30, 0, 30, 60, 90),
    seeds: ArrayLike = (0, 1, 2, 3),
    seconds: float = 8.0,
    step: float = 1e-4,
) -> pandas.DataFrame:
    """Walk every pair (f, theta) from every seed: the paper's mobility study as a data frame, a row a walk.

    Parameters, columns and errors are those of `walk`. Needs pandas.
    """
    import pandas

    axes = (
        _arguments.numbers("f_hz", f_hz),
        _arguments.numbers("theta_deg", theta_deg),
        np.array(_arguments.seeds(seeds), dtype=np.uint64),
    )
    f, theta, seed = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    return pandas.DataFrame(walk(model, f, theta, seed, seconds, step))


def read_table(path: str | os.PathLike[str]) -> pyarrow.Table:
    """Read the results.parquet that `flix-sim study` writes. Needs pyarrow; `.to_pandas()` makes a data frame of it.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """
    import pyarrow.parquet

    return pyarrow.parquet.read_table(path)


def _flat(message: dict[str, object], within: str = "") -> Iterator[tuple[str, object]]:
    """Return the fields of a message; names of nested ones have dots."""
    for name, value in message.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{within}{name}.")
        else:
            yield within + name, value


def _frame(messages: list[dict[str, object]]) -> pandas.DataFrame:
    """Return a row a message. Whole numbers stay whole where some rows have none."""
    import pandas

    rows = [dict(_flat(message)) for message in messages]
    columns: dict[str, Any] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        present = [value for value in values if value is not None]
        if len(present) < len(values) and present and all(type(value) is int for value in present):
            # A column of floats ends at 2**53.
            values = pandas.array(values, dtype="Int64" if max(present) < 2**63 else "UInt64")
        columns[name] = values
    return pandas.DataFrame(columns)


def read_record(path: str | os.PathLike[str]) -> dict[str, pandas.DataFrame]:
    """Read the record of a run (MCAP) as a data frame for each topic, a row a message. Needs pandas and mcap.

    The index is the time of the message, s from the first; nested fields are columns with dots, as in ``pose.position.x``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no record, or is cut short or damaged: ``flix runs repair`` keeps what is whole.
    """
    import pandas
    from mcap.reader import make_reader

    rows: dict[str, list[dict[str, object]]] = {}
    times: dict[str, list[int]] = {}
    with open(path, "rb") as file:
        if file.read(len(MCAP)) != MCAP:
            raise ValueError(f"{path} is no record: it does not begin as MCAP does")
        file.seek(0)
        try:
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                rows.setdefault(channel.topic, []).append(json.loads(message.data))
                times.setdefault(channel.topic, []).append(message.log_time)
        # The reader throws whatever bytes that are missing or changed make fail first.
        except Exception as error:
            raise ValueError(
                f"{path} is cut short or damaged ({error}): `flix runs repair {path}` keeps what is whole"
            ) from error
    begin = min((each[0] for each in times.values()), default=0)
    frames = {}
    for topic, messages in rows.items():
        frame = _frame(messages)
        frame.index = pandas.Index((np.array(times[topic]) - begin) * 1e-9, name="seconds")
        frames[topic] = frame
    return frames
