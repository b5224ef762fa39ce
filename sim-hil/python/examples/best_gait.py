"""Search the pair (f, theta) at which the robot goes fastest forward, by the cross-entropy method."""

import numpy as np

import flixwalker

ROBOTS, ELITE, GENERATIONS = 128, 16, 6

random = np.random.default_rng(1)
model = flixwalker.Model("W")
mean, spread = np.array([-25.0, 0.0]), np.array([8.0, 40.0])
for generation in range(GENERATIONS):
    pairs = random.normal(mean, spread, (ROBOTS, 2))
    f, theta = np.clip(pairs[:, 0], -35.0, 35.0), np.clip(pairs[:, 1], -90.0, 90.0)
    speed = flixwalker.walk(
        model, f, theta, seeds=random.integers(2**32, size=ROBOTS), seconds=1.5, step=2.5e-4
    )["forward_m_s"]
    best = np.argsort(speed)[-ELITE:]
    mean = np.array([f[best].mean(), theta[best].mean()])
    spread = np.array([f[best].std(), theta[best].std()]) + [0.2, 1.0]
    print(f"generation {generation + 1}: {speed[best].mean():.3f} m/s at {mean[0]:.1f} Hz, {mean[1]:.0f} degrees")

confirmed = flixwalker.walk(model, mean[0], mean[1], seeds=range(16), seconds=4.0, step=1e-4)["forward_m_s"]
print(f"16 walks of 4 s there: {confirmed.mean():.3f} m/s, spread {confirmed.std(ddof=1):.3f} m/s")
