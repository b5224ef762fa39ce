#!/usr/bin/env python3
"""MuJoCo's part of the work-against-precision study, as CSV: engine, quantity, step in ms, value, spread.

    python3 sim-hil/validation/convergence.py > sim-hil/docs/convergence-mujoco.csv
    cargo run --release -p flix-sim --example convergence

Quantities: `release` is where the tip of model A's clamped front-left leg is along x (mm), 20 ms after it was
let go with 0.1 rad in every bending hinge; `walk` is the mean yaw rate (rad/s) of model W at -30 Hz, 90 degrees,
over 16 seeds of 4 s; `cost` is microseconds of one thread a step of that walk.
"""

import argparse
import math
import time

import mujoco
import numpy as np

from validate import flix_sim, held, walk

STEPS_MS = [1.0, 0.5, 0.25, 0.1, 0.05, 0.025]


def release(xml, step):
    model = held(xml)
    model.opt.timestep = step
    data = mujoco.MjData(model)
    for k in range(3):
        data.qpos[model.joint(f"fl{k}_bend").qposadr[0]] = 0.1
    for _ in range(round(0.02 / step)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return 1e3 * (data.site("fl_tip").xpos[0] - 0.1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="cargo run --release -q --bin flix-sim --")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=4.0)
    a = parser.parse_args()
    program = a.program.split()
    leg = flix_sim(program, "export-mjcf", "--model", "A")
    robot = flix_sim(program, "export-mjcf", "--model", "W")
    print("engine,quantity,step_ms,value,spread")
    for ms in [*STEPS_MS, 0.001]:
        print(f"mujoco,release,{ms},{release(leg, 1e-3 * ms):.9g},0", flush=True)
    for ms in STEPS_MS:
        xml = robot.replace('timestep="0.0001"', f'timestep="{1e-3 * ms}"')
        start = time.process_time()
        yaw = np.array([walk(xml, -30, math.pi / 2, seed, a.seconds)[2] for seed in range(a.seeds)])
        cost = 1e6 * (time.process_time() - start) / (a.seeds * a.seconds / (1e-3 * ms))
        print(f"mujoco,walk,{ms},{yaw.mean():.6g},{yaw.std(ddof=1):.4g}")
        print(f"mujoco,cost,{ms},{cost:.4g},0", flush=True)


if __name__ == "__main__":
    main()
