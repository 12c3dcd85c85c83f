"""Layers of a picture, and the keys that toggle them in a window."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twc_env.exploration.drawing.rendering import Scene

HELP = "T truth  M maps  C closures  P paths  S signal  1-9 one robot's map  0 all  space: pause"


@dataclass(frozen=True, slots=True)
class Layers:
    """The layers to draw."""

    truth: bool = True
    """True walls, doors, furniture, true robot poses and people."""
    maps: bool = True
    """Estimated maps and estimated robot poses."""
    closures: bool = True
    paths: bool = True
    signal: bool = False
    robot: int | None = None
    """Draw only the map that this robot uses; None: all maps."""

    def after(self, key: str) -> Layers:
        """The layers after a key press; other keys than those in `HELP` change nothing."""
        name = SWITCHES.get(key.lower())
        if name is not None:
            return replace(self, **{name: not getattr(self, name)})
        if len(key) == 1 and key in "0123456789":
            return replace(self, robot=int(key) - 1 if key != "0" else None)
        return self


SWITCHES = {"t": "truth", "m": "maps", "c": "closures", "p": "paths", "s": "signal"}


def layered(scene: Scene, layers: Layers) -> Scene:
    """The scene without the layers that are off, except `signal` and `robot`, which apply when the scene is made."""
    if not layers.truth:
        nobody, nothing = np.zeros((0, 2)), np.zeros((0, 4))
        scene = replace(
            scene,
            walls=np.zeros_like(scene.walls),
            true_poses=np.zeros((0, 3)),
            people_m=nobody,
            things_m=nothing,
        )
    if not layers.maps:
        scene = replace(scene, grids=(), estimated_poses=np.zeros((0, 3)))
    if not layers.closures:
        scene = replace(scene, closures=())
    return scene if layers.paths else replace(scene, trails_m=())
