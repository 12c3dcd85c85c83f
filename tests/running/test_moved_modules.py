import importlib

import pytest

from twc_env.running.moved_modules import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_an_import_of_a_moved_module_names_the_new_one_which_exists(old):
    with pytest.raises(ModuleNotFoundError, match=f"^twc_env.{old} is now twc_env.{MOVED[old]}$"):
        importlib.import_module(f"twc_env.{old}")
    assert importlib.util.find_spec(f"twc_env.{MOVED[old]}") is not None
