"""Limit the size of a hash grid to what the photographs of a scene can fill."""

from __future__ import annotations

import math
from dataclasses import replace

from nerfreg.field.config import FieldConfig
from nerfreg.field.grid_layout import GridLayout
from nerfreg.scenes.scene import Scene


def fitted(config: FieldConfig, scene: Scene) -> FieldConfig:
    """Drop levels and table entries that the training pixels cannot tell apart.

    Args:
        config: The configuration to reduce.
        scene: The scene, whose training views and bounds decide.

    Returns:
        The configuration itself unless `fit` is set. Otherwise a copy without the levels whose
        cells are smaller than the footprint of a pixel, and with no more table entries than there
        are training pixels (rounded up to a power of two), since a pixel shows one surface point.
    """
    if not config.fit:
        return config
    # The smallest footprint that occurs: the longest focal length, at the near plane. A level that
    # is too fine even there is too fine everywhere.
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
        # Together with `levels` this keeps the resolutions of the levels that stay.
        finest=int(resolutions[levels - 1]),
        log2_entries=min(config.log2_entries, max(3, math.ceil(math.log2(pixels)))),
    )
