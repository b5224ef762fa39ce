"""The robot as a Gymnasium environment: ``FlixWalker-v1``, and ``FlixWalker-v0``, in which less of a path is seen.

Every quarter of a second the agent sees where the robot is and how it moved, and chooses f and theta for the next.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from . import _arguments
from ._flixwalker import Film, Model, paper_pairs
from .batch import Batch

#: Fastest shaking that the robot's own software allows, Hz.
FASTEST_HZ = 35.0
#: Weight of a metre off the path against a metre along it, for a quarter of a second.
OFF_PATH = 0.5
#: A robot this near to home has arrived, m.
HOME_M = 0.03
#: Standard gravity of the simulator, m/s^2.
GRAVITY = 9.81
#: No robot walks faster, m/s.
FASTEST_M_S = 0.3
#: Places of the path that are as near as this are equally near, and a robot that trembles by that has not walked back, m.
ALIKE_M, TREMBLING_M = 1.5e-3, 5e-3
#: The way along a path is at most this share of what was walked, for who cuts its bends, and so much more, m, at its tips.
INSIDE, CREDIT_M = 1.5, 0.03
#: So far along the path, or as far as the fastest robot comes, another stretch is looked at beside this one, m.
BESIDE_M = 0.15
#: A robot pulls the point whose way is paid on a thread as long as this, m: a body that trembles pulls nothing.
THREAD_M = 0.01
#: Share of the energy over the weight that is taken from the way of ``"transport"``.
ENERGY_SHARE = 0.1
#: Longest step of the integration, s.
LONGEST_STEP_S = 1e-3

TASKS = ("path", "home", "speed", "transport")
#: Length of an episode that nobody states, s.
EPISODE_S = 60.0
RENDER_MODES = ["html", "rgb_array"]
#: Side of a picture, pixels; floor that it shows around the path, or around home or the robot, m; lines of the floor, m apart.
PIXELS, MARGIN_M, AROUND_M, LINES_M = 480, 0.15, 0.65, 0.1
#: Colours of lines, goal, robot and its front.
LINE, GOAL, BODY, FRONT = (225, 225, 225), (0, 114, 178), (110, 110, 110), (213, 94, 0)

#: FlixWalker-v1: points of the path, how far apart, m, and which of them are seen, m ahead of the nearest.
SPACING_M, AHEAD_M = 2e-3, (0.025, 0.05, 0.1, 0.15)
#: Farther off its path an episode ends, m; a robot as fast as this along it earns the most, m/s.
FARTHEST_M, BRISK_M_S = 0.1, 0.1
#: The largest values that are seen, of the observation in its order.
LARGEST = np.array([0.5, 0.5, 5.0, 0.15, 1.0, 1.0, *[0.3] * 8, 1.0, 1.0], dtype=np.float32)


def figure_eight(size_m: float = 0.5, points: int = 256) -> np.ndarray:
    """Return a closed path like an 8, `size_m` long and half as wide, as (points, 2) in m, from the origin."""
    t = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    return 0.5 * size_m * np.stack([np.sin(t), np.sin(t) * np.cos(t)], axis=1)


class FlixWalkerVectorEnv(VectorEnv):
    """Many robots at once.

    Parameters
    ----------
    num_envs
        Robots.
    task
        ``"path"``: follow a path; the reward is the way along it less half the distance from it. ``"home"``: return to
        the origin from a start up to 0.5 m away. ``"speed"``: go as far as possible in any direction; the reward is the way
        of a point that the robot pulls behind it on a thread of 10 mm, for a body that trembles goes nowhere.
        ``"transport"``: the same at the lowest energy; the reward is that way less a tenth of the energy over the weight.
        An interval that gives back more than it takes, by braking, is free, and no more.
    actions
        ``"pair"``: f and theta as two numbers from -1 to 1, for -35 to 35 Hz and -90 to 90 degrees; what is beyond is clipped.
        ``"modes"``: one of the nine modes of the paper's Tables III and IV. The rotors stand at first, and go from one pair to
        the next as those of `Batch.set_drive`.
    model
        A `Model` or its name.
    randomize
        Ranges of factors by the fields' paths, drawn anew for each episode and robot: ``{"legs.fl.friction": (0.42,
        1.58)}``. A tuple of paths shares one draw.
    path
        (k, 2) in m, closed; an 8 of half a metre if none is given. As long as four intervals of the fastest walk, 0.3 m/s, at
        least. The robot's place on it is looked for within one of these, or 150 mm, of the last one; a place further along than
        it has walked, by a short cut, is not paid for.
    seconds, max_episode_steps
        Length of an episode, s and in actions: the shorter one counts, 60 s if none is given. `gymnasium.make` and `make_vec` give
        240 actions; for a longer episode give them both. `make_vec` warns where an episode is shorter than `seconds`; `make` keeps
        the number to itself.
    interval, step
        Time between two actions, and of the integration, s; the first is a whole number of the second.
    threads
        How many; all cores if none is given, one for a single robot.
    autoreset_mode
        When a robot whose episode is over begins anew: at the next step, which its action is lost to; at the same step,
        with the last observation in ``info["final_obs"]``; or by ``reset`` with ``options["reset_mask"]`` alone.
    render_mode
        ``"html"``: `render` returns a page that plays the first robot's episode. ``"rgb_array"``: a picture of the floor from
        above, (480, 480, 3), of each robot.

    Observations (9): x and y in m, cosine and sine of the heading, speed forward and to the left in m/s and yaw rate in
    rad/s (means over the last interval), and the goal ahead and to the left in m: the next point of the path, or home.
    """

    metadata = {"render_modes": RENDER_MODES, "autoreset_mode": AutoresetMode.NEXT_STEP}
    #: What changes, beside the batch.
    _LASTING: tuple[str, ...] = ("weight", "steps", "done", "place", "behind", "credit", "owed", "motion", "anchor", "billed")
    #: The same, once it was reset.
    _RANDOM = ("random", "_np_random", "_np_random_seed")

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "path",
        actions: str = "pair",
        model: Model | str = "W",
        randomize: Mapping[str | tuple[str, ...], tuple[float, float]] | None = None,
        path: np.ndarray | None = None,
        seconds: float | None = None,
        interval: float = 0.25,
        step: float = 1e-4,
        threads: int | None = None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if task not in TASKS:
            raise ValueError(f"task is {task!r}: choose one of {', '.join(TASKS)}")
        if actions not in ("pair", "modes"):
            raise ValueError(f'actions is {actions!r}: choose "pair" or "modes"')
        if render_mode not in (None, *RENDER_MODES):
            raise ValueError(f"render_mode is {render_mode!r}: choose one of {', '.join(RENDER_MODES)}, or none")
        _arguments.refuse_less_than_one("num_envs", num_envs)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.task = task
        self.actions = actions
        self.model = Model(model) if isinstance(model, str) else model
        self.randomize = dict(randomize or {})
        self.path = figure_eight() if path is None else _arguments.table("path", path).copy()
        if self.path.ndim != 2 or self.path.shape[1] != 2 or len(self.path) < 3:
            raise ValueError(f"path has the shape {self.path.shape}: give (k, 2), three points at least")
        if not np.isfinite(self.path).all():
            raise ValueError("path holds what is no number")
        named = [name for field in self.randomize for name in ((field,) if isinstance(field, str) else field)]
        if twice := sorted({name for name in named if named.count(name) > 1}):
            raise ValueError(f"randomize names {', '.join(twice)} more than once: give one range a field")
        for field, given in self.randomize.items():
            bounds = _arguments.numbers(f"randomize of {field}", given)
            if len(bounds) != 2 or not bounds[0] <= bounds[1]:
                raise ValueError(f"randomize has {given} for {field}: give (low, high)")
            low, high = self.randomize[field] = float(bounds[0]), float(bounds[1])
            for name in (field,) if isinstance(field, str) else field:
                if not isinstance(self.model[name], (int, float)):
                    raise ValueError(f"randomize names {name}, which is no number: name its fields")
                if self.model[name] == 0:
                    raise ValueError(f"randomize names {name}, which is 0, and any factor of it is 0: leave it out")
            self._drawn_at({field: low})
            self._drawn_at({field: high})
        step = _arguments.number("step", step)
        if not 0.0 < step <= LONGEST_STEP_S:
            raise ValueError(f"step is {step} s: choose more than 0, and {LONGEST_STEP_S} s at most")
        interval = _arguments.number("interval", interval)
        steps = interval / step
        if not 0.5 < steps < np.inf or abs(steps - round(steps)) > 1e-9 * steps:
            raise ValueError(f"interval is {interval} s and step {step} s: choose an interval of whole steps")
        self.interval = interval
        self.step_s = step
        if max_episode_steps is not None:
            _arguments.refuse_less_than_one("max_episode_steps", max_episode_steps)
        if seconds is None and max_episode_steps is None:
            seconds = EPISODE_S
        self.limit = np.inf if max_episode_steps is None else max_episode_steps
        if seconds is not None:
            seconds = _arguments.number("seconds", seconds)
            if not 0.0 < seconds < np.inf:
                raise ValueError(f"seconds is {seconds}: choose more than 0")
            self.limit = min(self.limit, max(1, round(seconds / interval)))
            if max_episode_steps is not None and max_episode_steps * interval < seconds:
                warnings.warn(
                    f"an episode ends after {max_episode_steps} actions, {max_episode_steps * interval:g} s, and not after "
                    f"{seconds:g} s: give max_episode_steps, too",
                    stacklevel=2,
                )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode, **_pace(render_mode, interval)}
        self.modes = np.array([[f, theta] for _, f, theta in paper_pairs()])
        self.single_action_space: spaces.Space[Any] = (
            spaces.Discrete(len(self.modes))
            if actions == "modes"
            else spaces.Box(-1.0, 1.0, (2,), np.float32)
        )
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (9,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.batch = Batch([self.model] * num_envs, threads=threads)
        self.weight = np.full(num_envs, GRAVITY * _mass(self.model))
        self.steps = np.zeros(num_envs, dtype=np.int64)
        self.done = np.ones(num_envs, dtype=bool)
        self.first, self.start = 0, self.path[0]
        self.place = np.zeros(num_envs, dtype=np.int64)
        #: How far behind the farthest place that it trembles about, m.
        self.behind = np.zeros(num_envs)
        #: How much way along the path it may yet be paid for what it has walked, m.
        self.credit = np.zeros(num_envs)
        #: Way along the path that waits for that, m.
        self.owed = np.zeros(num_envs)
        self.motion = np.zeros((num_envs, 3))
        self.anchor = np.zeros((num_envs, 2))
        self.billed = np.zeros(num_envs)
        self.film: Film | None = None
        if task == "path":
            self._lay(_distinct(self.path))

    def _lay(self, given: np.ndarray) -> None:
        """Take these points for the path, and find places at even distances on it: the same ones, whichever point is the first."""
        # From its lowest x on; of several such points from the one that what follows puts first.
        lowest = np.flatnonzero(given[:, 0] == given[:, 0].min())
        first = min(lowest, key=lambda point: np.roll(given, -point, axis=0).tolist())
        self.start, self.path = given[0], np.roll(given, -first, axis=0)
        path = self.path
        sides = np.hypot(*np.diff(path, axis=0, append=path[:1]).T)
        self.reach = reach = FASTEST_M_S * self.interval
        length = float(sides.sum())
        if not 4.0 * reach <= length <= 1e3:
            raise ValueError(f"path is {length:.3g} m long: choose {4.0 * reach:.3g} to 1000 m, or another interval")
        count = max(8, round(length / SPACING_M))
        self.spacing = length / count
        at, ends = self.spacing * np.arange(count), np.append(np.cumsum(sides) - sides, length)
        closed = np.vstack([path, path[:1]])
        self.places = np.column_stack([np.interp(at, ends, closed[:, axis]) for axis in range(2)])
        #: The place of the start.
        self.first = round(ends[-first % len(path)] / self.spacing) % count
        #: The point of the path that is nearest along it, for each place.
        self.point = np.searchsorted(0.5 * (ends[1:] + ends[:-1]), at, side="right") % len(path)
        steps = max(2, int(np.ceil(max(reach, min(BESIDE_M, length / 8)) / self.spacing)))
        #: The places that are looked at, from the last one.
        self.around = np.arange(-steps, steps + 1)

    @property
    def nearest(self) -> np.ndarray:
        """Which point of the path each robot is at."""
        return self.point[self.place]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Put all robots, or those of ``options["reset_mask"]``, to new starts."""
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(
                f"reset_mask is {mask.dtype} of the shape {mask.shape}: give bool of ({self.num_envs},)"
            )
        if seed is not None and np.ndim(seed) == 0 and not isinstance(seed, Iterator):
            seed = [_arguments.seed(seed) + robot for robot in range(self.num_envs)]
        # What was before stays where it is refused.
        random, given = list(getattr(self, "random", [])), self._np_random
        if given is not None and not (random and given is random[0]):
            # Somebody has set it.
            random = [np.random.default_rng(int(given.integers(2**63))) for _ in range(self.num_envs)]
        random = random or [np.random.default_rng() for _ in range(self.num_envs)]
        # Gymnasium's word for one that is not known.
        first = -1 if self._np_random_seed is None else self._np_random_seed
        if seed is not None:
            seeds = _arguments.some_seeds(seed)
            if len(seeds) != self.num_envs:
                raise ValueError(f"{len(seeds)} seeds for {self.num_envs} robots: give one, or one a robot")
            for robot in np.flatnonzero(mask):
                # Who is given none goes on with its own.
                if seeds[robot] is not None:
                    random[robot] = np.random.default_rng(seeds[robot])
            if mask[0] and seeds[0] is not None:
                first = seeds[0]
        self._begin(np.flatnonzero(mask), random)
        self.random, self._np_random, self._np_random_seed = random, random[0], first
        return self._observe(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Shake every robot by its action for one interval; what those do that were done says `autoreset_mode`."""
        if not hasattr(self, "random"):
            raise gymnasium.error.ResetNeeded("step was called before reset: call reset first")
        begin = np.flatnonzero(self.done)
        if len(begin) and self.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise gymnasium.error.ResetNeeded(
                f"the episodes of {begin.tolist()} are over: call reset with their reset_mask first"
            )
        self.batch.set_drive(*self._drive(actions))
        position, yaw = self.batch.position.copy(), self.batch.yaw.copy()
        self._run()
        self.steps += 1
        moved = self.batch.position - position
        turned = _wrapped(self.batch.yaw - yaw)
        self.motion = np.column_stack([*_turned(moved, yaw + 0.5 * turned), turned]) / self.interval
        reward = self._reward(np.maximum(self.batch.energy - self.billed, 0.0))
        self.billed = self.batch.energy.copy()
        terminated = self._ended()
        truncated = ~terminated & (self.steps >= self.limit)
        if len(begin):
            self._begin(begin, self.random)
            reward[begin], terminated[begin], truncated[begin] = 0.0, False, False
        self.done = terminated | truncated
        info: dict[str, Any] = {"energy_j": self.batch.energy.copy()}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self.done.any():
            info |= self._final(info)
            self._begin(np.flatnonzero(self.done), self.random)
            info["energy_j"] = self.batch.energy.copy()
        return self._observe(), reward, terminated, truncated, info

    def render(self) -> str | tuple[np.ndarray, ...] | None:
        """Return a page for the browser with the first robot's episode so far, or a picture of each robot."""
        if self.render_mode == "rgb_array":
            return tuple(self._picture(robot) for robot in range(self.num_envs))
        if self.film is None:
            return None
        return self.film.to_html(f"FlixWalker, {self.task}")

    def _picture(self, robot: int) -> np.ndarray:
        """Draw the floor around path, home or robot from above, x to the right: the goal, and the robot with its front."""
        at, yaw = self.batch.position[robot, :2], self.batch.yaw[robot]
        middle, half = (np.zeros(2) if self.task == "home" else at), AROUND_M
        around = np.linspace(0.0, 2.0 * np.pi, 128 if self.task == "home" else 0)
        goals = HOME_M * np.stack([np.cos(around), np.sin(around)], axis=1)
        if self.task == "path":
            goals, low, high = self.places, self.path.min(axis=0), self.path.max(axis=0)
            middle, half = 0.5 * (low + high), 0.5 * (high - low).max() + MARGIN_M
        pixel = 2.0 * half / PIXELS
        side = pixel * (np.arange(PIXELS) + 0.5) - half
        x, y = middle[0] + side[None, :], middle[1] - side[:, None]
        picture = np.full((PIXELS, PIXELS, 3), 255, dtype=np.uint8)
        picture[(x % LINES_M < pixel) | (y % LINES_M < pixel)] = LINE
        column, row = ((goals - middle) * (1, -1) + half).T // pixel
        for right in (-1, 0, 1):
            for down in (-1, 0, 1):
                places = np.stack([row + down, column + right]).astype(np.int64)
                picture[tuple(places.clip(0, PIXELS - 1))] = GOAL
        ahead, left = (part.reshape(PIXELS, PIXELS) for part in _turned(_offsets(x, y, at), yaw))
        half_length, half_width = (0.5e-3 * self.model[f"plate.{side}_mm"] for side in ("length", "width"))
        body = (np.abs(ahead) <= half_length) & (np.abs(left) <= half_width)
        picture[body] = BODY
        picture[body & (ahead > 0.5 * half_length)] = FRONT
        return picture

    def get_state(self) -> dict[str, Any]:
        """Return robots, episodes and random numbers, for `set_state` of an environment that was made alike."""
        return copy.deepcopy(
            {name: getattr(self, name) for name in self._LASTING + self._RANDOM if hasattr(self, name)}
            | {"batch": self.batch.get_state(), "made": self._made()}
        )

    def _made(self) -> tuple[object, ...]:
        """Return what another environment has to have alike to go on from a state of this one."""
        drawn = list(self.randomize.items())
        when = self.interval, self.step_s, self.limit, self.autoreset_mode
        return type(self).__name__, self.num_envs, self.task, self.actions, self.model, drawn, self.path.tolist(), self.start.tolist(), *when

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `get_state` returned, with the same bits; what is filmed begins anew."""
        needed = {"batch", "made", *self._LASTING}
        if not isinstance(state, Mapping) or not needed <= set(state) <= needed | set(self._RANDOM):
            raise ValueError("this is no state of such an environment: give what its get_state returned")
        state = copy.deepcopy(dict(state))
        if state.pop("made") != self._made():
            raise ValueError("this state is of an environment that was made otherwise: give both the same parameters")
        for name in self._LASTING:
            own = getattr(self, name)
            if not isinstance(state[name], np.ndarray) or (state[name].shape, state[name].dtype) != (own.shape, own.dtype):
                raise ValueError(f"{name} of this state was changed: give what get_state returned")
        generators = state.get("random", self.num_envs * [np.random.default_rng(0)])
        if not isinstance(generators, list) or [type(it) for it in generators] != self.num_envs * [np.random.Generator]:
            raise ValueError("random of this state was changed: give what get_state returned")
        self.batch.set_state(state.pop("batch"))
        for name in self._RANDOM:
            vars(self).pop(name, None)
        vars(self).update(state)
        self._film()

    def __getstate__(self) -> dict[str, Any]:
        # A copy films what it does itself.
        return vars(self) | {"film": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._film()

    def _film(self) -> None:
        if self.render_mode != "html" or self.done[0]:
            self.film = None
            return
        reference = self.path.tolist() if self.task == "path" else []
        self.film = Film(self.batch.model(0), float(np.clip(0.1 * self.interval, 1e-4, 1e3)), reference)
        self.film.shoot(self.batch, 0)

    def _ended(self) -> np.ndarray:
        fallen = ~self.batch.alive | (_upward(self.batch.orientation) < 0.5)
        arrived = (self.task == "home") & (np.hypot(*self.batch.position[:, :2].T) < HOME_M)
        return fallen | arrived

    def _final(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return how the episodes ended that are over, in the form of Gymnasium's own vector environments."""
        done, seen = self.done.copy(), self._observe()
        last = np.full(self.num_envs, None, dtype=object)
        for robot in np.flatnonzero(done):
            last[robot] = seen[robot]
        ended = {name: np.where(done, values, 0.0) for name, values in info.items()}
        ended |= {f"_{name}": done.copy() for name in info}
        return {"final_obs": last, "_final_obs": done, "final_info": ended, "_final_info": done.copy()}

    def _drive(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        kinds = _arguments.WHOLE if isinstance(self.single_action_space, spaces.Discrete) else _arguments.NUMBERS
        actions = _arguments.of_kind("actions", actions, kinds, "whole numbers" if kinds == _arguments.WHOLE else "numbers")
        if actions.shape != self.action_space.shape:
            raise ValueError(
                f"actions have the shape {actions.shape}: give {self.action_space.shape}, one a robot"
            )
        if isinstance(self.single_action_space, spaces.Discrete):
            if ((actions < 0) | (actions >= len(self.modes))).any():
                raise ValueError(f"an action is not a mode: choose 0 to {len(self.modes) - 1}")
            f, theta = self.modes[actions.astype(np.int64)].T
        else:
            actions = actions.astype(np.float64)
            if not np.isfinite(actions).all():
                raise ValueError(f"actions hold what is no number: {actions.tolist()}")
            actions = np.clip(actions, -1.0, 1.0)
            f, theta = FASTEST_HZ * actions[:, 0], 90.0 * actions[:, 1]
        return f, np.radians(theta)

    def _run(self) -> None:
        if self.film is None:
            self.batch.run(self.interval, self.step_s)
            return
        # In ten pieces of whole steps: what is filmed walks as what is not.
        ends = np.linspace(0, round(self.interval / self.step_s), 11).round()
        for steps in np.diff(ends):
            self.batch.run(steps * self.step_s, self.step_s)
            self.film.shoot(self.batch, 0)

    def _begin(self, robots: np.ndarray, generators: list[np.random.Generator]) -> None:
        if not len(robots):
            return
        before = [generators[robot].bit_generator.state for robot in robots]
        models, seeds, positions, headings = [], [], [], []
        for robot in robots:
            random = generators[robot]
            models.append(self._drawn(random))
            seeds.append(int(random.integers(2**63)))
            headings.append(random.uniform(-np.pi, np.pi))
            if self.task == "home":
                angle, distance = random.uniform(-np.pi, np.pi), random.uniform(0.1, 0.5)
                positions.append([distance * np.cos(angle), distance * np.sin(angle)])
            elif self.task == "path":
                positions.append(self.start)
            else:
                positions.append([0.0, 0.0])
        try:
            self.batch.reset(seeds, robots, models if self.randomize else None, positions, headings)
        except BaseException:
            # All begin anew, or nothing changes.
            for robot, state in zip(robots, before):
                generators[robot].bit_generator.state = state
            raise
        # The rotors stand, as those of a robot that was just armed.
        self.batch.set_drive(0.0, 0.0, robots)
        if self.randomize:
            self.weight[robots] = [GRAVITY * _mass(model) for model in models]
        self.steps[robots] = 0
        self.done[robots] = False
        self.place[robots] = self.first
        self.behind[robots] = 0.0
        self.credit[robots] = CREDIT_M
        self.owed[robots] = 0.0
        self.motion[robots] = 0.0
        self.anchor[robots] = self.batch.position[robots, :2]
        self.billed[robots] = self.batch.energy[robots]
        if 0 in robots:
            self._film()

    def _drawn(self, random: np.random.Generator) -> Model:
        return self._drawn_at(
            {paths: random.uniform(low, high) for paths, (low, high) in self.randomize.items()}
        )

    def _drawn_at(self, factors: Mapping[str | tuple[str, ...], float]) -> Model:
        fields = {}
        for paths, factor in factors.items():
            for path in (paths,) if isinstance(paths, str) else paths:
                fields[path] = factor * self.model[path]
        return self.model.replace(fields) if fields else self.model

    def _goals(self) -> np.ndarray:
        if self.task == "path":
            return self.path[(self.nearest + 1) % len(self.path)]
        return np.zeros((self.num_envs, 2))

    def _reward(self, energy: np.ndarray) -> np.ndarray:
        now = self.batch.position[:, :2]
        if self.task == "path":
            way = self._follow()
            return way - OFF_PATH * self.interval * np.hypot(*(now - self.places[self.place]).T)
        if self.task == "home":
            before, now = self._moved()
            return np.hypot(*before.T) - np.hypot(*now.T)
        gap = now - self.anchor
        far = np.hypot(*gap.T)
        way = np.maximum(far - THREAD_M, 0.0)
        self.anchor += gap * (way / np.maximum(far, THREAD_M))[:, None]
        return way if self.task == "speed" else way - ENERGY_SHARE * energy / self.weight

    def _moved(self) -> tuple[np.ndarray, np.ndarray]:
        """Return from where to where the robots have gone since the last call, each (n, 2) in m."""
        before, self.anchor = self.anchor, self.batch.position[:, :2].copy()
        return before, self.anchor

    def _follow(self) -> np.ndarray:
        """Take the nearest place near the last one, and return the way from that to it, m, forward along the path.

        Where the path turns back on itself, or passes by itself, places of several stretches are equally near: the next one
        counts that the robot can have walked to, and rather one ahead than one behind. So who turned at a tip, or just before
        it, is on the way back. Way that is much longer than what was walked waits until the robot has walked on, 150 mm of it
        at most.
        """
        before, now = self._moved()
        credit = self.credit + INSIDE * np.hypot(*(now - before).T)
        candidates = (self.place[:, None] + self.around) % len(self.places)
        gap = self.places[candidates] - now[:, None]
        off = np.hypot(gap[..., 0], gap[..., 1])
        beside = np.pad(off, ((0, 0), (1, 1)), constant_values=np.inf)
        is_near = (off <= beside[:, :-2]) & (off <= beside[:, 2:]) & (off <= off.min(axis=1, keepdims=True) + ALIKE_M)
        way = self.spacing * self.around
        behind = np.minimum(self.behind[:, None] + way, 0.0)
        rank = np.abs(way) + np.where(behind < -TREMBLING_M, self.reach, 0.5 * self.spacing * (way < 0.0))
        rank += np.where(np.abs(way) > credit[:, None], 2.0 * way[-1], 0.0)
        best = np.arange(self.num_envs), np.where(is_near, rank, np.inf).argmin(axis=1)
        # Who has walked back further than that begins to tremble there.
        self.behind = np.where(behind[best] < -TREMBLING_M, 0.0, behind[best])
        self.place = candidates[best]
        owed = self.owed + way[best[1]]
        paid = np.clip(owed, -credit, credit)
        self.owed = np.clip(owed - paid, -BESIDE_M, BESIDE_M)
        self.credit = np.minimum(credit - np.abs(paid), CREDIT_M)
        return paid

    def _observe(self) -> np.ndarray:
        at, yaw = self.batch.position[:, :2], self.batch.yaw
        goal = _turned(self._goals() - at, yaw)
        seen = np.column_stack([at, np.cos(yaw), np.sin(yaw), self.motion, *goal])
        return np.nan_to_num(seen).astype(np.float32)


class FlixWalkerEnv(gymnasium.Env[np.ndarray, Any]):
    """One robot; parameters, observations and rewards are those of `FlixWalkerVectorEnv`, and so are the starts of one seed."""

    metadata = {"render_modes": RENDER_MODES, "render_fps": 40}
    _kind: type[FlixWalkerVectorEnv] = FlixWalkerVectorEnv

    def __init__(self, **parameters: Any) -> None:
        if "autoreset_mode" in parameters:
            raise TypeError("one robot begins anew by reset alone: autoreset_mode is for many")
        self.many = self._kind(1, **{"threads": 1, **parameters})
        self.render_mode = self.many.render_mode
        self.metadata = {**self.metadata, **_pace(self.render_mode, self.many.interval)}
        self.observation_space = self.many.single_observation_space
        self.action_space = self.many.single_action_space

    # Gymnasium keeps the generator and its seed under these names.
    @property
    def _np_random(self) -> np.random.Generator | None:
        return self.many._np_random

    @_np_random.setter
    def _np_random(self, generator: np.random.Generator | None) -> None:
        self.many._np_random = generator

    @property
    def _np_random_seed(self) -> int | None:
        return self.many._np_random_seed

    @_np_random_seed.setter
    def _np_random_seed(self, seed: int | None) -> None:
        self.many._np_random_seed = seed

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Put the robot to a new start."""
        if isinstance(seed, bool):
            raise ValueError(f"seed is {seed}: give a whole number")
        seen, _ = self.many.reset(seed=None if seed is None else [seed])
        return seen[0], {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Shake the robot by the action for one interval."""
        seen, reward, terminated, truncated, info = self.many.step([action])
        # Whoever goes on after the end goes on with this robot, as Gymnasium has it.
        self.many.done[:] = False
        return (
            seen[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            {"energy_j": float(info["energy_j"][0])},
        )

    def get_state(self) -> dict[str, Any]:
        """Return robot, episode and random numbers, for `set_state` of an environment that was made alike."""
        return self.many.get_state()

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `get_state` returned, with the same bits; what is filmed begins anew."""
        self.many.set_state(state)

    def render(self) -> str | np.ndarray | None:
        """Return a page for the browser with the episode so far, or a picture."""
        shown = self.many.render()
        return shown[0] if isinstance(shown, tuple) else shown


class FlixWalkerPathVectorEnv(FlixWalkerVectorEnv):
    """Many robots at once that follow a path: ``FlixWalker-v1``, unless another task is chosen. Everything observed and every
    reward has bounds.

    Parameters are those of `FlixWalkerVectorEnv`, without a task.

    Observations (16): speed forward and to the left in m/s and yaw rate in rad/s (means over the last interval); how far the
    robot is to the left of the path, m; cosine and sine of the path's direction against the heading; the points of the path
    25, 50, 100 and 150 mm ahead of the nearest, each ahead and to the left of the robot in m; and the action before, as f over
    35 Hz and theta over 90 degrees.

    Reward: the way along the path over that at 0.1 m/s, at most 1 either way, less the share of 100 mm that the robot is off.
    Farther off, or fallen, the episode ends with -2.
    """

    _LASTING = (*FlixWalkerVectorEnv._LASTING, "action")

    def __init__(self, num_envs: int = 1, **parameters: Any) -> None:
        if "task" in parameters:
            raise ValueError("this environment follows a path: choose tasks by FlixWalker-v1")
        super().__init__(num_envs, "path", **parameters)
        self.path, self.point = self.places, np.arange(len(self.places))
        following = np.roll(self.path, -1, axis=0)
        tangent = following - np.roll(self.path, 1, axis=0)
        # Where the path turns back, it goes where it goes next.
        back = np.hypot(*tangent.T) < 0.5 * self.spacing
        tangent[back] = following[back] - self.path[back]
        self.tangent = tangent / np.hypot(*tangent.T)[:, None]
        self.ahead = np.round(np.array(AHEAD_M) / self.spacing).astype(np.int64)
        self.action = np.zeros((num_envs, 2))
        self.single_observation_space = spaces.Box(-LARGEST, LARGEST, dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def off_path(self) -> np.ndarray:
        """Return how far each robot is to the left of the path, m."""
        gap = self.batch.position[:, :2] - self.path[self.nearest]
        tangent = self.tangent[self.nearest]
        side = np.sign(tangent[:, 0] * gap[:, 1] - tangent[:, 1] * gap[:, 0])
        return side * np.hypot(*gap.T)

    def _drive(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f, theta = super()._drive(actions)
        self.action = np.column_stack([f / FASTEST_HZ, theta / (0.5 * np.pi)])
        return f, theta

    def _begin(self, robots: np.ndarray, generators: list[np.random.Generator]) -> None:
        super()._begin(robots, generators)
        self.action[robots] = 0.0

    def _ended(self) -> np.ndarray:
        return super()._ended() | (np.abs(self.off_path()) > FARTHEST_M)

    def _reward(self, energy: np.ndarray) -> np.ndarray:
        way = self._follow()
        share = np.abs(self.off_path()) / FARTHEST_M
        reward = np.clip(way / (BRISK_M_S * self.interval), -1.0, 1.0) - np.minimum(share, 1.0)
        return np.where(self._ended(), -2.0, reward)

    def _observe(self) -> np.ndarray:
        at, yaw = self.batch.position[:, :2], self.batch.yaw
        points = [
            part for steps in self.ahead for part in _turned(self.path[(self.nearest + steps) % len(self.path)] - at, yaw)
        ]
        tangent = _turned(self.tangent[self.nearest], yaw)
        seen = np.column_stack([self.motion, self.off_path(), *tangent, *points, self.action])
        return np.clip(np.nan_to_num(seen), -LARGEST, LARGEST).astype(np.float32)


class FlixWalkerPathEnv(FlixWalkerEnv):
    """One robot; parameters, observations and rewards are those of `FlixWalkerPathVectorEnv`."""

    _kind = FlixWalkerPathVectorEnv


def newest(task: str = "path", **parameters: Any) -> FlixWalkerEnv:
    """Return ``FlixWalker-v1``: a `FlixWalkerPathEnv`, or a `FlixWalkerEnv` with another task than ``"path"``."""
    return FlixWalkerPathEnv(**parameters) if task == "path" else FlixWalkerEnv(task=task, **parameters)


def newest_vector(num_envs: int = 1, task: str = "path", **parameters: Any) -> FlixWalkerVectorEnv:
    """Return what `newest` does for many robots at once."""
    if task == "path":
        return FlixWalkerPathVectorEnv(num_envs, **parameters)
    return FlixWalkerVectorEnv(num_envs, task, **parameters)


def _distinct(path: np.ndarray) -> np.ndarray:
    """Return a closed path without the points that are where the next one is."""
    return path[np.hypot(*(path - np.roll(path, -1, axis=0)).T) > 1e-9]


def _mass(model: Model) -> float:
    loads = sum(load["mass_g"] for load in model.to_dict().get("load", []))
    return 1e-3 * (model["body.total_mass_g"] + loads)


def _pace(render_mode: str | None, interval: float) -> dict[str, Any]:
    """Return how many pictures make a second of the robot."""
    return {"render_fps": max(1, round(1.0 / interval))} if render_mode == "rgb_array" else {}


def _offsets(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the vectors from a point to all points with these coordinates, as (k, 2)."""
    return np.stack(np.broadcast_arrays(x - at[0], y - at[1]), axis=-1).reshape(-1, 2)


def _turned(vectors: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts forward and to the left of a robot with this heading."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vectors[:, 0], vectors[:, 1]
    return cos * x + sin * y, cos * y - sin * x


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _upward(orientation: np.ndarray) -> np.ndarray:
    """Return the vertical part of the body's upward axis: 1 upright, -1 on its back."""
    return 1.0 - 2.0 * (orientation[:, 1] ** 2 + orientation[:, 2] ** 2)
