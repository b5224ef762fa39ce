"""Walk on every core of a Ray cluster, and check against this process.

    pip install ray flixwalker
    python ray_walks.py            # on a cluster: RAY_ADDRESS=auto
"""

import os

import numpy as np
import ray

import flixwalker

WALKS, SLICES = 256, 8


def slice_of_walks(index: int) -> dict[str, np.ndarray]:
    """Walk one slice: seeds of its own, all pairs of the paper in turn."""
    pairs = flixwalker.paper_pairs()
    seeds = np.arange(index, WALKS, SLICES)
    chosen = [pairs[seed % len(pairs)] for seed in seeds]
    return flixwalker.walk(
        flixwalker.Model("W"),
        [f for _, f, _ in chosen],
        [theta for _, _, theta in chosen],
        seeds,
        seconds=1.0,
        step=2.5e-4,
        threads=1,
    )


ray.init(address=os.environ.get("RAY_ADDRESS"), num_cpus=None if "RAY_ADDRESS" in os.environ else 2)
remote = ray.remote(num_cpus=1)(slice_of_walks)
there = ray.get([remote.remote(index) for index in range(SLICES)])
here = [slice_of_walks(index) for index in range(SLICES)]
for a, b in zip(there, here, strict=True):
    assert all((a[name] == b[name]).all() for name in b), "results differ between machines"
nodes = len(ray.nodes())
print(f"{WALKS} walks in {SLICES} slices on {nodes} node(s) by Ray: the same bits as here")
