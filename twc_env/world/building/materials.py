"""Wall materials: radio losses per band, and transparency to lasers.

The losses are rounded values within the spread of published indoor measurements, thin partitions to reinforced concrete
(3GPP TR 38.901, table 7.4.3-1: 2.5, 5.1 and 14.6 dB for glass, wood and concrete at 2.4 GHz). A floor plan's
`wall_loss_db` is the loss at 2.4 GHz; the table gives the differences of other bands.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Material:
    """Properties of a wall material."""

    losses_db: tuple[float, float, float]
    """Loss per crossing at 2.4 GHz, at 5 GHz and of LTE below 2 GHz."""
    is_glass: bool = False
    """Whether laser beams may pass (`lidar.glass_return_probability`)."""
    is_mirror: bool = False
    """Whether it may show lasers what stands before it (`lidar.mirror_probability`)."""


MATERIALS = {
    "glass": Material((3.0, 5.0, 2.5), is_glass=True),
    "coated-glass": Material((12.0, 20.0, 11.0), is_glass=True),
    "mirror": Material((12.0, 20.0, 11.0), is_mirror=True),
    "wood": Material((3.5, 6.0, 3.0)),
    "plasterboard": Material((4.0, 5.0, 3.5)),
    "shelf": Material((3.0, 4.5, 2.5)),
    "brick": Material((7.0, 11.0, 6.0)),
    "concrete": Material((12.0, 20.0, 10.0)),
    "reinforced-concrete": Material((18.0, 28.0, 15.0)),
    "metal": Material((26.0, 32.0, 22.0)),
}
