"""The strongest transmitters that each robot hears, in a fixed number of slots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import kernel
from twc_env.messages import WifiScan

Array = NDArray

RSSI_ZERO_DBM, RSSI_SPAN_DB = -100.0, 80.0


class WifiSlots:
    """Each transmitter keeps its slot until a stronger one needs it; every robot has slots of its own."""

    def __init__(self, robots: int, count: int):
        self.levels = np.zeros((robots, count), np.float32)
        """(robots, slots) of each one's latest scan: 0 at -100 dBm or not heard, 1 at -20 dBm."""
        self._macs = np.full((robots, count), -1, np.int64)
        self._last_scan = np.zeros((robots, count), np.int64)
        """The scan in which each slot's transmitter was last among the strongest."""
        self._scans = [0] * robots

    def update(self, robot: int, scan: WifiScan) -> None:
        """Take in a scan of one robot."""
        self._scans[robot] += 1
        _place(scan.macs, scan.rssi_dbm, self._scans[robot], robot, self._macs, self._last_scan, self.levels)


@kernel
def _place(macs, rssi_dbm, scan, robot, slot_macs_of, last_scan_of, levels_of):
    """The strongest transmitters take, or keep, the slots. Those longest out of the strongest give way."""
    slot_macs, last_scan, levels = slot_macs_of[robot], last_scan_of[robot], levels_of[robot]
    slots, heard = slot_macs.shape[0], rssi_dbm.shape[0]
    strongest = np.empty(slots, np.int64)
    count = 0
    for k in range(heard):  # inserted in falling order; of equals, the first stays ahead
        at = count
        while at > 0 and rssi_dbm[strongest[at - 1]] < rssi_dbm[k]:
            at -= 1
        if at < slots:
            count = min(count + 1, slots)
            for i in range(count - 1, at, -1):
                strongest[i] = strongest[i - 1]
            strongest[at] = k
    is_new = np.ones(slots, np.bool_)
    for k in range(count):
        for slot in range(slots):
            if slot_macs[slot] == macs[strongest[k]]:
                is_new[k] = False
                last_scan[slot] = scan
    for k in range(count):
        if is_new[k]:
            oldest = 0
            for slot in range(1, slots):
                if last_scan[slot] < last_scan[oldest]:
                    oldest = slot
            slot_macs[oldest], last_scan[oldest] = macs[strongest[k]], scan
    for slot in range(slots):
        levels[slot] = 0.0
        for k in range(heard):
            if macs[k] == slot_macs[slot]:
                levels[slot] = min(max((rssi_dbm[k] - RSSI_ZERO_DBM) / RSSI_SPAN_DB, 0.0), 1.0)
                break
