"""The sub-commands of `twc-env`, one per file."""
