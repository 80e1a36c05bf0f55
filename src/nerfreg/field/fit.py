"""Leave out of a grid what the photographs of a scene cannot fill."""

from __future__ import annotations

import math
from dataclasses import replace

from nerfreg.field.config import FieldConfig
from nerfreg.field.grid_layout import GridLayout
from nerfreg.scenes.scene import Scene


def fitted(config: FieldConfig, scene: Scene) -> FieldConfig:
    """The configuration without levels and table entries that no training pixel can tell apart, if `fit` is set.

    Levels whose cells are smaller than a pixel of the sharpest training view is at the nearest point of the scene go.
    A pixel shows one place on a surface, so a level gets no more table entries than there are training pixels.
    """
    if not config.fit:
        return config
    views = list(scene.train)
    footprint = scene.near / float(scene.cameras.focal[views].max())
    side = float((scene.box[1] - scene.box[0]).max())
    resolutions = GridLayout(
        config.levels, config.base, config.finest, config.log2_entries
    ).resolutions
    levels = max(1, sum(side / float(resolution) >= footprint for resolution in resolutions))
    pixels = len(views) * scene.cameras.width * scene.cameras.height
    return replace(
        config,
        levels=levels,
        finest=int(resolutions[levels - 1]),
        log2_entries=min(config.log2_entries, max(3, math.ceil(math.log2(pixels)))),
    )
