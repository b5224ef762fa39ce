#!/usr/bin/env python3
"""Checks the simulator against MuJoCo.

Exports a model with `flix-sim export-mjcf`, computes every row of `flix-sim validate` with MuJoCo instead, and
prints both beside each other and beside the reference table. Needs `pip install mujoco` (4.0).

    python3 sim-hil/validation/validate.py
    python3 sim-hil/validation/validate.py --model W --leg rr --force 0,0.1,0 --frequency 25
    python3 sim-hil/validation/validate.py --model W --walk 8      # the nine locomotion modes, 8 seeds
    python3 sim-hil/validation/validate.py --model calibrated --walk 4 --step-ms 0.05
    python3 sim-hil/validation/validate.py --model W --pair=-35,30 --walk 4   # speed and cost of transport of a pair
    python3 sim-hil/validation/validate.py --robots 3              # random robots: every row, and a walk of each
    python3 sim-hil/validation/validate.py --robots 30 --first-robot 1000 --pairs 3 --seconds 2 --step-ms 0.02

Contact is compared at a step where MuJoCo is converged; walks agree within three standard errors plus a tenth.
"""

import argparse
import json
import math
import re
import subprocess
import sys

import mujoco
import numpy as np

LEGS = ["fl", "fr", "rl", "rr"]
# Agreement between both engines: relative, and absolute in the row's unit.
TOLERANCE = {
    "centre of mass": (0.0, 0.05),
    "moment of inertia": (0.002, 0.0),
    "first mode": (1e-6, 0.0),
    "leg": (0.01, 2e-4),
    "dropped": (0.0, 1e-3),
    "floor's force": (0.005, 0.0),
    "in the air": (0.01, 0.01),
    "shaker": (0.002, 0.0),
}
# Paper, tables III and IV: name, f in Hz, theta in degrees, which of forward, lateral, yaw dominates, its sign.
MODES = [
    ("forward", -30, 30, 0, 1),
    ("forward II", -35, 30, 0, 1),
    ("left", -30, 90, 2, 1),
    ("left II", -30, 60, 2, 1),
    ("right", 30, 90, 2, -1),
    ("right II", -35, -30, 2, -1),
    ("strafe left", 30, 30, 1, 1),
    ("strafe left II", 35, 0, 1, 1),
    ("strafe right", -30, -60, 1, -1),
]
# Makes a speed of a yaw rate, m; what is slower than this is no mode, m/s.
LEVER = 0.1
LEAST_SPEED = 0.01
# Means of walks agree within so many standard errors plus this share; slower than the last is nil (m/s, rad/s).
STANDARD_ERRORS = 3.0
SHARE = 0.1
NIL = [0.002, 0.002, 0.02]
# Share of the components of random robots' walks that have to agree.
WALKS_MET = 230 / 240
# Interval of the smoothed path, s.
PATH_INTERVAL = 0.25
# Time between two samples of a walk's speed, s.
SAMPLE = 2e-4
# Walks of random robots: f in Hz and theta in degrees, chosen in turn.
RANDOM_PAIRS = [(-30, 30), (30, 90), (-25, -60), (35, 0), (20, 60)]


def flix_sim(program, *arguments):
    """Runs the simulator; its JSON says itself whether a row fails."""
    done = subprocess.run([*program, *arguments], capture_output=True, text=True)
    if done.returncode not in (0, 1) or not done.stdout:
        sys.exit(f"{' '.join(program)} failed: {done.stderr.strip()}")
    return done.stdout


def held(xml):
    """The model with its body welded to the world, without contact."""
    # A keyframe states the pose of the body's free joint, too.
    fixed = re.sub(r"<freejoint[^>]*/>|<keyframe>.*?</keyframe>", "", xml, flags=re.DOTALL)
    model = mujoco.MjModel.from_xml_string(fixed)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return model


def ideal(model, data, f, theta):
    """Rotors at constant speed whatever acts on them: nothing turns an infinite inertia."""
    for name, sign in (("top", 1.0), ("bottom", -1.0)):
        joint = model.joint(name)
        model.dof_armature[joint.dofadr[0]] = 1e6
        data.qpos[joint.qposadr[0]] = -theta
        data.qvel[joint.dofadr[0]] = -sign * 2 * math.pi * f


def shaker_rows(xml, f, theta):
    model = held(xml)
    data = mujoco.MjData(model)
    ideal(model, data, f, theta)
    omega = 2 * math.pi * f
    middle = 0.5 * (model.body("top").pos + model.body("bottom").pos) + model.body("base_link").pos
    c, s = math.cos(theta), math.sin(theta)
    count = 400
    along = across = vertical = sine = cosine = 0.0
    for i in range(count):
        phase = 2 * math.pi * i / count
        for name, sign in (("top", 1.0), ("bottom", -1.0)):
            data.qpos[model.joint(name).qposadr[0]] = -theta - sign * phase
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        force, torque = np.zeros(3), np.zeros(3)
        for name in ("top", "bottom"):
            body = model.body(name).id
            wrench = -data.cfrc_int[body]
            lever = data.subtree_com[model.body_rootid[body]] - middle
            force += wrench[3:]
            torque += wrench[:3] + np.cross(lever, wrench[3:])
        along = max(along, abs(force[0] * c - force[1] * s))
        across = max(across, abs(force[0] * s + force[1] * c))
        vertical = max(vertical, abs(torque[2]))
        sine += (torque[0] * c - torque[1] * s) * math.sin(phase) * math.copysign(1, omega)
        cosine += (torque[0] * s + torque[1] * c) * math.cos(phase)
    name = f"shaker on a stand at {f:g} Hz: "
    return {
        name + "force along theta": along,
        name + "force across theta": across,
        name + "torque about z": vertical,
        name + "torque h m w^2 l": abs(2 * sine / count),
        name + "cosine torque of gravity": abs(2 * cosine / count),
    }


def floating_rows(xml, f, theta):
    """Amplitudes of the body in free space, from the start without momentum, so that it does not tumble."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    mass = np.zeros((model.nv, model.nv))
    ideal(model, data, f, theta)
    endless = model.dof_armature.copy()
    model.dof_armature[:] = 0
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    model.dof_armature[:] = endless
    data.qvel[:6] = -np.linalg.solve(mass[:6, :6], mass[:6, 6:] @ data.qvel[6:])
    period = 1 / abs(f)
    model.opt.timestep = period / math.ceil(period / model.opt.timestep)
    count = round(math.ceil(abs(f)) * period / model.opt.timestep)
    mujoco.mj_step(model, data, round(1 / model.opt.timestep))
    poses = []
    for _ in range(count):
        mujoco.mj_step(model, data)
        w, x, y, z = data.qpos[3:7]
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        poses.append([*data.qpos[:2], roll, math.asin(2 * (w * y - z * x))])
    t = np.arange(count) * model.opt.timestep
    phase = 2 * math.pi * f * t
    basis = np.stack([np.ones(count), t, t * t, np.cos(phase), np.sin(phase)], 1)
    fit = np.linalg.lstsq(basis, np.array(poses), rcond=None)[0]
    x, y, roll, pitch = np.hypot(fit[3], fit[4])
    name = f"in the air at {f:g} Hz: body "
    return {
        name + "along x": 1e3 * x,
        name + "along y": 1e3 * y,
        name + "in roll": math.degrees(roll),
        name + "in pitch": math.degrees(pitch),
    }


def standing_rows(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = model.body_mass
    center = (mass[:, None] * data.xipos).sum(0) / mass.sum()
    inertia = np.zeros((3, 3))
    for body in range(1, model.nbody):
        turn = data.ximat[body].reshape(3, 3)
        r = data.xipos[body] - center
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia += mass[body] * (r @ r * np.eye(3) - np.outer(r, r))
    rows = {
        "centre of mass above the soles": 1e3 * center[2],
        "centre of mass forward of the centre": 1e3 * center[0],
    }
    for i, axis in enumerate("xyz"):
        rows[f"moment of inertia about {axis}"] = inertia[i, i]
    return rows


def leg_rows(xml, leg, force, torque):
    model = held(xml)
    tip, foot = model.site(f"{leg}_tip"), model.body(f"{leg}_foot")
    name = f"leg {leg} clamped, with its foot"
    rows = mode_rows(model, leg, f"{name}: first mode")
    # The table's leg has its foot along x, where the model has it across.
    along = held(xml)
    x, y, z = along.body_inertia[foot.id]
    if x > y:
        along.body_inertia[foot.id] = [y, x, z]
        # Its shift along the long axis turns too: outward becomes forward (or backward).
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, along.body_quat[foot.id])
        right, forward = turn.reshape(3, 3)[:, 1], turn.reshape(3, 3)[:, 0]
        side = {"f": 1, "r": -1}[leg[0]] * {"l": 1, "r": -1}[leg[1]]
        shift = along.body_pos[foot.id] @ right
        along.body_pos[foot.id] += shift * (side * forward - right)
    rows |= mode_rows(along, leg, f"{name} along x: first mode")

    model.body_mass[foot.id] = 1e-4
    model.body_inertia[foot.id] *= 1e-4 / 3e-3
    mujoco.mj_setConst(model, mujoco.MjData(model))

    def bent(force, torque):
        data = mujoco.MjData(model)
        for _ in range(10_000):
            data.qfrc_applied[:] = 0
            mujoco.mj_forward(model, data)
            mujoco.mj_applyFT(
                model, data, force, torque, data.site_xpos[tip.id],
                model.site_bodyid[tip.id], data.qfrc_applied,
            )
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        return data.site_xpos[tip.id].copy()

    moved = 1e3 * (bent(force, torque) - bent(np.zeros(3), np.zeros(3)))
    for i, axis in enumerate("xyz"):
        rows[f"leg {leg} clamped, loaded: tip along {axis}"] = moved[i]
    return rows


def mode_rows(model, leg, name):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    joints = [model.joint(f"{leg}{k}_{kind}") for k in range(3) for kind in ("bend", "twist")]
    at = [joint.dofadr[0] for joint in joints]
    inverse = np.linalg.inv(full[np.ix_(at, at)])
    stiffness = np.diag([joint.stiffness[0] for joint in joints])
    damping = np.diag([joint.damping[0] for joint in joints])
    system = np.block([[np.zeros((6, 6)), np.eye(6)], [-inverse @ stiffness, -inverse @ damping]])
    first = min((v for v in np.linalg.eigvals(system) if v.imag > 0), key=abs)
    return {name: abs(first) / (2 * math.pi), f"{name}, damping": -first.real / abs(first)}


def rest_rows(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[2] += 0.02
    for _ in range(round(2 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    load, wrench = 0.0, np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        load += wrench[0]
    return {
        "dropped from 20 mm, at rest: plate's height": 1e3 * data.qpos[2],
        "floor's force at rest": load,
    }


def walk(xml, f, theta, seed, seconds):
    """Mean forward, lateral and yaw speed from a start disturbed by up to 1 mm."""
    return walk_and_work(xml, f, theta, seed, seconds)[:3]


def walk_and_work(xml, f, theta, seed, seconds):
    """The same, then the speed along the smoothed path and the cost of transport."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    random = np.random.default_rng(seed)
    data.qpos[:2] += 1e-3 * random.uniform(-1, 1, 2)
    data.qpos[2] += 1e-3 * random.uniform(0, 1)
    ideal(model, data, f, theta)
    rotors = [model.joint(name).dofadr[0] for name in ("top", "bottom")]
    forward = lateral = yaw = last = work = path = 0.0
    mark = data.qpos[:2].copy()
    steps = max(1, round(SAMPLE / model.opt.timestep))
    samples = round(seconds / (steps * model.opt.timestep))
    smooth = max(1, round(PATH_INTERVAL / (steps * model.opt.timestep)))
    for sample in range(samples):
        for _ in range(steps):
            mujoco.mj_step(model, data)
            # What holds a rotor of infinite inertia at its speed is what a motor would have to give.
            torque = -model.dof_armature[rotors] * data.qacc[rotors]
            work += float(torque @ data.qvel[rotors]) * model.opt.timestep
        w, x, y, z = data.qpos[3:7].tolist()
        heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        yaw += (heading - last + math.pi) % (2 * math.pi) - math.pi
        last = heading
        c, s = math.cos(heading), math.sin(heading)
        along_x, along_y = data.qvel[:2].tolist()
        forward += along_x * c + along_y * s
        lateral += along_y * c - along_x * s
        if (sample + 1) % smooth == 0 or sample + 1 == samples:
            path += math.dist(data.qpos[:2], mark)
            mark = data.qpos[:2].copy()
    weight = float(model.body_mass.sum()) * np.linalg.norm(model.opt.gravity)
    return forward / samples, lateral / samples, yaw / seconds, path / seconds, work / (weight * path)


def agree(theirs, ours):
    """Which components of the mean motion agree, within the standard errors of both and a share."""
    spread = np.array([o["spread"] for o in ours]) / math.sqrt(len(theirs))
    error = np.hypot(theirs.std(0, ddof=1) / math.sqrt(len(theirs)), spread)
    mean, here = theirs.mean(0), np.array([o["mean"] for o in ours])
    return np.abs(mean - here) <= STANDARD_ERRORS * error + SHARE * np.abs(mean) + NIL


def walked(program, model, f, theta, seeds, seconds, step_ms):
    report = flix_sim(
        program, "walk", "--model", model, "--drive", "ideal", "--json", f"--frequency={f}",
        f"--direction={theta}", "--seconds", str(seconds), "--seeds", str(seeds), "--step", f"{step_ms:g}ms",
    )
    return [json.loads(report)[k] for k in ("forward_m_s", "lateral_m_s", "yaw_rad_s")]


def is_hit(motion, component, sign):
    """Whether the named component has its sign, is the largest, and is no creep."""
    speeds = np.asarray(motion) * [1, 1, LEVER]
    rivals = np.abs(np.delete(speeds, component))
    return sign * speeds[component] > max(*rivals, LEAST_SPEED)


def walks(program, xml, model, seeds, seconds, step_ms):
    print(f"{'':16}{'f':>5}{'theta':>7}   MuJoCo: forward, lateral, yaw    here{'hits of both':>33}")
    total = np.zeros(2)
    for name, f, theta, component, sign in MODES:
        theirs = np.array([walk(xml, f, math.radians(theta), s, seconds) for s in range(seeds)])
        here = [o["mean"] for o in walked(program, model, f, theta, seeds, seconds, step_ms)]
        cells = "  ".join(f"{v:7.3f}" for v in [*theirs.mean(0), *here])
        hits = np.array([is_hit(motion, component, sign) for motion in (theirs.mean(0), here)])
        total += hits
        marks = "  ".join("hit " if hit else "miss" for hit in hits)
        print(f"{name:16}{f:5}{theta:7}   {cells}   {marks}", flush=True)
    print(f"hits of {len(MODES)}: MuJoCo {total[0]:.0f}, here {total[1]:.0f}")


def pair(program, xml, model, f, theta, seeds, seconds, step_ms):
    """Speed along the path and cost of transport of one pair, MuJoCo's and ours, as means over the seeds."""
    theirs = np.array([walk_and_work(xml, f, math.radians(theta), s, seconds)[3:] for s in range(seeds)])
    report = flix_sim(
        program, "walk", "--model", model, "--drive", "ideal", "--json", f"--frequency={f}",
        f"--direction={theta}", "--seconds", str(seconds), "--seeds", str(seeds), "--step", f"{step_ms:g}ms",
    )
    walked = json.loads(report)
    ours = [walked["path_m"]["mean"] / seconds, walked["cost_of_transport"]["mean"]]
    for name, unit, their, our in zip(("speed", "cost of transport"), ("m/s", ""), theirs.T, ours):
        spread = their.std(ddof=1) if seeds > 1 else 0.0
        print(f"{name:18} MuJoCo {their.mean():.4f} +- {spread:.4f}, here {our:.4f} {unit}")


def tolerance(name, value):
    relative, absolute = next(v for k, v in TOLERANCE.items() if k in name)
    # What is nil is compared with the row that it is a small part of; 1e-3 N or N m is nil here.
    return max(relative * abs(value), absolute, 1e-3 if name.startswith("shaker") else 0.0)


def compare(program, model, frequencies, a):
    """Every row of `flix-sim validate` with MuJoCo's value and whether all three agree."""
    xml = flix_sim(program, "export-mjcf", "--model", model, "--step-ms", f"{a.step_ms:g}")
    force, torque = (np.array([float(v) for v in t.split(",")]) for t in (a.force, a.torque))
    theirs = {}
    for f in frequencies:
        theirs |= shaker_rows(xml, f, math.radians(a.direction))
        theirs |= floating_rows(xml, f, math.radians(a.direction))
    theirs |= standing_rows(xml) | leg_rows(xml, a.leg, force, torque) | rest_rows(xml)
    options = [f"--frequency={f}" for f in frequencies]
    options += [f"--direction={a.direction}", "--leg", a.leg, f"--force={a.force}", f"--torque={a.torque}"]
    report = json.loads(flix_sim(program, "validate", "--json", "--model", model, *options))
    rows = []
    for row in report["rows"]:
        value = theirs.get(row["name"])
        agrees = value is None or abs(value - row["value"]) <= tolerance(row["name"], value)
        reference = row["reference"]
        if value is not None and reference is not None:
            agrees = agrees and abs(value - reference) <= row["tolerance"]
        rows.append({**row, "mujoco": value, "pass": bool(agrees and row["pass"])})
    return report["model"], rows


def robots(program, a):
    """Random robots: all rows, and walks of each."""
    seeds = a.walk or 4
    met = total = 0
    walks_met = walks_total = 0
    for index in range(a.robots):
        model = f"random-{a.first_robot + index}"
        _, rows = compare(program, model, a.frequency or [20.0, 35.0], a)
        for row in rows:
            if not row["pass"]:
                print(f"{model}: {row['name']}: {row['value']:.6g} here, {row['mujoco']} in MuJoCo {row['unit']}")
        met, total = met + sum(row["pass"] for row in rows), total + len(rows)
        xml = flix_sim(program, "export-mjcf", "--model", model, "--step-ms", f"{a.step_ms:g}")
        for turn in range(a.pairs):
            f, theta = RANDOM_PAIRS[(index + turn) % len(RANDOM_PAIRS)]
            theirs = np.array([walk(xml, f, math.radians(theta), s, a.seconds) for s in range(seeds)])
            ours = walked(program, model, f, theta, seeds, a.seconds, a.step_ms)
            fits = agree(theirs, ours)
            walks_met, walks_total = walks_met + fits.sum(), walks_total + len(fits)
            cells = "  ".join(f"{v:7.3f}" for v in [*theirs.mean(0), *(o["mean"] for o in ours)])
            print(f"{model:12}{f:5}{theta:5}   {cells}   {'' if fits.all() else 'walks apart'}", flush=True)
    print(f"rows met: {met} of {total}; components of walks: {walks_met} of {walks_total}")
    return 0 if met == total and walks_met >= WALKS_MET * walks_total else 1


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="cargo run --release -q -p flix-sim-cli --", help="how to run flix-sim")
    parser.add_argument("--model", default="A", help="a shipped name or a TOML file")
    parser.add_argument("--frequency", type=float, action="append", help="Hz; several allowed")
    parser.add_argument("--direction", type=float, default=30.0, help="degrees to the right")
    parser.add_argument("--leg", default="fl", choices=LEGS)
    parser.add_argument("--force", default="0.2,0,0", help="N, X,Y,Z")
    parser.add_argument("--torque", default="0,0,0", help="N m, X,Y,Z")
    parser.add_argument("--walk", type=int, metavar="SEEDS", help="walk the nine modes instead")
    parser.add_argument("--pair", metavar="F,THETA", help="walk this pair alone: speed and cost of transport")
    parser.add_argument("--robots", type=int, metavar="N", help="compare random robots instead")
    parser.add_argument("--first-robot", type=int, default=1, metavar="SEED", help="seed of the first random robot")
    parser.add_argument("--pairs", type=int, default=1, choices=range(1, 6), help="walks of each random robot")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--step-ms", type=float, default=0.1, help="MuJoCo's step, and of walks ours")
    parser.add_argument("--json", action="store_true")
    a = parser.parse_args()
    program = a.program.split()
    if a.robots:
        return robots(program, a)
    if a.pair:
        xml = flix_sim(program, "export-mjcf", "--model", a.model, "--step-ms", f"{a.step_ms:g}")
        f, theta = (float(value) for value in a.pair.split(","))
        pair(program, xml, a.model, f, theta, a.walk or 4, a.seconds, a.step_ms)
        return 0
    if a.walk:
        xml = flix_sim(program, "export-mjcf", "--model", a.model, "--step-ms", f"{a.step_ms:g}")
        return walks(program, xml, a.model, a.walk, a.seconds, a.step_ms)
    name, rows = compare(program, a.model, a.frequency or [10.0, 20.0, 30.0, 35.0], a)
    passed = all(row["pass"] for row in rows)
    if a.json:
        print(json.dumps({"model": name, "rows": rows, "pass": passed}))
    else:
        print(f"{'':58}{'here':>12}{'MuJoCo':>12}{'reference':>12}")
        for row in rows:
            cells = "".join(
                f"{'-':>12}" if row[k] is None else f"{row[k]:12.4e}" for k in ("value", "mujoco", "reference")
            )
            print(f"{row['name']:58}{cells} {row['unit']}{'' if row['pass'] else '  NOT MET'}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
