"""Step robots here, in the environment and by MuJoCo's `rollout`, on as many threads, in one run.

    python -m flixwalker.bench [--threads 2] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable

import numpy as np

from . import Batch, Model

STEP = 1e-4
ROUNDS = 3


def native(model: Model, precision: str, threads: int, robots: int) -> float:
    """Return steps a second of a batch that is only stepped."""
    batch = Batch([model] * robots, precision, threads)
    batch.reset(range(robots))
    batch.set_drive(30.0, np.linspace(0.0, 3.0, robots))
    batch.run(0.1, STEP)
    seconds = 0.25
    start = time.perf_counter()
    batch.run(seconds, STEP)
    return robots * round(seconds / STEP) / (time.perf_counter() - start)


def environment(model: Model, threads: int, robots: int) -> float:
    """Return steps a second of the environment, an action every quarter of a second."""
    from .env import FlixWalkerVectorEnv

    envs = FlixWalkerVectorEnv(robots, "speed", model=model, threads=threads)
    envs.reset(seed=1)
    action = np.column_stack([np.full(robots, 30.0 / 35.0), np.linspace(-1.0, 1.0, robots)])
    envs.step(action)
    start = time.perf_counter()
    envs.step(action)
    return robots * round(envs.interval / STEP) / (time.perf_counter() - start)


def rollout(model: Model, threads: int, robots: int = 64, steps: int = 1000) -> float:
    """Return steps a second of MuJoCo's own batch."""
    from ._rollout import rate

    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "robot.xml")
        with open(path, "w") as file:
            file.write(model.mjcf(STEP))
        return rate(path, threads, robots, steps)


def main() -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(prog="python -m flixwalker.bench", description=__doc__.split("\n")[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--robots", type=int, default=2048)
    parser.add_argument("--model", default="W")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    model = Model(args.model)
    runs: dict[str, Callable[[], float]] = {
        "single": lambda: native(model, "single", args.threads, args.robots),
        "double": lambda: native(model, "double", args.threads, args.robots),
        "environment": lambda: environment(model, args.threads, args.robots),
        "mujoco": lambda: rollout(model, args.threads),
    }
    best = dict.fromkeys(runs, 0.0)
    for _ in range(ROUNDS):
        for name, run in runs.items():
            try:
                best[name] = max(best[name], run())
            except ImportError as error:
                best[name] = float("nan")
                if not args.json:
                    print(f"{name}: left out ({error})")
    if args.json:
        rates = {name: None if np.isnan(rate) else rate for name, rate in best.items()}
        print(json.dumps({"threads": args.threads, "robots": args.robots, "steps_per_s": rates}))
        return
    print(f"model {args.model}, 0.1 ms, {args.threads} threads, best of {ROUNDS}")
    for name, rate in best.items():
        print(f"{name:12} {rate / 1e6:8.3f} million steps/s  {rate / best['mujoco']:6.1f} times MuJoCo's")
    print(f"the environment runs at {100.0 * best['environment'] / best['single']:.0f} % of the batch alone")


if __name__ == "__main__":
    main()
