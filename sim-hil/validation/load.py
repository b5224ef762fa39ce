#!/usr/bin/env python3
"""Load the exported robots in other programs, and compare what these make of them.

    cargo build --release
    pip install drake mujoco pin yourdfpy
    python3 sim-hil/validation/load.py

URDF goes to Drake, MuJoCo, Pinocchio and yourdfpy, MJCF to MuJoCo: each must find the robot's mass and its 26 hinges.
Exit code 1 when one refuses a file or finds another robot.
"""

import argparse
import pathlib
import sys
import tempfile

from validate import flix_sim

MODELS = ["A", "W", "calibrated", "flix", "random-7", "stranger-7"]
# Of two rotors, and of four legs of three segments that bend and twist.
HINGES = 26


def by_drake(file):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(1e-4)
    Parser(plant).AddModels(str(file))
    plant.Finalize()
    hinges = [plant.get_joint(index).num_positions() for index in plant.GetJointIndices()].count(1)
    return hinges, plant.CalcTotalMass(plant.CreateDefaultContext())


def by_mujoco(file):
    import mujoco

    robot = mujoco.MjSpec.from_file(str(file))
    # What stands on the world loses its mass to it: from URDF the base does.
    robot.compiler.fusestatic = False
    model = robot.compile()
    hinges = sum(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    return hinges, model.body_mass.sum()


def by_pinocchio(file):
    import pinocchio

    model = pinocchio.buildModelFromUrdf(str(file), pinocchio.JointModelFreeFlyer())
    return model.njoints - 2, pinocchio.computeTotalMass(model)


def by_yourdfpy(file):
    import yourdfpy

    robot = yourdfpy.URDF.load(str(file))
    if not robot.validate():
        raise ValueError(robot.errors)
    return len(robot.actuated_joints), sum(link.inertial.mass for link in robot.robot.links)


READERS = {"urdf": [by_drake, by_mujoco, by_pinocchio, by_yourdfpy], "mjcf": [by_mujoco]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/flix-sim")
    args = parser.parse_args()
    sound = True
    with tempfile.TemporaryDirectory() as folder:
        for model in MODELS:
            masses = []
            for kind, readers in READERS.items():
                file = pathlib.Path(folder, f"{model}.{kind}".replace("mjcf", "xml"))
                file.write_text(flix_sim(args.program.split(), f"export-{kind}", "--model", model))
                for reader in readers:
                    name = f"{model}, {kind}, {reader.__name__.removeprefix('by_')}"
                    try:
                        hinges, mass = reader(file)
                    except Exception as error:  # noqa: BLE001: whatever another program throws
                        print(f"{name}: {error}")
                        sound = False
                        continue
                    masses.append(mass)
                    print(f"{name}: {mass:.6f} kg, {hinges} hinges")
                    sound &= hinges == HINGES and abs(mass - masses[0]) < 1e-6 * mass
    print("all alike" if sound else "not all alike")
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
