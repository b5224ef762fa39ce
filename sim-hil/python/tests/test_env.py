"""The environment, as Gymnasium's checker and a stranger see it."""

import copy
import pickle
import warnings
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import flixwalker
from flixwalker.env import TASKS, FlixWalkerEnv, FlixWalkerPathVectorEnv, FlixWalkerVectorEnv

SHORT = {"seconds": 0.5, "interval": 0.05, "step": 2.5e-4}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("actions", ["pair", "modes"])
def test_the_checker_has_nothing_to_say(task: str, actions: str) -> None:
    env = gymnasium.make("FlixWalker-v0", task=task, actions=actions, **SHORT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # What has no bounds in space has none here either.
        warnings.filterwarnings("ignore", message=".*observation space (minimum|maximum) value is.*inf.*")
        warnings.filterwarnings("ignore", message=".*A Box observation space.*inf.*")
        warnings.filterwarnings("ignore", message=".*render.*")
        check_env(env.unwrapped)


def rolled(num_envs: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    envs = gymnasium.make_vec("FlixWalker-v0", num_envs=num_envs, task="home", **SHORT)
    seen, _ = envs.reset(seed=seed)
    action = np.tile([0.8, 0.3], (num_envs, 1)).astype(np.float32)
    all_seen, rewards = [seen], []
    for _ in range(14):
        seen, reward, *_ = envs.step(action)
        all_seen.append(seen)
        rewards.append(reward)
    return np.array(all_seen), np.array(rewards)


def test_the_same_seed_gives_the_same_episodes_in_any_company() -> None:
    seen, rewards = rolled(20)
    again, _ = rolled(20)
    fewer, _ = rolled(3)
    assert (seen == again).all()
    assert (seen[:, :3] == fewer).all()
    assert (np.abs(rewards) > 0.0).any()


def test_an_episode_ends_and_the_next_step_begins_another() -> None:
    envs = FlixWalkerVectorEnv(2, "speed", **SHORT)
    envs.reset(seed=1)
    for step in range(1, 11):
        *_, truncated, _ = envs.step(np.zeros((2, 2)))
        assert truncated.all() == (step == 10)
    seen, reward, terminated, truncated, _ = envs.step(np.ones((2, 2)))
    assert not terminated.any() and not truncated.any() and (reward == 0.0).all()
    assert np.abs(seen[:, :2]).max() < 2e-3


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_episode_that_is_over_goes_on_as_in_gymnasiums_own_vectors(mode: AutoresetMode) -> None:
    lengths = {"autoreset_mode": mode, "max_episode_steps": 3}
    envs = gymnasium.make_vec("FlixWalker-v0", num_envs=2, task="speed", **lengths, interval=1.0, step=2.5e-4)
    assert envs.metadata["autoreset_mode"] is mode
    envs.reset(seed=1)
    walk = np.tile([0.9, 0.3], (2, 1))
    for _ in range(2):
        *_, truncated, _ = envs.step(walk)
        assert not truncated.any()
    seen, reward, _, truncated, info = envs.step(walk)
    assert truncated.all() and (reward != 0.0).all()
    if mode is AutoresetMode.SAME_STEP:
        assert np.abs(seen[:, :2]).max() < 2e-3 < np.abs(np.stack(info["final_obs"])[:, :2]).max()
        assert (info["final_info"]["energy_j"] > 0.0).all() and info["_final_obs"].all()
    else:
        assert np.abs(seen[:, :2]).max() > 2e-3 and "final_obs" not in info
    if mode is AutoresetMode.DISABLED:
        with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
            envs.step(walk)
        envs.reset(options={"reset_mask": np.array([True, False])})
        with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[1\]"):
            envs.step(walk)
        envs.reset(options={"reset_mask": np.array([False, True])})
    _, reward, _, truncated, _ = envs.step(walk)
    assert not truncated.any()
    assert (reward == 0.0).all() == (mode is AutoresetMode.NEXT_STEP)


@pytest.mark.parametrize("steps", [0, -1, True, 2.5])
def test_an_episode_without_a_step_is_refused(steps: float) -> None:
    with pytest.raises(ValueError, match="max_episode_steps is"):
        FlixWalkerVectorEnv(1, max_episode_steps=steps)


def test_every_episode_draws_a_robot_of_its_own() -> None:
    left = ("legs.fl.friction", "legs.rl.friction")
    envs = FlixWalkerVectorEnv(4, "path", randomize={left: (0.42, 1.58)}, **SHORT)
    envs.reset(seed=1)
    usual = flixwalker.Model("W")
    factors = [
        [envs.batch.model(robot)[path] / usual[path] for path in left] for robot in range(4)
    ]
    assert len({front for front, _ in factors}) == 4
    assert all(front == pytest.approx(rear) and 0.42 <= front <= 1.58 for front, rear in factors)


def test_the_first_robots_episode_is_a_page() -> None:
    env = gymnasium.make("FlixWalker-v0", render_mode="html", **SHORT)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert "<html" in env.unwrapped.render()


def test_a_wrong_word_is_refused_with_the_right_ones() -> None:
    with pytest.raises(ValueError, match="path, home, speed, transport"):
        FlixWalkerVectorEnv(1, "fly")


def test_a_reset_of_some_robots_leaves_the_others_as_they_were() -> None:
    envs = FlixWalkerVectorEnv(3, "home", **SHORT)
    envs.reset(seed=1)
    before = [random.bit_generator.state for random in envs.random]
    seen, _ = envs.reset(seed=[7, 8, 9], options={"reset_mask": np.array([False, True, False])})
    after = [random.bit_generator.state for random in envs.random]
    assert before[0] == after[0] and before[2] == after[2] and before[1] != after[1]
    alone = FlixWalkerVectorEnv(3, "home", **SHORT)
    assert (alone.reset(seed=np.array([7, 8, 9]))[0][1] == seen[1]).all()


def test_what_cannot_be_is_refused_at_once_in_a_sentence() -> None:
    with pytest.raises(KeyError, match="no field legs.colour"):
        FlixWalkerVectorEnv(1, randomize={"legs.colour": (0.5, 1.5)})
    with pytest.raises(ValueError, match="give .low, high."):
        FlixWalkerVectorEnv(1, randomize={"legs.fl.friction": (1.5, 0.5)})
    with pytest.raises(ValueError, match="friction = .* is outside"):
        FlixWalkerVectorEnv(1, randomize={"legs.fl.friction": (0.5, 100.0)})
    envs = FlixWalkerVectorEnv(2, actions="modes", **SHORT)
    with pytest.raises(ValueError, match="2 robots"):
        envs.reset(seed=[1, 2, 3])
    envs.reset(seed=1)
    for mode in (-1, 9):
        with pytest.raises(ValueError, match="choose 0 to 8"):
            envs.step(np.array([0, mode]))


def test_watching_changes_nothing() -> None:
    def walked(render_mode: str | None) -> np.ndarray:
        env = gymnasium.make("FlixWalker-v0", render_mode=render_mode, interval=0.0123, seconds=1.0)
        env.reset(seed=5)
        seen = []
        for action in ([0.9, 0.3], [-0.8, 0.9], [0.7, -0.9], [0.0, 0.0]) * 3:
            seen.append(env.step(np.array(action, dtype=np.float32))[0])
            if render_mode:
                env.render()
        return np.array(seen)

    assert (walked("html") == walked(None)).all()


def test_an_interval_is_a_whole_number_of_steps() -> None:
    with pytest.raises(ValueError, match="choose an interval of whole steps"):
        FlixWalkerVectorEnv(2, interval=0.12345)


@pytest.mark.parametrize("actions", [np.zeros((4, 3)), np.zeros((1, 2)), np.zeros(2), [["1", "0"]] * 4, [[np.nan, 0.0]] * 4])
def test_actions_of_another_shape_or_kind_are_refused(actions: object) -> None:
    envs = FlixWalkerVectorEnv(4, **SHORT)
    envs.reset(seed=1)
    with pytest.raises(ValueError, match="actions"):
        envs.step(actions)


def test_a_step_before_a_reset_and_a_factor_of_nothing_are_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        FlixWalkerVectorEnv(2, **SHORT).step(np.zeros((2, 2)))
    zero = flixwalker.Model("W").replace({"contact.rolling_friction_mm": 0.0})
    with pytest.raises(ValueError, match="which is 0"):
        FlixWalkerVectorEnv(2, model=zero, randomize={"contact.rolling_friction_mm": (0.5, 1.5)})


@pytest.mark.parametrize("render_mode", [None, "html"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_an_environment_goes_on_with_the_same_bits(
    copied: Callable[[FlixWalkerVectorEnv], FlixWalkerVectorEnv], render_mode: str | None
) -> None:
    drawn = {"legs.fl.friction": (0.5, 1.5)}
    envs = FlixWalkerVectorEnv(3, "home", randomize=drawn, render_mode=render_mode, **SHORT)
    copied(envs)
    envs.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (25, 3, 2))
    for action in actions[:4]:
        envs.step(action)
    other, state = copied(envs), envs.get_state()

    def went(envs: FlixWalkerVectorEnv) -> np.ndarray:
        # Beyond the end of an episode: the next one is drawn alike, too.
        return np.array([np.column_stack(envs.step(action)[:4]) for action in actions[4:]])

    first = went(envs)
    assert (went(other) == first).all()
    envs.set_state(state)
    assert (went(envs) == first).all()


def test_the_state_of_a_single_environment_is_gone_back_to() -> None:
    env = gymnasium.make("FlixWalker-v0", task="path", **SHORT).unwrapped
    env.reset(seed=3)
    action = np.array([0.9, 0.2])
    env.step(action)
    state = env.get_state()
    first, begun = env.step(action), env.reset()[0]
    env.set_state(state)
    again = env.step(action)
    assert (again[0] == first[0]).all() and again[1:] == first[1:]
    assert (env.reset()[0] == begun).all() and (copy.deepcopy(env).step(action)[0] == env.step(action)[0]).all()


@pytest.mark.parametrize("actions", ["pair", "modes"])
def test_the_checker_has_nothing_to_say_of_paths(actions: str) -> None:
    env = gymnasium.make("FlixWalker-v1", actions=actions, **SHORT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*render.*")
        check_env(env.unwrapped)


@pytest.mark.parametrize("task", [None, *TASKS])
def test_the_newest_version_has_every_task_and_nothing_to_warn_of(task: str | None) -> None:
    chosen = {} if task is None else {"task": task}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("FlixWalker-v1", **chosen, **SHORT).unwrapped
        envs = gymnasium.make_vec("FlixWalker-v1", num_envs=2, **chosen, **SHORT).unwrapped
    assert envs.task == env.many.task == (task or "path")
    assert isinstance(envs, FlixWalkerPathVectorEnv) == (envs.task == "path")
    assert type(env.many) is type(envs)


def test_on_a_path_what_is_seen_and_earned_has_bounds_and_who_leaves_it_ends() -> None:
    envs = FlixWalkerPathVectorEnv(8, interval=0.25, step=2.5e-4)
    seen, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(seen)
    # Straight on, whatever the path does.
    walk, ended = np.tile([0.9, 0.3], (8, 1)).astype(np.float32), np.zeros(8, dtype=bool)
    for _ in range(40):
        seen, reward, terminated, _, _ = envs.step(walk)
        assert envs.observation_space.contains(seen) and (np.abs(reward) <= 2.0).all()
        off = np.abs(seen[:, 3])
        assert (reward[terminated] == -2.0).all() and (reward[~terminated] >= -2.0).all()
        assert (off[terminated] > 0.1).all() and (off[~terminated] <= 0.1).all()
        ended |= terminated
    assert ended.sum() >= 6


def test_the_path_is_seen_from_the_robot() -> None:
    corner = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]])
    envs = FlixWalkerPathVectorEnv(2, path=corner)
    envs.reset(seed=1)
    # 30 mm to the left of the first side, facing along it, then across.
    envs.batch.reset([1, 2], positions=[[0.2, 0.03]] * 2, headings=[0.0, np.pi / 2])
    envs.place[:] = 80
    envs._follow()
    along, across = envs._observe()
    assert along[3:6] == pytest.approx([0.03, 1.0, 0.0], abs=0.01)
    assert along[6:14] == pytest.approx([0.025, -0.03, 0.05, -0.03, 0.1, -0.03, 0.15, -0.03], abs=0.004)
    assert across[4:8] == pytest.approx([0.0, -1.0, -0.03, -0.025], abs=0.01)
    with pytest.raises(ValueError, match="choose tasks by FlixWalker-v1"):
        FlixWalkerPathVectorEnv(2, task="home")
    with pytest.raises(ValueError, match="m long"):
        FlixWalkerPathVectorEnv(2, path=1e-3 * corner)


def test_rotors_that_are_spun_up_and_braked_are_no_source_of_reward() -> None:
    envs = FlixWalkerVectorEnv(3, "transport", threads=1)
    envs.reset(seed=1)
    total = np.zeros(3)
    for actions in [np.array([[1.0, 0.0], [-1.0, 0.3], [0.0, 0.0]]), *[np.zeros((3, 2))] * 4]:
        total += envs.step(actions)[1]
    assert (total < 1e-3).all() and (envs.batch.energy >= -1e-3).all()


@pytest.mark.parametrize("corners", [3, 4, 5, 7, 8, 64])
def test_a_lap_counts_forwards_however_few_points_the_path_has(corners: int) -> None:
    around = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    path = 0.2 * np.stack([np.cos(around), np.sin(around)], axis=1)
    envs = FlixWalkerVectorEnv(1, "path", path=path, threads=1, interval=0.05)
    envs.reset(seed=1)
    way = 0.0
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        envs.batch.reset([1], positions=[[0.2 * np.cos(angle), 0.2 * np.sin(angle)]])
        way += envs._follow()[0]
    assert way == pytest.approx(len(envs.places) * envs.spacing, abs=0.01)


@pytest.mark.parametrize("path", [[[0.4, 0], [0.2, 0], [0, 0], [0.2, 0]], [[0, 0], [0.2, 0], [0.4, 0]]])
def test_a_path_that_turns_back_has_a_direction_everywhere(path: list[list[float]]) -> None:
    envs = FlixWalkerPathVectorEnv(2, path=path, threads=1)
    assert np.allclose(np.abs(envs.tangent), [1.0, 0.0])
    envs.reset(seed=1)
    envs.batch.reset([1, 2], positions=envs.start + [[0, 0.02], [0, 0.3]])
    _, reward, terminated, *_ = envs.step(np.zeros((2, 2)))
    assert np.isfinite(reward).all() and terminated.tolist() == [False, True]


def follow(envs: FlixWalkerVectorEnv, places: np.ndarray) -> float:
    """Carry all robots from place to place, and return the least way along the path that is counted."""
    way = np.zeros(envs.num_envs)
    for place in places:
        envs.batch.reset(range(envs.num_envs), positions=[place] * envs.num_envs)
        way += envs._follow()
    return float(way.min())


@pytest.mark.parametrize(
    ("version", "path"),
    [
        (FlixWalkerPathVectorEnv, [[0.4, 0], [0.2, 0], [0, 0], [0.2, 0]]),
        (FlixWalkerVectorEnv, [[0.4, 0], [0.2, 0], [0, 0], [0.2, 0]]),
        (FlixWalkerPathVectorEnv, [[0, 0], [0.2, 0], [0.4, 0]]),
    ],
)
def test_a_path_that_turns_back_is_followed_to_its_tip_and_back(
    version: type[FlixWalkerVectorEnv], path: list[list[float]]
) -> None:
    envs = version(40, path=path, threads=1)
    envs.reset(seed=1)
    start, tip = envs.start[0], 0.4 - envs.start[0]
    out = np.column_stack([np.linspace(start, tip, 30), np.zeros(30)])
    assert follow(envs, out[1:]) == pytest.approx(0.4, abs=0.005)
    assert follow(envs, out[::-1]) == pytest.approx(0.4, abs=0.005)


def walked(path: np.ndarray, stride: float, laps: int = 1, seed: int = 0, noise: float = 0.0) -> np.ndarray:
    """Return places along a closed path, a stride apart, for so many laps; backwards if they are negative."""
    closed = np.vstack([path, path[:1]])
    ends = np.append(0.0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    at = np.arange(0.0, abs(laps) * ends[-1] + stride, stride)[1:] * np.sign(laps) % ends[-1]
    places = np.column_stack([np.interp(at, ends, closed[:, axis]) for axis in range(2)])
    return places + np.random.default_rng(seed).normal(0.0, noise, places.shape)


HAIRPIN = np.array([[0, 0], [0.5, 0]])
NARROW = np.array([[0, 0], [1, 0], [1, 0.1]])
SPIRAL = np.array([[0.004 * t * np.cos(t), 0.004 * t * np.sin(t)] for t in np.linspace(0.0, 25.0, 600)])


@pytest.mark.parametrize("version", [FlixWalkerPathVectorEnv, FlixWalkerVectorEnv])
@pytest.mark.parametrize("stride", [0.002, 0.004, 0.01, 0.0173, 0.0251])
@pytest.mark.parametrize(("path", "laps"), [(HAIRPIN, 4), (NARROW, 3), (NARROW, -3), (SPIRAL, 2), (SPIRAL, -2)])
def test_laps_are_counted_at_every_stride(
    version: type[FlixWalkerVectorEnv], path: np.ndarray, laps: int, stride: float
) -> None:
    envs = version(1, path=np.vstack([path, path[:1]]), threads=1)
    envs.reset(seed=1)
    length = len(envs.places) * envs.spacing
    assert follow(envs, walked(path, stride, laps, noise=0.002)) == pytest.approx(laps * length, abs=0.06)


@pytest.mark.parametrize("version", [FlixWalkerPathVectorEnv, FlixWalkerVectorEnv])
def test_lanes_are_crossed_without_pay(version: type[FlixWalkerVectorEnv]) -> None:
    lanes = [[[0, y], [1, y]][:: 1 if i % 2 == 0 else -1] for i, y in enumerate(np.arange(20) * 0.05)]
    envs = version(1, path=np.concatenate(lanes), threads=1)
    envs.reset(seed=1)
    across = np.column_stack([np.full(95, 0.5), np.arange(95) * 0.01])
    assert follow(envs, np.vstack([np.column_stack([np.arange(0, 0.5, 0.01), np.zeros(50)]), across])) < 0.6


def turns(radius: float, angle: np.ndarray) -> np.ndarray:
    """Return points of a circle through the origin."""
    return radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])


@pytest.mark.parametrize("version", [FlixWalkerPathVectorEnv, FlixWalkerVectorEnv])
@pytest.mark.parametrize(("radius", "laps", "interval"), [(0.03, 7, 1.0), (0.045, 5, 1.0), (0.01, 6, 0.25), (0.0115, 6, 0.25)])
def test_a_path_of_many_turns_at_one_place_is_no_treadmill(
    version: type[FlixWalkerVectorEnv], radius: float, laps: int, interval: float
) -> None:
    path = turns(radius, np.linspace(0, 2 * np.pi * laps, 60 * laps, endpoint=False))
    envs = version(1, path=path, interval=interval, threads=1)
    for stride in (0.003, 0.01):
        envs.reset(seed=1)
        assert follow(envs, turns(radius, -np.arange(0.0, 1.0, stride)[1:] / radius)) == pytest.approx(-1.0, abs=0.03)
    envs.reset(seed=1)
    assert abs(follow(envs, turns(radius, np.tile([0, 4, 8, 12, 8, 4], 50) * 1e-3 / radius))) < 0.02
    envs.reset(seed=1)
    assert abs(follow(envs, np.random.default_rng(1).normal(0.0, 0.002, (300, 2)))) < 0.02


@pytest.mark.parametrize(("lane", "gap", "interval"), [(0.14, 0.02, 0.25), (0.06, 0.01, 0.25), (0.3, 0.02, 1.0)])
@pytest.mark.parametrize("stride", [0.002, 0.005, 0.02])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.6, 0.8])
def test_who_cuts_across_short_lanes_is_paid_for_little_more_than_he_walks(
    lane: float, gap: float, interval: float, stride: float, share: float
) -> None:
    lanes = [[[0, gap * i], [lane, gap * i]][:: 1 if i % 2 == 0 else -1] for i in range(40)]
    envs = FlixWalkerVectorEnv(1, path=np.concatenate(lanes), interval=interval, threads=1)
    envs.reset(seed=1)
    out = np.arange(0.0, share * lane, 0.004)
    follow(envs, np.column_stack([out, np.zeros_like(out)]))
    across = np.arange(0.0, 39 * gap, stride)
    assert follow(envs, np.column_stack([np.full_like(across, share * lane), across])) < 1.5 * 39 * gap + 0.05


@pytest.mark.parametrize("version", [FlixWalkerPathVectorEnv, FlixWalkerVectorEnv])
@pytest.mark.parametrize("path", [flixwalker.env.figure_eight(), NARROW, SPIRAL])
def test_the_first_point_of_a_path_is_where_it_begins_and_nothing_else(
    version: type[FlixWalkerVectorEnv], path: np.ndarray
) -> None:
    def rewards(first: int) -> list[float]:
        envs = version(1, path=np.roll(path, -first, axis=0), threads=1)
        envs.reset(seed=1)
        assert np.hypot(*(envs.batch.position[0, :2] - path[first])) < 2e-3
        assert np.hypot(*(envs.places[envs.place[0]] - path[first])) < 2e-3
        envs.place[:] = 100
        follow(envs, envs.places[100:101])
        earned = []
        for place in envs.places[100:200:7] + 3e-3:
            envs.batch.reset([1], positions=[place])
            earned.append(float(envs._reward(np.zeros(1))[0]))
            earned += envs._observe()[0, :9].tolist()
        return earned

    assert rewards(0) == rewards(1) == rewards(len(path) - 1)


def test_generators_that_are_set_for_many_draw_their_starts() -> None:
    starts = []
    for _ in range(2):
        envs = FlixWalkerVectorEnv(2, "home", **SHORT)
        envs.np_random = np.random.default_rng(5)
        starts.append(envs.reset()[0])
    assert (starts[0] == starts[1]).all()


def test_who_turns_back_before_the_tip_has_walked_back() -> None:
    envs = FlixWalkerPathVectorEnv(40, path=[[0, 0], [0.2, 0], [0.4, 0]], threads=1)
    envs.reset(seed=1)
    out = np.column_stack([np.linspace(0.0, 0.35, 30), np.zeros(30)])
    assert follow(envs, out[1:]) == pytest.approx(0.35, abs=0.005)
    assert follow(envs, out[::-1]) == pytest.approx(-0.35, abs=0.005)


@pytest.mark.parametrize("points", [5, 9])
def test_a_path_that_ends_where_it_begins_is_closed_once(points: int) -> None:
    corners = np.array([[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4], [0, 0]])
    at = np.linspace(0, 4, points)
    path = np.column_stack([np.interp(at, range(5), corners[:, axis]) for axis in range(2)])
    envs = FlixWalkerVectorEnv(1, path=path, threads=1)
    envs.reset(seed=1)
    assert abs(envs.step(np.zeros((1, 2)))[1][0]) < 1e-3
    assert follow(envs, walked(path, 0.02)) == pytest.approx(1.6, abs=0.01)


def test_the_way_along_a_path_is_that_between_its_points() -> None:
    envs = FlixWalkerVectorEnv(1, path=[[0, 0], [0.01, 0], [1, 0]], interval=0.05, threads=1)
    envs.reset(seed=1)
    assert follow(envs, np.array([[0.009, 0.0]])) == pytest.approx(0.009, abs=0.002)


def test_a_path_is_long_enough_for_the_interval_or_refused() -> None:
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / (2 * np.pi)
    for version in (FlixWalkerPathVectorEnv, FlixWalkerVectorEnv):
        with pytest.raises(ValueError, match="or another interval"):
            version(1, path=circle, interval=1.0)
    envs = FlixWalkerPathVectorEnv(1, path=circle, interval=0.8, threads=1)
    envs.reset(seed=1)
    # Three laps, backwards, as fast as a robot may be.
    laps = np.linspace(0, -3 * 2 * np.pi, 15)
    places = np.column_stack([np.cos(laps), np.sin(laps)]) / (2 * np.pi)
    assert follow(envs, places[1:]) == pytest.approx(-3.0, abs=0.02)


@pytest.mark.parametrize("interval", [0.01, 0.05, 0.25])
@pytest.mark.parametrize("action", [[0.14, 0.0], [0.3, 0.0], [0.7, 0.22]])
def test_who_trembles_and_goes_nowhere_earns_nothing(interval: float, action: list[float]) -> None:
    envs = FlixWalkerVectorEnv(4, "speed", interval=interval, threads=1)
    envs.reset(seed=1)
    # Back and forth, faster than rotors follow.
    paid = sum(envs.step(np.tile(action, (4, 1)) * [(-1.0) ** step, 1.0])[1] for step in range(round(3.0 / interval)))
    gone = np.hypot(*(envs.batch.position[:, :2]).T)
    assert (paid <= 2.0 * gone + 0.02).all(), (paid, gone)


def test_a_change_of_the_drive_takes_from_the_first_action_on_as_long_as_in_the_robot() -> None:
    envs = FlixWalkerVectorEnv(1, "speed", interval=0.02, threads=1)
    envs.reset(seed=1)
    for step in range(50):
        envs.step(np.array([[(-1.0) ** step, 0.22]]))
    # f never leaves the neighbourhood of 0.
    assert np.abs(envs.batch.position).max() < 0.1 and envs.batch.energy[0] < 0.3


def test_braking_pays_nothing_and_walking_pays() -> None:
    forward, still = np.tile([-30 / 35, 1 / 3], (8, 1)), np.zeros((8, 2))
    ways, paid = [], []
    for task, rewards in (("speed", ways), ("transport", paid)):
        envs = FlixWalkerVectorEnv(8, task, threads=1)
        envs.reset(seed=1)
        rewards.extend(envs.step(action)[1] for action in [*[forward] * 20, still, still])
    assert (np.array(paid) <= ways).all() and np.mean(paid[4:20]) > 0.0


def test_a_state_is_of_an_environment_that_was_made_alike_or_nothing_changes() -> None:
    slippery = flixwalker.Model("W").replace({"legs.fl.friction": 0.3})
    one = FlixWalkerVectorEnv(1, "speed")
    others = [FlixWalkerVectorEnv(1, "speed", **more) for more in (
        {"model": slippery}, {"interval": 0.5}, {"seconds": 3.0}, {"actions": "modes"},
        {"randomize": {"legs.fl.friction": (0.5, 1.5)}}, {"autoreset_mode": AutoresetMode.SAME_STEP},
    )]
    one.reset(seed=1)
    before = one.get_state()
    for other in others:
        other.reset(seed=1)
        with pytest.raises(ValueError, match="made otherwise"):
            one.set_state(other.get_state())
    for wrong in ({}, {"made": 1}, before | {"seeds": 1}, None):
        with pytest.raises(ValueError, match="no state of such"):
            one.set_state(wrong)
    home, speed = (gymnasium.make("FlixWalker-v1", task=task).unwrapped for task in ("home", "speed"))
    home.reset(seed=1), speed.reset(seed=2)
    random = home.np_random
    for wrong in (speed.get_state(), {}, before):
        with pytest.raises(ValueError, match="state|made"):
            home.set_state(wrong)
    assert home.np_random is random


def test_a_reset_that_is_refused_has_not_happened() -> None:
    envs = FlixWalkerVectorEnv(2, **SHORT)
    with pytest.raises(ValueError, match="3 seeds"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((2, 2)))


def test_what_is_taken_for_numbers_elsewhere_is_refused() -> None:
    env = gymnasium.make("FlixWalker-v1", **SHORT).unwrapped
    env.reset(seed=1)
    half = np.ma.array([0.9, 0.5], mask=[1, 0])
    for action in ([True, 0.5], bytearray(b"\1\0"), half, [np.array(True), 0.5]):
        with pytest.raises(ValueError, match="holds"):
            env.step(action)
    envs = FlixWalkerVectorEnv(2, **SHORT)
    envs.reset(seed=1)
    with pytest.raises(ValueError, match="masked"):
        envs.step([half, half])
    for wrong in (0, -1, True, 1.5):
        with pytest.raises(ValueError, match="num_envs"):
            FlixWalkerVectorEnv(wrong)
    with pytest.raises(ValueError, match="step is"):
        FlixWalkerVectorEnv(1, interval=0.05, step=0.05)
    for bounds in ((1, 2, 3), "low", (True, 2)):
        with pytest.raises(ValueError, match="randomize"):
            FlixWalkerVectorEnv(1, randomize={"legs.fl.friction": bounds})
    with pytest.raises(ValueError, match="no number"):
        FlixWalkerVectorEnv(1, randomize={"legs.fl": (0.5, 1.5)})


def test_a_path_is_the_environments_own() -> None:
    path = flixwalker.env.figure_eight()
    envs = FlixWalkerVectorEnv(1, path=path)
    path[:] = 0.0
    assert envs.path.any()


def test_the_state_before_the_first_reset_and_the_order_of_draws_are_kept() -> None:
    new, walked = (FlixWalkerVectorEnv(1, "speed") for _ in range(2))
    walked.reset(seed=1)
    walked.set_state(new.get_state())
    with pytest.raises(gymnasium.error.ResetNeeded):
        walked.step(np.zeros((1, 2)))
    ranges = {"legs.fl.friction": (0.5, 1.5), "body.total_mass_g": (0.8, 1.2)}
    one, other = (FlixWalkerVectorEnv(1, randomize=dict(order)) for order in (ranges.items(), reversed(ranges.items())))
    one.reset(seed=1)
    with pytest.raises(ValueError, match="made otherwise"):
        other.set_state(one.get_state())


def test_seeds_are_a_number_or_one_a_robot() -> None:
    envs = FlixWalkerVectorEnv(2, "home")
    one = envs.reset(seed=[10, 50])[0]
    assert (envs.reset(seed=(seed for seed in (10, 50)))[0] == one).all()
    for wrong in ([[1, 5], [2, 6]], [[], []], bytearray(b"12"), {1, 2}, {1: 2, 3: 4}, "12", iter([])):
        with pytest.raises(ValueError, match="seed"):
            envs.reset(seed=wrong)
    with pytest.raises(ValueError, match="seed is True"):
        gymnasium.make("FlixWalker-v1").reset(seed=True)


def test_a_generator_that_is_set_draws_the_next_start() -> None:
    env = gymnasium.make("FlixWalker-v1", task="home", **SHORT).unwrapped
    starts = []
    for _ in range(2):
        env.np_random = np.random.default_rng(3)
        starts.append(env.reset()[0])
    assert (starts[0] == starts[1]).all() and not (env.reset()[0] == starts[0]).all()
    copied = gymnasium.make("FlixWalker-v1", task="home", **SHORT).unwrapped
    env.np_random = np.random.default_rng(4)
    copied.set_state(env.get_state())
    assert (env.reset()[0] == copied.reset()[0]).all()


def test_an_episode_of_short_intervals_becomes_a_page() -> None:
    env = gymnasium.make("FlixWalker-v1", interval=5e-4, render_mode="html")
    env.reset(seed=1)
    env.step(np.zeros(2, dtype=np.float32))
    assert "FlixWalker" in env.render()


def test_the_seed_is_the_one_that_was_given() -> None:
    envs = gymnasium.make_vec("FlixWalker-v1", num_envs=2, **SHORT)
    envs.reset(seed=5)
    assert envs.unwrapped.np_random_seed == 5 and envs.unwrapped.np_random is envs.unwrapped.random[0]


def test_what_would_mean_two_things_is_refused() -> None:
    with pytest.raises(ValueError, match="more than once"):
        FlixWalkerVectorEnv(1, randomize={"legs.fl.friction": (0.5, 0.5), ("legs.fl.friction",): (1.0, 1.0)})
    with pytest.raises(TypeError, match="reset"):
        gymnasium.make("FlixWalker-v1", autoreset_mode=AutoresetMode.SAME_STEP)
    speed, home = (FlixWalkerVectorEnv(1, task) for task in ("speed", "home"))
    speed.reset(seed=1)
    with pytest.raises(ValueError, match="made otherwise"):
        home.set_state(speed.get_state())


def test_a_restored_environment_says_the_seed_of_the_state() -> None:
    before = FlixWalkerEnv(task="home", **SHORT)
    before.reset(seed=5)
    state, then = before.get_state(), before.reset()[0]
    after = FlixWalkerEnv(task="home", **SHORT)
    after.reset(seed=8)
    after.set_state(state)
    assert after.np_random_seed == 5
    assert (after.reset()[0] == then).all()


def test_who_is_given_no_seed_goes_on_with_its_own() -> None:
    starts = []
    for seeds in ([None, None], None):
        envs = FlixWalkerVectorEnv(2, "home", **SHORT)
        envs.reset(seed=1)
        starts.append(envs.reset(seed=seeds)[0])
    assert (starts[0] == starts[1]).all()


def test_a_reset_that_is_refused_has_not_happened_to_one_robot_either() -> None:
    env = FlixWalkerEnv(task="home", **SHORT)
    env.reset(seed=1)
    state = env.get_state()
    env.many.batch.position.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        env.reset(seed=99)
    env.many.batch.position.flags.writeable = True
    assert env.np_random_seed == 1
    start = env.reset()[0]
    env.set_state(state)
    assert (env.reset()[0] == start).all()


@pytest.mark.parametrize(
    "change",
    [{"place": np.zeros(5)}, {"anchor": None}, {"steps": "x"}, {"random": []}, {"random": None}, {"seeds": None}],
)
def test_a_state_that_was_changed_is_refused_and_changes_nothing(change: dict[str, object]) -> None:
    env = FlixWalkerEnv(task="home", **SHORT)
    env.reset(seed=1)
    state = env.get_state()
    with pytest.raises(ValueError, match="state"):
        env.set_state(state | change)
    start = env.reset()[0]
    env.set_state(state)
    assert (env.reset()[0] == start).all()


def test_one_seed_is_one_start_however_the_environment_is_made() -> None:
    for version in ("v0", "v1"):
        name = f"FlixWalker-{version}"
        many = gymnasium.make_vec(name, num_envs=3, task="home", **SHORT).reset(seed=7)[0]
        sync = gymnasium.make_vec(name, num_envs=3, vectorization_mode="sync", task="home", **SHORT).reset(seed=7)[0]
        one = [gymnasium.make(name, task="home", **SHORT).reset(seed=7 + robot)[0] for robot in range(3)]
        assert (many == sync).all() and (many == one).all()


def test_an_episode_has_240_actions_and_more_where_both_lengths_are_given() -> None:
    assert gymnasium.spec("FlixWalker-v1").max_episode_steps == 240
    for given, steps in (
        ({}, 240),
        ({"seconds": 0.5}, 2),
        ({"seconds": 100.0, "max_episode_steps": 400}, 400),
    ):
        assert gymnasium.make_vec("FlixWalker-v1", num_envs=1, **given).unwrapped.limit == steps, given
    assert FlixWalkerVectorEnv(1, seconds=120.0).limit == 480
    with pytest.warns(UserWarning, match="240 actions, 60 s, and not after 120 s"):
        assert gymnasium.make_vec("FlixWalker-v1", num_envs=1, seconds=120.0).unwrapped.limit == 240


@pytest.mark.parametrize("task", TASKS)
def test_pictures_show_the_robot_and_where_it_is_to_go(task: str) -> None:
    env = gymnasium.wrappers.RenderCollection(gymnasium.make("FlixWalker-v0", task=task, render_mode="rgb_array", **SHORT))
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.array([0.9, 0.3], dtype=np.float32))
    pictures = env.render()
    assert env.metadata["render_fps"] == 20
    for picture in pictures:
        assert (picture.shape, picture.dtype) == ((480, 480, 3), np.uint8)
        colours = {tuple(colour) for colour in np.unique(picture.reshape(-1, 3), axis=0)}
        assert {(110, 110, 110), (213, 94, 0)} <= colours and ((0, 114, 178) in colours) == (task in ("path", "home"))
    assert (pictures[0] != pictures[-1]).any()
    with pytest.raises(ValueError, match="choose one of html, rgb_array"):
        FlixWalkerVectorEnv(1, render_mode="human")
    assert len(FlixWalkerVectorEnv(2, render_mode="rgb_array").render()) == 2
