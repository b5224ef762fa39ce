#!/usr/bin/env python3
"""Work against precision: this engine beside MuJoCo, from 1 ms to 0.025 ms a step.

    python3 sim-hil/validation/convergence.py          # measures, writes docs/convergence.csv, .md and .svg
    python3 sim-hil/validation/convergence.py --draw   # writes .md and .svg again from the .csv

Takes some ten minutes, nearly all of them MuJoCo's. `docs/convergence.md` defines the quantities.
"""

import argparse
import csv
import math
import pathlib
import resource
import subprocess
import time

DOCS = pathlib.Path(__file__).parents[1] / "docs"
STEPS_MS = [1.0, 0.5, 0.25, 0.1, 0.05, 0.025]
EXACT_MS = 0.001
ENGINES = ["flix", "mujoco"]
COLOURS = {"flix": "#1e72ff", "mujoco": "#e66a00"}


def mujoco_rows(program, seeds, seconds):
    import mujoco
    import numpy as np
    from validate import flix_sim, held, walk

    leg = flix_sim(program, "export-mjcf", "--model", "A")
    robot = flix_sim(program, "export-mjcf", "--model", "W")
    for ms in [*STEPS_MS, EXACT_MS]:
        model = held(leg)
        model.opt.timestep = 1e-3 * ms
        data = mujoco.MjData(model)
        for k in range(3):
            data.qpos[model.joint(f"fl{k}_bend").qposadr[0]] = 0.1
        for _ in range(round(20 / ms)):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        yield "mujoco", "release", ms, 1e3 * (data.site("fl_tip").xpos[0] - 0.1), 0
    for ms in STEPS_MS:
        xml = robot.replace('timestep="0.0001"', f'timestep="{1e-3 * ms}"')
        start = time.process_time()
        yaw = np.array([walk(xml, -30, math.pi / 2, seed, seconds)[2] for seed in range(seeds)])
        cost = 1e6 * (time.process_time() - start) / (seeds * seconds / (1e-3 * ms))
        yield "mujoco", "walk", ms, yaw.mean(), yaw.std(ddof=1)
        yield "mujoco", "cost", ms, cost, 0


def flix_rows(program, release, seeds, seconds):
    import json

    from validate import flix_sim

    steps = [*STEPS_MS, EXACT_MS]
    done = subprocess.run([*release, *map(str, steps)], capture_output=True, text=True, check=True)
    for ms, value in zip(steps, done.stdout.split()):
        yield "flix", "release", ms, float(value), 0
    for ms in STEPS_MS:
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        found = json.loads(
            flix_sim(
                program, "walk", "--model", "W", "--drive", "ideal", "--json", "--frequency=-30",
                "--direction=90", "--seconds", str(seconds), "--seeds", str(seeds), "--step", f"{1000 * ms:g}us",
            )
        )["yaw_rad_s"]
        cost = 1e6 * (resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
        yield "flix", "walk", ms, found["mean"], found["spread"]
        yield "flix", "cost", ms, cost / (seeds * seconds / (1e-3 * ms)), 0


def table(rows):
    values = {(r["engine"], r["quantity"], float(r["step_ms"])): float(r["value"]) for r in rows}
    spreads = {(r["engine"], float(r["step_ms"])): float(r["spread"]) for r in rows if r["quantity"] == "walk"}
    exact = values["flix", "release", EXACT_MS]
    settled = values["flix", "walk", STEPS_MS[-1]]
    errors = {e: {"release": [], "walk": []} for e in ENGINES}
    lines = []
    for ms in STEPS_MS:
        line = f"| {ms} |"
        for e in ENGINES:
            release = abs(values[e, "release", ms] - exact)
            walk = values[e, "walk", ms]
            off = 100 * (walk / settled - 1)
            errors[e]["release"].append(release)
            errors[e]["walk"].append(abs(off))
            cost = values[e, "cost", ms] / ms
            line += f" {release:.1e} | {walk:.3f} ± {spreads[e, ms]:.3f} | {off:+.1f} | {cost:.1f} |"
        lines.append(line)
    return "\n".join(lines), errors


def panel(out, errors, quantity, label, left, low, high):
    width, height, top = 300, 260, 40
    x = lambda ms: left + width * (math.log10(ms) + 1.7) / 1.8
    y = lambda v: top + height * (1 - (math.log10(max(v, 10**low)) - low) / (high - low))
    out.append(f'<text x="{left}" y="{top - 14}" font-weight="bold">{label}</text>')
    for power in range(low, high + 1):
        out.append(f'<path d="M{left} {y(10**power):.1f}h{width}" stroke="#ddd"/>')
        out.append(f'<text x="{left - 8}" y="{y(10**power) + 4:.1f}" text-anchor="end">{10**power:g}</text>')
    for ms in STEPS_MS:
        out.append(f'<text x="{x(ms):.1f}" y="{top + height + 20}" text-anchor="middle">{ms:g}</text>')
    out.append(f'<text x="{left + width / 2}" y="{top + height + 42}" text-anchor="middle">step (ms)</text>')
    for engine in ENGINES:
        points = [(x(ms), y(v)) for ms, v in zip(STEPS_MS, errors[engine][quantity])]
        path = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in points)
        out.append(f'<path d="{path}" fill="none" stroke="{COLOURS[engine]}" stroke-width="2"/>')
        out += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3.5" fill="{COLOURS[engine]}"/>' for px, py in points]


def draw(errors):
    out = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 800 370" font-family="sans-serif" font-size="12">']
    out.append('<rect width="800" height="370" fill="white"/>')
    panel(out, errors, "release", "release: error (mm)", 70, -6, -1)
    panel(out, errors, "walk", "walk: error (%)", 460, -2, 2)
    for i, (engine, name) in enumerate((("flix", "Flix-Walker"), ("mujoco", "MuJoCo"))):
        out.append(f'<circle cx="{300 + 110 * i}" cy="358" r="5" fill="{COLOURS[engine]}"/>')
        out.append(f'<text x="{310 + 110 * i}" y="362">{name}</text>')
    return "\n".join([*out, "</svg>\n"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="cargo run --release -q -p flix-sim-cli --")
    parser.add_argument("--release", default="cargo run --release -q -p flix-sim --example release --")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--draw", action="store_true", help="do not measure")
    parser.add_argument("--out", type=pathlib.Path, default=DOCS, help="folder to write to")
    a = parser.parse_args()
    path = a.out / "convergence.csv"
    if not a.draw:
        a.out.mkdir(parents=True, exist_ok=True)
        program = a.program.split()
        rows = [*flix_rows(program, a.release.split(), a.seeds, a.seconds)]
        rows += mujoco_rows(program, a.seeds, a.seconds)
        with path.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["engine", "quantity", "step_ms", "value", "spread"])
            writer.writerows(rows)
    with path.open() as file:
        text, errors = table(list(csv.DictReader(file)))
    page = "convergence.md"
    head, _, rest = (DOCS / page).read_text().partition("|---|---|---|---|---|---|---|---|---|\n")
    after = rest[rest.index("\n\n"):]
    (a.out / page).write_text(f"{head}|---|---|---|---|---|---|---|---|---|\n{text}{after}")
    (a.out / "convergence.svg").write_text(draw(errors))
    print(text)


if __name__ == "__main__":
    main()
