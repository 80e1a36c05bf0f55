"""The visual hull of silhouettes, from coarse cells to fine ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg import OccupancyGrid, Photographs
from nerfreg.rays.traversal import occupied_runs
from nerfreg_plugins.silhouettes.views import PinholeView

LEVELS = 3
"""How often cells are halved; those that a silhouette excludes are not looked at again."""

ROUGH = 48
"""Cells along the box by which it is found where the hull lies."""

CHUNK = 2**20
"""Most cells that are projected at once, which bounds the memory."""

SLACK = 1e-3
"""Part of a cell by which the grid is larger than it has to be."""

MISSED = 2e-3
"""Share of the opaque pixels whose rays may miss the hull; more means that something is wrong."""

OPAQUE = 0.5
"""Alpha above which a pixel must see the hull."""


def visual_hull(
    photographs: Photographs,
    covered: Bool[Tensor, "views height width"],
    resolution: int,
    margin: float,
    frame: bool,
) -> OccupancyGrid | None:
    """Return the cells that every silhouette leaves possible.

    Args:
        photographs: The photographs.
        covered: (V, H, W) which pixels show matter.
        resolution: Cells along each side of the grid, which is laid around the hull.
        margin: By how many pixels silhouettes are grown.
        frame: Whether space outside of an image is empty if its silhouette does not touch the
            border. If opaque pixels then see nothing of the hull, it is found again without that.

    Returns:
        The cells; those outside of the grid are empty. None if the silhouettes contradict each
        other, so that many opaque pixels see nothing of the hull.
    """
    for closed in (True, False) if frame else (False,):
        views = [
            PinholeView.of(
                photographs.cameras, view, _shown(photographs, covered, view), margin, closed
            )
            for view in range(len(covered))
        ]
        grid = _around(views, photographs, resolution)
        if grid is not None and _missed(grid, photographs, covered) <= MISSED:
            return grid
    return None


def _shown(photographs: Photographs, covered: Tensor, view: int) -> Bool[Tensor, "height width"]:
    """The silhouette of a view, without the padding of smaller photographs."""
    if photographs.valid is None:
        return covered[view]
    valid = photographs.valid[view]
    height, width = int(valid.any(dim=1).sum()), int(valid.any(dim=0).sum())
    return covered[view, :height, :width]


def _around(
    views: Sequence[PinholeView], photographs: Photographs, resolution: int
) -> OccupancyGrid | None:
    """Find the hull in the box, and lay the grid around what was found."""
    low, high = photographs.box
    size = float((high - low).max()) / ROUGH
    shape = ((high - low) / size).ceil().int().tolist()
    rough = _carved(views, low, size, shape)
    if not rough.any():
        return None
    places = rough.nonzero()
    first, last = places.amin(dim=0), places.amax(dim=0) + 1
    # A layer of empty cells all around, since outside of the grid the nearest cell counts. A
    # thousandth of a cell more, so that rounding cannot leave out the last cells of any side.
    extent = (last - first) * size
    cell = float(extent.max() / (resolution - 2 - 2 * SLACK))
    shape = ((extent / cell + SLACK).ceil().int() + 2).tolist()
    begin = low + first * size - cell
    fine = _carved(views, begin, cell, shape)
    for axis in range(3):
        for end in (0, -1):
            fine.select(axis, end).fill_(False)
    return OccupancyGrid(fine, begin, cell) if fine.any() else None


def _carved(
    views: Sequence[PinholeView], low: Float[Tensor, " 3"], cell: float, shape: Sequence[int]
) -> Bool[Tensor, "x y z"]:
    """Return which cells of a grid every view leaves possible."""
    side = 2**LEVELS
    coarse = [math.ceil(n / side) for n in shape]
    occupied = torch.zeros(*(n * side for n in coarse), dtype=torch.bool)
    for places in torch.ones(coarse, dtype=torch.bool).nonzero().split(CHUNK // side**3):
        x, y, z = _descended(views, places, low, cell).unbind(dim=1)
        occupied[x, y, z] = True
    nx, ny, nz = shape
    return occupied[:nx, :ny, :nz].contiguous()


def _descended(
    views: Sequence[PinholeView], places: Int[Tensor, "cells 3"], low: Tensor, cell: float
) -> Int[Tensor, "possible 3"]:
    """Return which of the smallest cells in some of the largest ones are possible."""
    halves = torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    for level in range(LEVELS, 0, -1):
        places = _possible(views, places, low, cell * 2**level)
        places = (2 * places[:, None] + halves).view(-1, 3)
    return _possible(views, places, low, cell)


def _possible(
    views: Sequence[PinholeView], places: Int[Tensor, "cells 3"], low: Tensor, cell: float
) -> Int[Tensor, "possible 3"]:
    centers = low.double() + (places + 0.5) * cell
    possible = torch.ones(len(places), dtype=torch.bool)
    for view in views:
        view.exclude(possible, centers, cell / 2)
    return places[possible]


def _missed(
    grid: OccupancyGrid, photographs: Photographs, covered: Bool[Tensor, "views height width"]
) -> float:
    """Return the share of opaque pixels whose rays meet no cell of the hull."""
    opaque = covered
    if photographs.masks is None:
        opaque = covered & (photographs.images[..., 3] > OPAQUE)
    pixels = opaque.nonzero()
    if len(pixels) == 0:
        return 0.0
    # Evenly spread over all of them; a hundred thousand tell enough.
    pixels = pixels[:: max(len(pixels) // 100_000, 1)]
    rays = photographs.cameras.rays(pixels[:, 0], pixels[:, [2, 1]])
    bounds = photographs.clipped(*rays)
    # Pixels that look past the box have nothing to see in it.
    asked = bounds[1] > bounds[0]
    met = occupied_runs(grid, *rays, *bounds).met(len(asked))
    return float((asked & ~met).sum()) / max(int(asked.sum()), 1)
