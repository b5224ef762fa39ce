"""Roll out robots of an exported model by MuJoCo, each at its own theta, and print steps a second.

    python _rollout.py MODEL.xml THREADS ROBOTS STEPS
"""

import math
import sys
import time

import mujoco
import numpy as np
from mujoco import rollout


def rate(path: str, threads: int, robots: int, steps: int) -> float:
    """Return steps a second of all robots together, after 1000 steps each."""
    model = mujoco.MjModel.from_xml_path(path)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = []
    for robot in range(robots):
        data = mujoco.MjData(model)
        for name, sign in (("top", 1), ("bottom", -1)):
            joint = model.joint(name)
            # Heavy rotors keep their speed, as ideal ones do.
            model.dof_armature[joint.dofadr[0]] = 1e6
            data.qpos[joint.qposadr[0]] = -3.0 * robot / robots
            data.qvel[joint.dofadr[0]] = -sign * 2.0 * math.pi * 30.0
        state = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        states.append(state)
    datas = [mujoco.MjData(model) for _ in range(threads)]
    warm, _ = rollout.rollout(model, datas, np.array(states), nstep=1000)
    start = time.perf_counter()
    rollout.rollout(model, datas, np.ascontiguousarray(warm[:, -1]), nstep=steps)
    return robots * steps / (time.perf_counter() - start)


if __name__ == "__main__":
    print(rate(sys.argv[1], *(int(word) for word in sys.argv[2:5])))
