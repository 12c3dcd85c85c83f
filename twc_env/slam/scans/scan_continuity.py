"""Whether a scan continues the one before: a robot that was lifted and put down elsewhere suddenly sees another place.

Odometry does not notice it. Two scans a tenth of a second apart show the same walls, moved by the odometry between
them, whatever walks about: only a few beams change. After a kidnapping few agree.
"""

from __future__ import annotations

import math

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.messages import UNSEEN_M

CHANGE_M = 0.4
"""Beams whose ranges differ by less, after turning, did not change; while most did not, nothing else is computed."""
CHANGED_SHARE = 0.3
AGREEMENT_M = 0.2
"""Tolerance of a range predicted from the scan before."""
AGREEMENT_MIN = 0.6
"""A scan of which a smaller share is predicted shows another place. Measured in offices and a mall, with up to 40
people, and with 72 beams of 5 m, 3 cm noise and a tenth lost: of 56,000 scans the least share was .91; of 273
kidnappings the greatest were .69, .59 and .52."""
BUMPED_MIN = 0.85
"""A robot was bumped, not carried, if this share is predicted by the motion that matching found instead."""
BUMP_MAX_M = 0.3
"""And if that motion is not longer than odometry says by more than this: nobody pushes a robot at 3 m/s, but many rooms
are alike."""
BEAMS_MIN = 8
"""With fewer returns, scans are not compared."""
MOTION_MAX_M, TURN_MAX_RAD = 0.6, 0.6
"""Nor after greater motions: too much of what is seen is new. Five public logs have 56 pairs of scans 0.6 to 0.8 m
apart, and the least share there is .53, of a robot that nobody carried; nearer ones have .65 or more, but for two where
odometry misread a turn."""
REVEALED_MIN_M, IN_FREE_FLOOR_MIN = 0.3, 0.05
"""After motions longer than this, of a scan that the one before predicts too little of, a smaller share must stand in
floor that the one before saw free: in a doorway, half of a scan was hidden behind its walls. From half a metre before
one to its middle, half a circle had .58 predicted, and nothing in free floor. Of 7,100 pairs of scans of different
places of five public logs, 5 % have less there: robots that are carried so go unnoticed."""
ODOMETRY_STDS = 4.0
"""Odometry may err by so many standard deviations: a robot is carried only if no motion within explains its scan."""
ODOMETRY_STEP_M, ODOMETRY_STEP_RAD = 0.15, 0.04
"""Steps in which these motions are tried: what `AGREEMENT_M` allows for. Within a tenth of a second odometry errs by
less; from scan to scan of a log, by several."""


@borrowing_kernel
def continues(before, scan, motion, range_max, directions):
    """Whether a scan (beams,) may continue the one before, after a motion (3,): True if they cannot be compared."""
    beams = scan.shape[0]
    if motion[0] * motion[0] + motion[1] * motion[1] > MOTION_MAX_M * MOTION_MAX_M or abs(motion[2]) > TURN_MAX_RAD:
        return True
    shift = (int(math.floor(motion[2] * beams / (2.0 * math.pi) + 0.5)) + beams) % beams
    rest = beams - shift
    changed = _changed(scan[:rest], before[shift:]) + _changed(scan[rest:], before[:shift])
    if changed < CHANGED_SHARE * beams or agreement(before, scan, motion, range_max, directions) >= AGREEMENT_MIN:
        return True
    is_far = motion[0] * motion[0] + motion[1] * motion[1] > REVEALED_MIN_M * REVEALED_MIN_M
    return is_far and _in_free_floor(before, scan, motion, range_max, directions) < IN_FREE_FLOOR_MIN


@borrowing_kernel
def is_explained(before, scan, motion, std_m, std_rad, range_max, directions, found):
    """Whether another motion within what odometry may err by, which has these standard deviations, predicts enough of a
    scan that does not continue the one before by the motion (3,) that odometry read. Writes the one that predicts most
    to found (3,)."""
    ways, turns = int(ODOMETRY_STDS * std_m / ODOMETRY_STEP_M), int(ODOMETRY_STDS * std_rad / ODOMETRY_STEP_RAD)
    if ways == 0 and turns == 0:
        return False
    most, side, best = 0.0, 2 * ways + 1, 0
    for number in range((2 * turns + 1) * side * side):
        _tried(motion, number, side, ways, turns, found)
        share = agreement(before, scan, found, range_max, directions)
        if share > most:
            most, best = share, number
    _tried(motion, best, side, ways, turns, found)
    return most >= AGREEMENT_MIN


@borrowing_kernel
def _tried(motion, number, side, ways, turns, out):
    """Write one of the motions that `is_explained` tries to out (3,)."""
    out[0] = motion[0] + (number % side - ways) * ODOMETRY_STEP_M
    out[1] = motion[1] + (number // side % side - ways) * ODOMETRY_STEP_M
    out[2] = motion[2] + (number // (side * side) - turns) * ODOMETRY_STEP_RAD


@borrowing_kernel
def _changed(scan, before):
    """Number of ranges that differ by more than `CHANGE_M`; branch-free, so that the loop is vectorised."""
    changed = 0
    for i in range(scan.shape[0]):
        changed += int(abs(abs(scan[i]) - abs(before[i])) > CHANGE_M)
    return changed


@borrowing_kernel
def agreement(before, scan, motion, range_max, directions):
    """Share of the returns of a scan (beams,) that the scan before predicts, after a motion (3,); 1 of few returns."""
    returned, agreed, _ = _compared(before, scan, motion, range_max, directions)
    return agreed / returned if returned >= BEAMS_MIN else 1.0


@borrowing_kernel
def _in_free_floor(before, scan, motion, range_max, directions):
    """Share of the returns of a scan (beams,) that are nearer than the scan before predicts."""
    returned, _, nearer = _compared(before, scan, motion, range_max, directions)
    return nearer / returned


@borrowing_kernel
def _compared(before, scan, motion, range_max, directions):
    """Number of returns of a scan (beams,), of those that the scan before predicts, and of nearer ones.

    Negative ranges (teammates, lost beams) are skipped. The prediction of a beam lies between the least and the
    greatest of three neighbouring ranges of the scan before.
    """
    beams = scan.shape[0]
    per_beam = beams / (2.0 * math.pi)
    c, s = math.cos(motion[2]), math.sin(motion[2])
    returned = agreed = nearer = 0
    for i in range(beams):
        if not 0.0 < scan[i] < range_max:
            continue
        ax, ay = scan[i] * directions[i, 0], scan[i] * directions[i, 1]
        x, y = motion[0] + c * ax - s * ay, motion[1] + s * ax + c * ay
        away, beam = math.sqrt(x * x + y * y), int(math.floor(math.atan2(y, x) * per_beam + 0.5)) + beams
        a, b, d = abs(before[(beam - 1) % beams]), abs(before[beam % beams]), abs(before[(beam + 1) % beams])
        least = min(min(a, b), d)
        if least <= -UNSEEN_M:
            continue
        returned += 1
        agreed += least - AGREEMENT_M <= away <= max(max(a, b), d) + AGREEMENT_M
        nearer += away < least - AGREEMENT_M
    return returned, agreed, nearer
