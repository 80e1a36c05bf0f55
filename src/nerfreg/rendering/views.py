"""Whole images of a trained field."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.field.directions import spherical_harmonics
from nerfreg.field.radiance_field import RadianceField
from nerfreg.field.workers import in_shares
from nerfreg.rays.clipping import clip_to_box
from nerfreg.rendering.compositing import MIN_WEIGHT, integrate, transmittance
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import OccupancyGrid
from nerfreg.rendering.sampling import edges_between, equal_shares, stratified
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Scene

SAMPLES = 2**16
"""Samples that a thread renders at once."""

FLOOR = 0.1
"""This share of a ray's intervals is spread evenly over it, the rest lies where density was found."""

DARK = 1e-3
"""Light below which a ray is not followed any further."""


@dataclass(frozen=True)
class View:
    """A rendered view.

    rgb: (H, W, 3) on the scene's background. depth: (H, W) distance along the ray, `far` where it is empty.
    opacity: (H, W).
    """

    rgb: Float[Tensor, "height width 3"]
    depth: Float[Tensor, "height width"]
    opacity: Float[Tensor, "height width"]


class ViewRenderer:
    """Renders images without chance and without plugins, and looks only where there is something to see.

    A scout, one ray through the middle of each block of pixels, finds where along it there is density
    (`sampler.scout_samples`). The rays of the block's pixels are then cut into `sampler.view_samples` intervals of
    equal share in what this scout and those around it have found. Where the occupancy grid is empty, and behind
    what is opaque, the field is not evaluated.

    points, colors: evaluations of density and colour so far.
    """

    def __init__(self, field: RadianceField, sampler: SamplerConfig, scene: Scene) -> None:
        self.field = field
        self.sampler = sampler
        self.scene = scene
        self.occupancy = OccupancyGrid(field, sampler.skip_resolution)
        self.background = torch.zeros(3) if scene.background is None else scene.background
        self._points: list[int] = []
        self._colors: list[int] = []

    @property
    def points(self) -> int:
        return sum(self._points)

    @property
    def colors(self) -> int:
        return sum(self._colors)

    @torch.no_grad()
    def view(self, cameras: Cameras, view: int, stride: int = 1) -> View:
        """One image, of every `stride`-th row and column."""
        # Pixels that are further apart see less of the same.
        side, device = max(self.sampler.view_block // stride, 1), self.field.center.device
        rows, columns = (
            torch.arange(0, cameras.height, stride),
            torch.arange(0, cameras.width, stride),
        )
        pixels = _blocks(rows, columns, side)
        blocks = pixels.shape[:2]
        origins, directions = cameras.rays(
            torch.full((pixels[..., 0].numel(),), view), pixels.reshape(-1, 2)
        )
        near, far = clip_to_box(
            origins, directions, self.scene.box, self.scene.near, self.scene.far
        )
        image = torch.cat(
            [self.background.expand(len(near), 3), far[:, None], torch.zeros(len(near), 1)], dim=1
        )
        image = image.view(blocks.numel(), side**2, 5)
        rays = _Blocks(
            *(
                part.view(len(image), side**2, *part.shape[1:])
                for part in (origins, directions, near, far)
            )
        )
        hit = (far > near).view(len(image), -1).any(dim=1).nonzero().squeeze(1)
        rays = rays.to(device)
        scouts = self._scout(rays, hit).shared(blocks)
        count, size = (
            self.sampler.view_samples,
            max(SAMPLES // (side**2 * self.sampler.view_samples), 1),
        )

        def render(first: int, last: int) -> None:
            for chunk in hit[first:last].split(size):
                image[chunk] = self._render(rays.picked(chunk), *scouts.cuts(chunk, count)).cpu()

        in_shares(len(hit), size, render)
        image = image.view(*blocks, side, side, 5).transpose(1, 2).flatten(2, 3).flatten(0, 1)
        image = image[: len(rows), : len(columns)]
        return View(
            image[..., :3].contiguous(), image[..., 3].contiguous(), image[..., 4].contiguous()
        )

    def _scout(self, rays: _Blocks, hit: Int[Tensor, " hit"]) -> _Scouts:
        """Follow the middle of every block that meets the box."""
        count, samples = len(rays.near), self.sampler.scout_samples
        edges, weights, light = (rays.near.new_zeros(count, samples + more) for more in (1, 0, 0))
        size = max(SAMPLES // samples, 1)

        def follow(first: int, last: int) -> None:
            for chunk in hit[first:last].split(size):
                block = rays.picked(chunk)
                near, far = block.near.amin(dim=1), block.far.amax(dim=1)
                t = stratified(near, far, samples, self.sampler.spacing)
                middle = functional.normalize(block.directions.mean(dim=1), dim=-1)
                positions = block.origins.mean(dim=1)[:, None] + middle[:, None] * t[..., None]
                density = self._density(positions, torch.ones_like(t, dtype=torch.bool))[0]
                edges[chunk] = edges_between(t, near, far)
                found = integrate(density, edges[chunk])
                weights[chunk] = found.weights
                light[chunk] = found.log_transmittance.exp()

        in_shares(len(hit), size, follow)
        return _Scouts(edges, weights, light)

    def _render(
        self,
        rays: _Blocks,
        edges: Float[Tensor, "blocks edges"],
        light: Float[Tensor, "blocks samples"],
    ) -> Float[Tensor, "blocks pixels 5"]:
        """Colour, depth and opacity of every pixel, from intervals that the pixels of a block share."""
        blocks, pixels = rays.near.shape
        # Pixels at the border of the box enter and leave it at distances of their own.
        own = edges[:, None].clamp(rays.near[..., None], rays.far[..., None]).flatten(0, 1)
        directions = rays.directions.flatten(0, 1)
        t = (own[:, 1:] + own[:, :-1]) / 2
        positions = rays.origins.flatten(0, 1)[:, None] + directions[:, None] * t[..., None]
        lit = (light > DARK)[:, None].expand(-1, pixels, -1).reshape(t.shape)
        density, raw, places = self._density(positions, lit & (own.diff(dim=1) > 0))
        result = integrate(density, own)
        ray, sample = (result.weights > MIN_WEIGHT).nonzero(as_tuple=True)
        self._colors.append(len(ray))
        color = self.field.color(
            raw.index_select(0, places[ray, sample]),
            spherical_harmonics(directions).index_select(0, ray),
        )
        rgb = color.new_zeros(len(t), 3).index_add(
            0, ray, result.weights[ray, sample][:, None] * color
        )
        rgb = rgb + transmittance(result.tau)[:, None] * self.background.to(rgb)
        return torch.cat([rgb, result.depth[:, None], result.opacity[:, None]], dim=1).view(
            blocks, pixels, 5
        )

    def _density(
        self, positions: Float[Tensor, "rays samples 3"], asked: Bool[Tensor, "rays samples"]
    ) -> tuple[
        Float[Tensor, "rays samples"], Float[Tensor, "evaluated out"], Int[Tensor, "rays samples"]
    ]:
        """Density where asked for and not known to be 0; output of the density network; each sample's row of it."""
        flat = positions.view(-1, 3)
        seen = (asked.view(-1) & self.occupancy.contains(flat)).nonzero().squeeze(1)
        self._points.append(len(seen))
        raw = self.field.raw_density(flat.index_select(0, seen))
        density = raw.new_zeros(len(flat)).index_copy(0, seen, self.field.density(raw))
        places = seen.new_zeros(len(flat)).index_copy(
            0, seen, torch.arange(len(seen), device=seen.device)
        )
        return density.view(asked.shape), raw, places.view(asked.shape)


@dataclass(frozen=True)
class _Blocks:
    """Rays of the pixels of blocks."""

    origins: Float[Tensor, "blocks pixels 3"]
    directions: Float[Tensor, "blocks pixels 3"]
    near: Float[Tensor, "blocks pixels"]
    far: Float[Tensor, "blocks pixels"]

    def picked(self, chunk: Int[Tensor, " picked"]) -> _Blocks:
        return _Blocks(
            self.origins[chunk], self.directions[chunk], self.near[chunk], self.far[chunk]
        )

    def to(self, device: torch.device) -> _Blocks:
        return _Blocks(
            *(part.to(device) for part in (self.origins, self.directions, self.near, self.far))
        )


@dataclass(frozen=True)
class _Scouts:
    """What was found in each block. light: how much reaches each interval."""

    edges: Float[Tensor, "blocks edges"]
    weights: Float[Tensor, "blocks samples"]
    light: Float[Tensor, "blocks samples"]

    def shared(self, blocks: torch.Size) -> _Scouts:
        """Weights and light become the largest around them: in the adjacent blocks and one interval along the ray.

        Where a block holds the rim of something, its pixels see past it what its own scout did not.
        """

        def around(values: Float[Tensor, "blocks samples"]) -> Float[Tensor, "blocks samples"]:
            return functional.max_pool3d(
                values.view(1, 1, *blocks, -1), 3, stride=1, padding=1
            ).view(values.shape)

        return _Scouts(self.edges, around(self.weights), around(self.light))

    def cuts(
        self, chunk: Int[Tensor, " picked"], count: int
    ) -> tuple[Float[Tensor, "picked edges"], Float[Tensor, "picked count"]]:
        """`count` intervals for each picked block, as edges, and the light that reaches each at most."""
        weights = self.weights[chunk]
        weights = weights + FLOOR / weights.shape[1] * weights.sum(dim=1, keepdim=True)
        edges, bins = equal_shares(self.edges[chunk], weights, count)
        return edges, self.light[chunk].gather(1, bins)


def _blocks(
    rows: Int[Tensor, " height"], columns: Int[Tensor, " width"], side: int
) -> Int[Tensor, "y x pixels 2"]:
    """Pixels (x, y) in square blocks; the last row and column are repeated where blocks reach beyond them."""
    rows, columns = (
        torch.cat([line, line[-1:].expand(-len(line) % side)]).view(-1, side)
        for line in (rows, columns)
    )
    y, x = torch.broadcast_tensors(rows[:, None, :, None], columns[None, :, None, :])
    return torch.stack([x, y], dim=-1).flatten(2, 3)
