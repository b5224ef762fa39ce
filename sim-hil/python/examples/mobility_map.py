"""Map how the robot moves over f and theta, and draw it: mobility.png."""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import flixwalker

SEEDS = 4

f_hz = np.array([-35, -30, -25, -20, -15, -10, 10, 15, 20, 25, 30, 35])
theta_deg = np.arange(-90, 91, 15)
walks = flixwalker.mobility(
    flixwalker.Model("W"), f_hz, theta_deg, range(SEEDS), seconds=2.0, step=2.5e-4
)
columns = {"forward_m_s": "forward, m/s", "lateral_m_s": "to the left, m/s", "yaw_rad_s": "turn to the left, rad/s"}
means = walks.groupby(["theta_deg", "f_hz"])[list(columns)].mean()

figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
for ax, (column, title) in zip(axes, columns.items(), strict=True):
    table = means[column].unstack()
    largest = table.abs().to_numpy().max()
    image = ax.imshow(table, origin="lower", aspect="auto", cmap="RdBu_r", vmin=-largest, vmax=largest)
    ax.set_title(title)
    ax.set_xlabel("f, Hz")
    ax.set_ylabel("theta, degrees")
    ax.set_xticks(range(len(f_hz)), f_hz)
    ax.set_yticks(range(len(theta_deg)), theta_deg)
    figure.colorbar(image, ax=ax)
path = sys.argv[1] if len(sys.argv) > 1 else "mobility.png"
figure.savefig(path, dpi=120)
print(f"{len(walks)} walks; the picture is {path}")
