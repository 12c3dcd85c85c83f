"""Memory of this process [MB]."""

import sys
from pathlib import Path


def resident_mb() -> float:
    """Current resident memory on Linux, peak so far on other systems; NaN if the system does not report it."""
    status = Path("/proc/self/statm")
    if not status.exists():
        return peak_mb()
    import resource

    return int(status.read_text().split()[1]) * resource.getpagesize() / 1e6


def peak_mb() -> float:
    """Peak resident memory so far; NaN if the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def proportional_mb(process: int) -> float:
    """Resident memory of a process on Linux, of which what it shares with n - 1 others counts 1/n; else NaN."""
    status = Path(f"/proc/{process}/smaps_rollup")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text().splitlines() if line.startswith("Pss:"))
    return int(line.split()[1]) * 1024 / 1e6
