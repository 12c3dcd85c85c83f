"""Scripted team policies: beliefs in, actions out. They use the public interface of twc_env only."""

import twc_env  # noqa: F401  first: from then on Ctrl-C is answered with one line
from agents.policy import Policy, make_policy, policy_names

__all__ = ["Policy", "make_policy", "policy_names"]
