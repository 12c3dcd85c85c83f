"""Many environments at once: worker processes, and adapters to learning libraries."""
