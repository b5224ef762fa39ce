"""Follows a path: turns towards the point 0.08 m ahead on it, walks forward when it lies ahead.

    flix-sim track circle --controller-process 'python3 sim-hil/examples/follow.py'
"""
import json, math, sys

path = json.loads(sys.stdin.readline())["path"]
print("ready", flush=True)
near = None
for line in sys.stdin:
    pose = json.loads(line)
    ahead = range(len(path)) if near is None else [(near + i) % len(path) for i in range(10)]
    near = min(ahead, key=lambda i: math.dist(path[i], (pose["x"], pose["y"])))
    x, y = path[(near + 4) % len(path)]
    bearing = math.atan2(y - pose["y"], x - pose["x"]) - pose["heading"]
    bearing = math.remainder(bearing, math.tau)
    f, theta = (-30, 30) if abs(bearing) < 0.25 else (-30, 90) if bearing > 0 else (30, 90)
    print(json.dumps({"f": f, "theta": theta}), flush=True)
