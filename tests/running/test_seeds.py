import pytest

from twc_env.errors import ConfigError
from twc_env.running.options import parse_seeds


@pytest.mark.parametrize("text", ["1" * 5000, f"0-{'1' * 5000}", f"{'1' * 5000}-3"])
def test_a_seed_of_thousands_of_digits_is_refused_in_one_line(text):
    with pytest.raises(ConfigError, match=r"^a seed has at most 20 digits; got one of 5000$"):
        parse_seeds(text)
