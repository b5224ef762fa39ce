"""Compares walks of changing commands in the batch engine with the same robots under their own software.

A sequence is six pairs (f, theta), 25 to 35 Hz either way, held for 0.1 to 1 s each, from rest to rest. Each is walked from
several starts by both, since such a walk magnifies a millimetre; what is compared are means over the starts, beside what
chance makes of them. `pip install sim-hil/python matplotlib`.

    sequences.py --sequences 100 --starts 8 --out out/sequences.png
"""

import argparse
import pathlib
import sys
from concurrent.futures import ThreadPoolExecutor

import matplotlib
import numpy as np

import flixwalker

matplotlib.use("Agg")
from matplotlib import pyplot

COMMANDS, STANDING = 6, 0.6
MODEL = flixwalker.Model("W")
#: Largest difference that is stated, as a share of the way.
LARGEST = 0.10


def drawn(seed):
    """Returns a sequence: f in Hz, theta in degrees, seconds."""
    random = np.random.default_rng(seed)
    pairs = [
        (random.choice([-1, 1]) * random.uniform(25, 35), random.uniform(-90, 90), 1e-3 * random.integers(100, 1001))
        for _ in range(COMMANDS)
    ]
    return [*pairs, (0.0, pairs[-1][1], STANDING)]


def seen_from(position, yaw, to):
    """Returns how far it is, ahead and to the left, m."""
    dx, dy = to - position
    return np.array([np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx])


def under_software(seed, sequence):
    """Returns how far a robot came, and theta where its rotors stood before, degrees."""
    robot = flixwalker.Robot(MODEL, seed=seed)
    robot.arm()
    position, yaw, theta = np.array(robot.position[:2]), robot.yaw, robot.theta_deg
    for f, direction, seconds in sequence:
        robot.drive(f, direction)
        robot.run(seconds)
    return seen_from(position, yaw, np.array(robot.position[:2])), theta


def in_batch(seeds, thetas, sequence):
    """Returns how far the same robots came on ideal drives."""
    batch = flixwalker.Batch([MODEL] * len(seeds))
    batch.reset(seeds)
    batch.set_drive(0.0, np.radians(thetas))
    batch.run(STANDING)
    position, yaw = batch.position[:, :2].copy(), batch.yaw.copy()
    for f, direction, seconds in sequence:
        batch.set_drive(f, np.radians(direction))
        batch.run(seconds)
    return np.array([seen_from(*each) for each in zip(position, yaw, batch.position[:, :2], strict=True)])


def both(number, starts):
    """Returns the ways of a sequence from all starts: (starts, 2) under the software, and in the batch."""
    sequence = drawn(number)
    seeds = [number + 1000 * start for start in range(starts)]
    robots = [under_software(seed, sequence) for seed in seeds]
    return np.array([way for way, _ in robots]), in_batch(seeds, [theta for _, theta in robots], sequence)


def length(vectors):
    """Returns the root of the mean square of their lengths."""
    return np.sqrt(np.mean(np.sum(np.square(vectors), axis=-1)))


def draw(robots, batch, sentence, path):
    """Draws how far each sequence led, by the software from left to right and by the batch upwards."""
    figure, plots = pyplot.subplots(1, 2, figsize=(8.0, 4.2), layout="constrained")
    for axis, (plot, name) in enumerate(zip(plots, ["ahead", "to the left"], strict=True)):
        x, y = 1e3 * robots[..., axis], 1e3 * batch[..., axis]
        plot.plot(x.ravel(), y.ravel(), ".", color="#c0c8d0", markersize=2, label="single starts")
        plot.plot(x.mean(axis=1), y.mean(axis=1), ".", color="#1e72ff", markersize=6, label=f"means of {x.shape[1]}")
        ends = [min(x.min(), y.min()), max(x.max(), y.max())]
        plot.plot(ends, ends, color="#e66a00", linewidth=0.8)
        plot.set(xlabel=f"{name} under the software, mm", ylabel=f"{name} in the batch engine, mm", aspect="equal")
        plot.grid(color="#e1e4e8", linewidth=0.6)
    plots[0].legend(frameon=False)
    figure.suptitle(sentence, fontsize=9)
    figure.savefig(path, dpi=160)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sequences", type=int, default=100)
    parser.add_argument("--starts", type=int, default=8, help="starts of each")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/sequences.png"))
    arguments = parser.parse_args()
    with ThreadPoolExecutor(arguments.threads) as pool:
        ways = list(pool.map(lambda number: both(number, arguments.starts), range(arguments.sequences)))
    robots, batch = (np.array(each) for each in zip(*ways, strict=True))
    walked, off = length(robots.mean(axis=1)), length(robots.mean(axis=1) - batch.mean(axis=1))
    one, two = (length(each[:, 0] - each[:, 1]) for each in (robots, batch))
    single = length(robots[:, 0] - batch[:, 0])
    sentence = (
        f"{arguments.sequences} sequences: {1e3 * walked:.0f} mm (RMS); batch off the software by {1e3 * off:.1f} mm, "
        f"{100 * off / walked:.1f} %;\none start off by {1e3 * single:.0f} mm, two starts apart by {1e3 * one:.0f} mm under the "
        f"software, {1e3 * two:.0f} mm in the batch"
    )
    print(sentence)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    draw(robots, batch, sentence, arguments.out)
    return 0 if off <= LARGEST * walked else 1


if __name__ == "__main__":
    sys.exit(main())
