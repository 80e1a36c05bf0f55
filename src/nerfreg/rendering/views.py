"""Whole images of a trained field."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Rays, Samples, Step
from nerfreg.rays.clipping import clip_to_box
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import OccupancyGrid
from nerfreg.rendering.renderer import Evaluation, Renderer
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Scene

RAYS = 2048
"""Rays rendered at once."""


@dataclass(frozen=True)
class View:
    """A rendered view.

    rgb: (H, W, 3) on the scene's background. depth: (H, W) distance along the ray, `far` where it is empty.
    opacity: (H, W).
    """

    rgb: Float[Tensor, "height width 3"]
    depth: Float[Tensor, "height width"]
    opacity: Float[Tensor, "height width"]


class ViewRenderer(Renderer):
    """Renders images as training renders rays, without chance, without plugins, and without looking at empty space.

    The samples are as many as in training; where the occupancy grid is empty the field is not evaluated and its
    density is 0.
    """

    jitter = False

    def __init__(self, field: RadianceField, sampler: SamplerConfig, scene: Scene) -> None:
        super().__init__(field, sampler, _NoHooks())
        self.scene = scene
        self.occupancy = OccupancyGrid(field, sampler.skip_resolution)
        self.step = Step(0, 0, 1.0, torch.Generator(), (scene.near, scene.far), lambda rendering: rendering)

    @torch.no_grad()
    def view(self, cameras: Cameras, view: int, stride: int = 1) -> View:
        """One image, of every `stride`-th row and column."""
        device = self.field.center.device
        y, x = torch.meshgrid(
            torch.arange(0, cameras.height, stride), torch.arange(0, cameras.width, stride), indexing="ij"
        )
        pixels = torch.stack([x, y], dim=-1).view(-1, 2)
        origins, directions = cameras.rays(torch.full((len(pixels),), view), pixels)
        near, far = clip_to_box(origins, directions, self.scene.box, self.scene.near, self.scene.far)
        background = torch.zeros(3) if self.scene.background is None else self.scene.background
        image = torch.cat([background.expand(len(pixels), 3), far[:, None], torch.zeros(len(pixels), 1)], dim=1)
        for chunk in (far > near).nonzero().squeeze(1).split(RAYS):
            rays = Rays(
                origins[chunk].to(device),
                directions[chunk].to(device),
                near[chunk].to(device),
                far[chunk].to(device),
                targets=torch.zeros(0, 3),
                background=background.expand(len(chunk), 3).to(device),
            )
            result = self.render(rays, self.step)
            image[chunk] = torch.cat([result.rgb, result.depth[:, None], result.opacity[:, None]], dim=1).cpu()
        image = image.view(*x.shape, 5)
        return View(image[..., :3].contiguous(), image[..., 3].contiguous(), image[..., 4].contiguous())

    def _evaluate(self, samples: Samples) -> Evaluation:
        positions = samples.positions.reshape(-1, 3)
        seen = self.occupancy.contains(positions).nonzero().squeeze(1)
        raw = self.field.raw_density(positions[seen])
        density = raw.new_zeros(len(positions))
        density[seen] = self.field.density(raw)
        rows = seen.new_zeros(len(positions))
        rows[seen] = torch.arange(len(seen), device=seen.device)
        return Evaluation(density.view(samples.t.shape), raw, rows.view(samples.t.shape))


class _NoHooks:
    """Test views are rendered as the field is, whatever the plugins did while it was trained."""

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        return rays.near, rays.far

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        return samples
