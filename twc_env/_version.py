"""The version of twc_env; pyproject.toml reads it from here."""

__version__ = "0.1.0"
