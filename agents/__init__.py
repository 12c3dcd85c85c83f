"""Scripted team policies: beliefs in, actions out. They use the public interface of twc_env only."""

from agents.policy import Policy, make_policy, policy_names

__all__ = ["Policy", "make_policy", "policy_names"]
