"""Which parts of a picture are drawn, and the keys that switch them in a window."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twc_env.exploration.rendering import Scene

HELP = "T truth  M maps  C closures  P paths  S signal  1-9 one robot's map  0 all  space: pause"


@dataclass(frozen=True, slots=True)
class Layers:
    """What a picture shows."""

    truth: bool = True
    """The true walls and where the robots truly are."""
    maps: bool = True
    """What is believed: maps, and where the robots believe to be."""
    closures: bool = True
    paths: bool = True
    signal: bool = False
    robot: int | None = None
    """Only the map that this robot believes in; None: everybody's."""

    def after(self, key: str) -> Layers:
        """The layers once a key was pressed; keys that mean nothing change nothing."""
        name = SWITCHES.get(key.lower())
        if name is not None:
            return replace(self, **{name: not getattr(self, name)})
        if len(key) == 1 and key in "0123456789":
            return replace(self, robot=int(key) - 1 if key != "0" else None)
        return self


SWITCHES = {"t": "truth", "m": "maps", "c": "closures", "p": "paths", "s": "signal"}


def layered(scene: Scene, layers: Layers) -> Scene:
    """The scene without the layers that are switched off; `signal` and `robot` were heeded when it was made."""
    if not layers.truth:
        scene = replace(scene, walls=np.zeros_like(scene.walls), true_poses=np.zeros((0, 3)))
    if not layers.maps:
        scene = replace(scene, grids=(), estimated_poses=np.zeros((0, 3)))
    if not layers.closures:
        scene = replace(scene, closures=())
    return scene if layers.paths else replace(scene, trails_m=())
