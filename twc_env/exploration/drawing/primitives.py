"""Anti-aliased lines, paths and circles on images (height, width, colours) float64, clipped at the edges."""

from __future__ import annotations

import math

from twc_env.kernels.compiled import kernel

OUTSIDE = -2.0
"""What fields of `raise_to_strokes` begin with."""


@kernel
def draw_line(image, u0, v0, u1, v1, half_width, colour, opacity):
    """Draw an anti-aliased line between two pixels with round ends; a disc if both are equal."""
    height, width, depth = image.shape
    reach = half_width + 1.0
    du, dv = u1 - u0, v1 - v0
    length2 = du * du + dv * dv
    for v in range(max(0, int(min(v0, v1) - reach)), min(height, int(max(v0, v1) + reach) + 2)):
        for u in range(max(0, int(min(u0, u1) - reach)), min(width, int(max(u0, u1) + reach) + 2)):
            t = 0.0 if length2 == 0.0 else min(1.0, max(0.0, ((u - u0) * du + (v - v0) * dv) / length2))
            away = math.hypot(u - u0 - t * du, v - v0 - t * dv)
            cover = opacity * min(1.0, max(0.0, half_width + 0.5 - away))
            if cover > 0.0:
                for k in range(depth):
                    image[v, u, k] += cover * (colour[k] - image[v, u, k])


@kernel
def draw_path(image, pixels, half_width, colour, fade):
    """Draw lines through pixels (k, 2), with opacity from about `fade` (oldest) to 0.9."""
    count = pixels.shape[0]
    for k in range(count - 1):
        opacity = fade + (0.9 - fade) * (k + 1) / count
        draw_line(image, pixels[k, 0], pixels[k, 1], pixels[k + 1, 0], pixels[k + 1, 1], half_width, colour, opacity)


@kernel
def draw_ring(image, u0, v0, radius, half_width, colour):
    """Draw an anti-aliased circle."""
    height, width, depth = image.shape
    reach = radius + half_width + 1.0
    for v in range(max(0, int(v0 - reach)), min(height, int(v0 + reach) + 2)):
        for u in range(max(0, int(u0 - reach)), min(width, int(u0 + reach) + 2)):
            away = abs(math.hypot(u - u0, v - v0) - radius)
            cover = min(1.0, max(0.0, half_width + 0.5 - away))
            for k in range(depth):
                image[v, u, k] += cover * (colour[k] - image[v, u, k])


@kernel
def raise_to_strokes(field, strokes):
    """Raise a field (height, width) to how far each pixel lies within lines with round ends, in pixels and negative
    outside; beyond 2 pixels it stays as it is. strokes: (n, 5) u1, v1, u2, v2 and half width."""
    height, width = field.shape
    for k in range(strokes.shape[0]):
        u0, v0, du, dv = strokes[k, 0], strokes[k, 1], strokes[k, 2] - strokes[k, 0], strokes[k, 3] - strokes[k, 1]
        reach, length2 = strokes[k, 4] + 2.0, du * du + dv * dv
        for v in range(max(0, int(min(v0, v0 + dv) - reach)), min(height, int(max(v0, v0 + dv) + reach) + 2)):
            for u in range(max(0, int(min(u0, u0 + du) - reach)), min(width, int(max(u0, u0 + du) + reach) + 2)):
                t = 0.0 if length2 == 0.0 else min(1.0, max(0.0, ((u - u0) * du + (v - v0) * dv) / length2))
                inside = strokes[k, 4] - math.hypot(u - u0 - t * du, v - v0 - t * dv)
                field[v, u] = max(field[v, u], inside)


@kernel
def paint_field(image, field, colour):
    """Paint where a field (height, width) of `raise_to_strokes` is positive; its edge is as wide as a pixel."""
    height, width, depth = image.shape
    for v in range(height):
        for u in range(width):
            cover = min(1.0, field[v, u] + 0.5)
            if cover > 0.0:
                for k in range(depth):
                    image[v, u, k] += cover * (colour[k] - image[v, u, k])
