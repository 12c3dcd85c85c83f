import importlib

import numpy as np
import pytest

from twc_env.records.messages import Belief, GridMap
from twc_env.running.moved_modules import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_either_import_of_a_moved_module_names_the_new_one_which_exists(old):
    with pytest.raises(ModuleNotFoundError, match=f"^twc_env.{old} is now twc_env.{MOVED[old]}$"):
        importlib.import_module(f"twc_env.{old}")
    package, _, name = f"twc_env.{old}".rpartition(".")
    with pytest.raises(ModuleNotFoundError, match=f"^twc_env.{old} is now twc_env.{MOVED[old]}$"):
        exec(f"from {package} import {name}")
    assert importlib.util.find_spec(f"twc_env.{MOVED[old]}") is not None


def test_a_module_that_never_was_is_an_import_error_as_everywhere():
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from twc_env.slam import nothing")


def test_the_old_name_of_the_teammates_of_a_belief_names_the_new_one():
    belief = Belief(0, 0, np.zeros(3), GridMap(np.zeros((1, 1)), np.zeros(2), 0.1))
    with pytest.raises(AttributeError, match=r"^Belief\.mates is now Belief\.teammates$"):
        belief.mates  # noqa: B018
    assert belief.teammates == {}


@pytest.mark.parametrize(
    ("module", "name", "told"),
    [
        ("planning", "Driver", r"twc_env\.planning\.Driver is now twc_env\.planning\.Drivers"),
        ("planning", "path_is_blocked", r"is now twc_env\.planning\.Follower\.is_blocked"),
        ("datasets.logs.scan_log", "read_carmen_log", r"is now in twc_env\.datasets\.logs\.carmen_log"),
    ],
)
def test_an_old_name_in_a_module_names_the_new_one(module, name, told):
    with pytest.raises(ImportError, match=told):
        exec(f"from twc_env.{module} import {name}")
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec(f"from twc_env.{module} import nothing")
