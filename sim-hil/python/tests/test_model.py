"""Models: read, changed, refused."""

import pathlib
import pickle
import tempfile
import warnings

import numpy as np
import pytest

import flixwalker
from flixwalker import Model


def test_a_field_is_read_and_replaced_by_its_path() -> None:
    model = Model("W")
    changed = model.replace({"legs.fl.friction": 0.3, "body.total_mass_g": 400.0})
    assert changed["legs.fl.friction"] == 0.3
    assert changed["legs.fr.friction"] == model["legs.fr.friction"]
    assert model["body.total_mass_g"] == 350.0


def test_a_model_survives_toml_and_pickle() -> None:
    model = Model.random(5)
    assert Model.from_toml(model.to_toml()) == model
    assert pickle.loads(pickle.dumps(model)) == model


def test_what_is_refused_says_which_key_and_what_it_may_be() -> None:
    with pytest.raises(ValueError, match="legs.fl.friction = -1 is outside"):
        Model("W").replace({"legs.fl.friction": -1.0})
    with pytest.raises(KeyError, match="no field legs.fl.colour"):
        Model("W").replace({"legs.fl.colour": 1.0})
    with pytest.raises(ValueError, match="cannot read the model nobody"):
        Model("nobody")


def test_every_shipped_model_loads() -> None:
    assert "W" in flixwalker.models()
    assert all(Model(name).name for name in flixwalker.models())


def test_numbers_of_numpy_are_numbers() -> None:
    changed = Model("W").replace(
        {"legs.fl.friction": np.float32(0.25), "core.size_mm": np.array([50, 51, 52])}
    )
    assert changed["legs.fl.friction"] == 0.25 and changed["core.size_mm"] == [50.0, 51.0, 52.0]


def test_robots_that_are_built_again_and_strangers_differ_and_can_walk() -> None:
    model = Model("W")
    again, stranger = model.scattered(0.02, 7), model.stranger(7)
    assert again != model and stranger != model
    assert stranger == Model("stranger-7")
    flixwalker.Batch([again, stranger])


@pytest.mark.parametrize("step", [0.0, -1.0, float("nan")])
def test_a_step_or_interval_that_is_none_is_refused(step: float) -> None:
    with pytest.raises(ValueError, match="step is"):
        Model("W").mjcf(step)
    with pytest.raises(ValueError, match="interval is"):
        flixwalker.Film(Model("W"), step)


def test_a_model_is_found_by_a_path_and_is_a_key() -> None:
    model = Model("W")
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "own.toml"
        path.write_text(model.to_toml())
        assert {Model(path): 1}[model] == 1
    other = model.replace({"contact.rolling_friction_mm": 0.123})
    assert other != model and len({model, other, Model("W")}) == 2


def test_numbers_survive_to_the_last_bit() -> None:
    for number in np.random.default_rng(1).uniform(0.01, 1.0, 300):
        replaced = Model("W").replace({"contact.rolling_friction_mm": float(number)})
        assert replaced["contact.rolling_friction_mm"] == number


def test_a_step_that_changes_the_floor_in_mujoco_is_said() -> None:
    with pytest.warns(UserWarning, match="it will be another floor"):
        Model("W").mjcf(2e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Model("W").mjcf(1e-4)


def test_a_beam_of_another_size_is_as_stiff_as_before_and_that_is_said() -> None:
    with pytest.warns(UserWarning, match="not the stiffness"):
        assert Model("W").replace({"legs.thickness_mm": 2.0})["legs.bend_stiffness_n_m_rad"] > 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Model("W").replace({"legs.thickness_mm": 2.0, "legs.bend_stiffness_n_m_rad": 0.3})
        Model("W").replace({"plate.length_mm": 200.0})


def test_a_value_of_another_kind_is_refused_with_its_field() -> None:
    for value in ("300", True, None, [0.5], {}):
        with pytest.raises(ValueError, match="body.total_mass_g is"):
            Model("W").replace({"legs.fl.friction": 0.5, "body.total_mass_g": value})
    assert "legs.fl.friction" in Model("W") and "legs.colour" not in Model("W")


def test_a_name_of_any_characters_is_exported() -> None:
    import xml.etree.ElementTree

    model = Model("W").replace({"name": 'a\0b\x07"<&>'})
    assert xml.etree.ElementTree.fromstring(model.mjcf(1e-4)).get("model") == 'ab"<&>'
