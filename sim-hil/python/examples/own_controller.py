"""Follow an 8 with a controller of your own, and write a page that plays it: own-controller.html.

First the robot is asked how it moves in each of the paper's nine modes. Then, four times a second, the mode is taken
whose motion would bring it nearest to a point a little ahead on the path.
"""

import sys

import gymnasium
import numpy as np

import flixwalker

SECONDS = 30.0
LOOK_AHEAD_S = 1.0

pairs = flixwalker.paper_pairs()
f_hz, theta_deg = (np.array([pair[i] for pair in pairs]) for i in (1, 2))
table = flixwalker.walk(flixwalker.Model("W"), f_hz, theta_deg, seeds=1, seconds=4.0, step=2.5e-4)
modes = np.column_stack([table["forward_m_s"], table["lateral_m_s"], table["yaw_rad_s"]])

env = gymnasium.make(
    "FlixWalker-v0", task="path", actions="modes", seconds=SECONDS, step=2.5e-4, render_mode="html"
).unwrapped
seen, _ = env.reset(seed=3)
total, off, done = 0.0, [], False
while not done:
    many = env.many
    ahead = many.path[(many.nearest[0] + 8) % len(many.path)]
    goal = ahead - seen[:2]
    goal = np.array([seen[2] * goal[0] + seen[3] * goal[1], seen[2] * goal[1] - seen[3] * goal[0]])
    # Where each mode leads, in the body's axes of now; a turn that faces the goal helps later.
    turn = 0.5 * modes[:, 2] * LOOK_AHEAD_S
    cos, sin = np.cos(turn), np.sin(turn)
    reach = LOOK_AHEAD_S * np.column_stack(
        [cos * modes[:, 0] - sin * modes[:, 1], sin * modes[:, 0] + cos * modes[:, 1]]
    )
    bearing = np.arctan2(goal[1] - reach[:, 1], goal[0] - reach[:, 0]) - 2.0 * turn
    cost = np.hypot(*(goal - reach).T) + 0.02 * np.abs((bearing + np.pi) % (2 * np.pi) - np.pi)
    seen, reward, terminated, truncated, _ = env.step(int(cost.argmin()))
    total += reward
    off.append(np.hypot(*(seen[:2] - many.path[many.nearest[0]])))
    done = terminated or truncated
path = sys.argv[1] if len(sys.argv) > 1 else "own-controller.html"
with open(path, "w") as file:
    file.write(env.render())
print(f"{SECONDS:.0f} s, {1e3 * np.sqrt(np.mean(np.square(off))):.0f} mm off the path (RMS), reward {total:.2f}; {path}")
