import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHOWN = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (ROOT / "SECURITY.md").read_text())


def test_every_sentence_about_security_names_a_test_that_exists():
    rows = [
        line for line in (ROOT / "SECURITY.md").read_text().splitlines() if re.match(r"\| (?!-|data|what \|)", line)
    ]
    assert len(rows) == len(SHOWN) > 15
    for path, name in SHOWN:
        assert f"\ndef {name}(" in (ROOT / path).read_text(), f"{path} has no {name}"


def test_every_test_named_on_the_page_of_trust_exists():
    named = set(re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (ROOT / "docs" / "trust.md").read_text()))
    assert len(named) > 10
    for path, name in named:
        assert f"\ndef {name}(" in (ROOT / path).read_text() if name else (ROOT / path).is_file(), (path, name)
