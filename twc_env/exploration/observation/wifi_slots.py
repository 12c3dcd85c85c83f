"""The strongest transmitters that each robot receives, in a fixed number of slots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel

RSSI_ZERO_DBM, RSSI_SPAN_DB = -100.0, 80.0


def slots_for(robots: int, count: int) -> tuple[Array, Array, Array]:
    """State of `take_scans`: `count` slots per robot. A transmitter keeps its slot until a stronger one needs it.

    Returns (robots, 2, slots) transmitter of each slot (-1: none) and when it was last among the strongest; its level
    (robots, slots) in the latest scan, 0 at -100 dBm or not heard, 1 at -20 dBm; scratch (2, slots).
    """
    kept = np.zeros((robots, 2, count), np.int64)
    kept[:, 0] = -1
    return kept, np.zeros((robots, count), np.float32), np.empty((2, count), np.int64)


@borrowing_kernel
def take_scans(now, robots, macs, rssi_dbm, counts, kept, levels, room):
    """Process the scans of one step, given as the fields of `WifiScans`; now: a number > 0 that increases per step."""
    for k in range(robots.shape[0]):
        count, own = min(counts[k], macs.shape[1]), kept[robots[k]]
        _place(now, macs[k, :count], rssi_dbm[k, :count], own[0], own[1], levels[robots[k]], room[0], room[1])


@borrowing_kernel
def _place(now, macs, rssi_dbm, slot_macs, last_scan, levels, strongest, at_slot):
    """Assign slots to the strongest transmitters of one scan; they replace those longest not among the strongest.

    strongest, at_slot (slots,): scratch; indices into the scan of the strongest, and of each slot's transmitter or -1.
    """
    slots, heard, count, held = slot_macs.shape[0], rssi_dbm.shape[0], 0, 0
    for k in range(heard):  # insertion sort, descending and stable
        level = rssi_dbm[k]
        if count == slots and rssi_dbm[strongest[slots - 1]] >= level:
            continue
        count = min(count + 1, slots)
        at = count - 1
        while at > 0 and rssi_dbm[strongest[at - 1]] < level:
            strongest[at] = strongest[at - 1]
            at -= 1
        strongest[at] = k
    at_slot[:] = -1
    for k in range(heard):
        mac = macs[k]
        for slot in range(np.uint64(slots)):  # vectorised, unlike a search for each slot
            at_slot[slot] += (k + 1) * int(slot_macs[slot] == mac)
    for slot in range(slots):
        k = at_slot[slot]
        if k >= 0:
            last = strongest[count - 1]
            if rssi_dbm[k] > rssi_dbm[last] or (rssi_dbm[k] == rssi_dbm[last] and k <= last):
                last_scan[slot] = now
                held += 1
    for i in range(count if held < count else 0):
        is_waiting, oldest = True, 0
        for slot in range(slots):
            is_waiting &= at_slot[slot] != strongest[i]
            if last_scan[slot] < last_scan[oldest]:
                oldest = slot
        if is_waiting:
            slot_macs[oldest], last_scan[oldest], at_slot[oldest] = macs[strongest[i]], now, strongest[i]
    for slot in range(slots):
        level = 0.0 if at_slot[slot] < 0 else (rssi_dbm[at_slot[slot]] - RSSI_ZERO_DBM) / RSSI_SPAN_DB
        levels[slot] = min(max(level, 0.0), 1.0)
