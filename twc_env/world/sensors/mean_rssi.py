"""Mean RSSI of transmitters at a position: path loss, walls, bodies, ceilings, shadowing; before fading and noise."""

from __future__ import annotations

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel


@borrowing_kernel
def mean_rssi(x, y, losses, pose_home_building, boxes, waves, radios, parts, limits, scratch, mean):
    """Fill mean (transmitters,) with the RSSI before fading, device offset and noise.

    losses (bands, sources): wall losses; boxes (4, sources): x, y, height, shadowing std; waves (3, waves, sources): x
    and y frequency and phase; radios (3, transmitters): power minus constant losses, path loss exponent, additional
    ceiling loss at grazing incidence; parts (2, transmitters): source and band; limits (2,): least distance, share of
    the power that bypasses walls; scratch (>= 3, sources).
    """
    shadowing, path_loss, grazing = scratch[0], scratch[1], scratch[2]
    _shadowing(x, y, pose_home_building, boxes, waves, shadowing)
    for a in range(boxes.shape[1]):
        dx, dy, dz = boxes[0, a] - x, boxes[1, a] - y, boxes[2, a]
        reach = np.sqrt(dx * dx + dy * dy + dz * dz)
        path_loss[a] = 10.0 * np.log10(max(reach, limits[0]))
        grazing[a] = 1.0 - dz / reach if dz > 0.0 else 0.0
    for t in range(parts.shape[1]):
        a = parts[0, t]
        fixed = radios[0, t] - radios[1, t] * path_loss[a] - radios[2, t] * grazing[a]
        mean[t] = fixed - losses[parts[1, t], a] + shadowing[a]
    if limits[1] > 0.0:
        for t in range(parts.shape[1]):
            through_db = losses[parts[1, t], parts[0, t]]
            mean[t] += through_db + 10.0 * np.log10((1.0 - limits[1]) * 10.0 ** (-0.1 * through_db) + limits[1])


@borrowing_kernel
def _shadowing(x, y, pose_home_building, boxes, waves, shadowing):
    """Fill shadowing (sources,) [dB] at (x, y): sums of cosines in the home frame; the inner loop is vectorised."""
    c, s = np.cos(pose_home_building[2]), np.sin(pose_home_building[2])
    home_x = pose_home_building[0] + c * x - s * y
    home_y = pose_home_building[1] + s * x + c * y
    shadowing[:] = 0.0
    for k in range(waves.shape[1]):
        for a in range(waves.shape[2]):
            turns = (waves[0, k, a] * home_x + waves[1, k, a] * home_y + waves[2, k, a]) * (0.5 / np.pi)
            # Taylor series of the sine, to 1e-9 on a quarter turn around the zero; vectorised, unlike calls of cos.
            z = 2.0 * np.pi * (0.25 - abs(turns - np.floor(turns + 0.5)))
            q = z * z
            tail = q * (1 / 362880 - q * (1 / 39916800 - q * (1 / 6227020800)))
            shadowing[a] += z * (1.0 - q * (1 / 6 - q * (1 / 120 - q * (1 / 5040 - tail))))
    for a in range(waves.shape[2]):
        shadowing[a] *= boxes[3, a] * np.sqrt(2.0 / waves.shape[1])


@borrowing_kernel
def lose_in_bodies(x, y, boxes, crossed, bodies, losses):
    """Add the losses of bodies (k, 5) in the line of sight from (x, y) to losses (bands, sources).

    A body: x, y, radius, loss [dB], and the most walls between behind which it still counts. boxes (>= 3, sources): x,
    y and height of the sources; those on other storeys do not change. crossed (sources,): walls between.
    """
    for a in range(crossed.shape[0]):
        if boxes[2, a] > 0.0:
            continue
        dx, dy = boxes[0, a] - x, boxes[1, a] - y
        distance2 = max(dx * dx + dy * dy, 1e-12)
        for k in range(bodies.shape[0]):
            if crossed[a] > bodies[k, 4]:
                continue
            ox, oy, radius = bodies[k, 0] - x, bodies[k, 1] - y, bodies[k, 2]
            share = (ox * dx + oy * dy) / distance2
            if 0.0 < share < 1.0 and (ox - share * dx) ** 2 + (oy - share * dy) ** 2 < radius * radius:
                for band in range(losses.shape[0]):
                    losses[band, a] += bodies[k, 3]
