"""Scripted team policies, which map beliefs to actions. They use the public interface of twc_env only."""

import twc_env  # noqa: F401  first: handles Ctrl-C during the other imports

from .policy import Policy, begin, make_policy, policy_names

__all__ = ["Policy", "begin", "make_policy", "policy_names"]
