"""Settings that all tests share."""

import os

from hypothesis import settings

# The first call of a kernel compiles it, which no deadline should judge; CI draws the same examples in every run.
settings.register_profile("twc_env", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("twc_env")
