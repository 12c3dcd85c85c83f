"""Real data, for tests that are skipped where the environment variable TWC_DATA does not name its folder."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("TWC_DATA", "no real data"))
needs_data = pytest.mark.skipif("TWC_DATA" not in os.environ, reason="real data: set TWC_DATA to its folder")
