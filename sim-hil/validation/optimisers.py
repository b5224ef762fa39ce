"""Compares the search of `flix-sim study calibrate` (CMA-ES) with a Bayesian optimiser on one budget of walks.

The paper searches with HEBO, a Bayesian optimisation (sections II-C and II-D). This takes `egobox` in its stead, which is kept,
installs as a wheel (`pip install egobox matplotlib numpy`) and has a form for tens of unknowns (CoEGO). Both search the same 19 unknowns
of the same robot for the modes of tables III and IV, from nothing known: the Bayesian one from a Latin hypercube, CMA-ES from
the best of as many random robots. What each holds for its best is then tried on fresh samples.

    optimisers.py --program target/release/flix-sim --budget 230 --runs 3 --out out/optimisers
"""

import argparse
import csv
import json
import pathlib
import subprocess
import tomllib

import egobox
import matplotlib
import numpy

matplotlib.use("Agg")
from matplotlib import pyplot


class Robot:
    """The calibration's unknowns as a function of the unit cube."""

    def __init__(self, program, model, seconds, step, folder):
        self.common = [program, "study", "calibrate", "--model", model, "--fit", "open", "--widen", "2"]
        self.common += ["--seconds", seconds, "--step", step]
        self.file = folder / "points.csv"

    def tried(self, points, seed, samples):
        """Returns loss, signs and hits of each point, means over the samples of this seed."""
        with open(self.file, "w", newline="") as file:
            csv.writer(file).writerows([[f"{x:.6f}" for x in point] for point in points])
        command = [*self.common, "--points", str(self.file), "--seed", str(seed), "--samples", str(samples)]
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    def unknowns(self):
        """Returns the number of unknowns, by asking for none."""
        self.file.write_text("")
        command = [*self.common, "--points", str(self.file)]
        answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        return len(answer["unknowns"])

    def search(self, folder, generations, seed, samples, tries):
        """Goes on with CMA-ES to this generation; returns the middle of its distribution."""
        command = [*self.common, "--start", "anywhere", "--tries", str(tries), "--generations", str(generations)]
        command += ["--seed", str(seed), "--samples", str(samples), "--fresh-seeds", "1", "--out", str(folder)]
        subprocess.run(command, check=True, capture_output=True)
        with open(folder / "search.toml", "rb") as file:
            mean = numpy.array(tomllib.load(file)["search"]["mean"]) % 2.0
        return numpy.where(mean > 1.0, 2.0 - mean, mean)


def bayesian(robot, unknowns, budget, start, seed, samples, held):
    """Returns evaluations and the point that is held for the best after them."""
    cube = [[0.0, 1.0]] * unknowns
    optimiser = egobox.Egor(cube, coego_n_coop=4, seed=seed)
    x = egobox.lhs(cube, start, seed=seed)
    y = numpy.array([[trial["loss"]] for trial in robot.tried(x, seed, samples)["trials"]])
    course = [(len(y), x[y.argmin()])]
    while len(y) < budget:
        point = optimiser.suggest(x, y)
        # Each evaluation on samples of its own, as CMA-ES has them for each generation.
        loss = robot.tried(point, seed + 1000 * len(y), samples)["trials"][0]["loss"]
        x, y = numpy.vstack([x, point]), numpy.vstack([y, [[loss]]])
        if len(y) in held:
            course.append((len(y), x[y.argmin()]))
    return course


def draw(rows, path):
    """Draws hits against evaluations: each search thin, the mean of a kind thick."""
    figure, axes = pyplot.subplots(figsize=(6.4, 3.6), layout="constrained")
    for kind, colour in [("CMA-ES", "#1e72ff"), ("Bayesian", "#e66a00")]:
        own = [row for row in rows if row[0] == kind]
        for run in sorted({row[1] for row in own}):
            course = [(row[2], row[5]) for row in own if row[1] == run]
            axes.plot(*zip(*course), color=colour, linewidth=0.8, alpha=0.5)
        counts = sorted({row[2] for row in own})
        means = [numpy.mean([row[5] for row in own if row[2] == count]) for count in counts]
        axes.plot(counts, means, color=colour, linewidth=2.2, label=f"{kind}, mean of {len({row[1] for row in own})}")
    axes.set(xlabel="evaluations", ylabel="hits of 9 on fresh samples", ylim=(0, 9))
    axes.grid(color="#e1e4e8", linewidth=0.6)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=160)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--program", default="target/release/flix-sim")
    parser.add_argument("--model", default="W", help="what is not searched")
    parser.add_argument("--budget", type=int, default=300, help="evaluations of a search")
    parser.add_argument("--runs", type=int, default=3, help="searches of each kind")
    parser.add_argument("--samples", type=int, default=2, help="scattered robots of an evaluation")
    parser.add_argument("--seconds", default="3s")
    parser.add_argument("--step", default="0.25ms,0.2ms")
    parser.add_argument("--out", default="out/optimisers")
    args = parser.parse_args()
    folder = pathlib.Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    robot = Robot(args.program, args.model, args.seconds, args.step, folder)
    unknowns = robot.unknowns()
    population = 4 + int(3 * numpy.log(unknowns))
    # A generation tries its candidates and the middle of the distribution.
    start, cost = 4 * unknowns, population + 1
    least = start + 2 * cost
    if args.budget < least:
        parser.error(f"--budget is {args.budget}: give {least} at least, {start} random robots and two generations of {cost}")
    generations = range(0, (args.budget - start) // cost + 1, 2)
    held = [start + cost * generation for generation in generations]
    rows = []
    for seed in range(1, args.runs + 1):
        own = folder / f"cmaes-{seed}"
        cmaes = [
            (count, robot.search(own, generation, seed, args.samples, start))
            for generation, count in zip(generations, held)
            if generation > 0
        ]
        bayes = bayesian(robot, unknowns, held[-1], start, seed, args.samples, held)
        for kind, course in [("CMA-ES", cmaes), ("Bayesian", bayes)]:
            trials = robot.tried([point for _, point in course], 900_000 + seed, 16)["trials"]
            for (count, _), trial in zip(course, trials):
                rows.append((kind, seed, count, trial["loss"], trial["signs"], trial["hits"]))
                print(f"{kind:9} run {seed} after {count:4}: {trial['hits']:.2f} hits, {trial['signs']:.2f} signs")
    with open(folder / "optimisers.csv", "w", newline="") as file:
        csv.writer(file).writerows([("search", "run", "evaluations", "loss", "signs", "hits"), *rows])
    draw(rows, folder / "optimisers.png")


if __name__ == "__main__":
    main()
