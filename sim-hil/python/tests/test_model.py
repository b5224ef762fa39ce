"""Models: read, changed, refused."""

import pickle

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
