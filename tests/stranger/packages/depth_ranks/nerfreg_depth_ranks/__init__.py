"""Depth ranking: of two pixels of a view, a monocular depth map says which is closer."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from nerfreg import NerfregError, Photographs, Regularizer, Rendering, Step, hookimpl, read_image


@dataclass
class DepthRanks(Regularizer):
    """Depths are in the order of those of a monocular depth map (SparseNeRF).

    The map of the image NAME.png is NAME_depth.png. Only the order of its values counts.

    Attributes:
        weight: Factor of the ranking loss, in which depths are compared relative to themselves.
        maps: Folder of the maps; empty: that of the images.
        disparity: Whether larger values are closer (MiDaS, DPT) instead of farther away.
    """

    weight: float = 0.1
    maps: str = ""
    disparity: bool = False

    cite: ClassVar[str] = """@inproceedings{wang2023sparsenerf, booktitle = {ICCV}, year = {2023},
  title = {{SparseNeRF}: Distilling Depth Ranking for Few-shot Novel View Synthesis},
  author = {Wang, Guangcong and Chen, Zhaoxi and Loy, Chen Change and Liu, Ziwei}}"""

    @hookimpl
    def nerfreg_prepare(self, photographs: Photographs) -> dict[str, Tensor]:
        depth = torch.full(photographs.images.shape[:3], torch.nan)
        valid = depth.isnan() if photographs.valid is None else photographs.valid
        numbers = map(str, range(len(depth)))
        names = photographs.paths or map(Path, photographs.labels or numbers)
        for values, inside, name in zip(depth, valid, names, strict=True):
            file = Path(self.maps or name.parent, f"{name.stem}_depth.png")
            if not file.is_file():
                raise NerfregError(f"reg.depth_ranks: {file}, the depth map of {name}, is missing")
            # A map may have another resolution than the image, which may be padded.
            size = (int(inside.any(1).sum()), int(inside.any(0).sum()))
            read = interpolate(read_image(file)[None, None, ..., 0], size, mode="nearest-exact")
            values[inside] = read.flatten()
        return {"depth": depth}

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        rays, depth = rendering.rays, rendering.depth
        known = rays.data[f"{self.instance}.depth"]
        # Pairs of rays of one view: each ray and the next of that view in a random order.
        order = torch.randperm(len(known), generator=step.generator).to(known.device)
        order = order[rays.view[order].argsort(stable=True)]
        a, b = order[:-1], order[1:]
        closer = (known[b] - known[a]).sign() * (-1 if self.disparity else 1)
        # Nothing is known of pairs from two views, of equal values and of NaN.
        told = (rays.view[a] == rays.view[b]) & (closer.abs() == 1)
        gap = (depth[a] - depth[b]) / (depth[a] + depth[b]).clamp_min(1e-6)
        return {"depth_ranks": (closer * gap + 1e-4)[told].relu().sum() / len(known)}
