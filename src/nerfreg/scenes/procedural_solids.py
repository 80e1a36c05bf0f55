"""The solids of the procedural scene, and the images and depths that its cameras see of them."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.images import reduce
from nerfreg.scenes.layouts import stands_around
from nerfreg.scenes.solids import BOX, CYLINDER, SPHERE, RayTracer, Solid, Texture

SUPERSAMPLES = 2
"""Rays per pixel along each axis of the image."""


def make_tracer(layout: str, seed: int) -> RayTracer:
    """Place the solids on a round plate, or on a floor in front of a wall for "forward".

    Args:
        layout: The kind of capture, "object" or "forward".
        seed: Seed of colours and textures.

    Returns:
        The solids with a light.
    """
    generator = torch.Generator().manual_seed(seed)
    hue = float(torch.rand(1, generator=generator))

    # One seed turns all hues together and keeps them apart: a step of the golden ratio around the
    # circle of hues gives distinct colours for any number of solids.
    def texture(pattern: str, index: int, period: float, saturation: float = 0.75) -> Texture:
        base = (hue + 0.381966 * index) % 1
        tones = (
            colorsys.hsv_to_rgb(base, saturation, 0.85),
            colorsys.hsv_to_rgb((base + 0.12) % 1, 0.45 * saturation, 0.95),
        )
        return Texture(pattern, torch.tensor(tones), period, torch.rand(3, generator=generator))

    solids = [
        Solid(
            SPHERE, (-0.35, 0.25, -0.10), (0.40, 0.40, 0.40), texture("marble", 0, 0.9), gloss=0.6
        ),
        Solid(
            BOX, (0.42, 0.30, -0.15), (0.28, 0.24, 0.35), texture("checker", 1, 0.35), rotation=0.5
        ),
        Solid(
            CYLINDER,
            (0.12, -0.50, -0.05),
            (0.18, 0.18, 0.45),
            texture("stripes", 2, 0.3),
            gloss=0.5,
        ),
        Solid(
            SPHERE, (-0.52, -0.48, -0.28), (0.22, 0.22, 0.22), texture("dots", 3, 0.3), gloss=0.6
        ),
        Solid(
            SPHERE,
            (0.66, -0.30, -0.30),
            (0.20, 0.28, 0.20),
            texture("stripes", 4, 0.25),
            rotation=0.7,
            gloss=0.5,
        ),
        Solid(BOX, (0.42, 0.30, 0.35), (0.15, 0.15, 0.15), texture("marble", 5, 0.5), rotation=1.1),
    ]
    if stands_around(layout):
        solids.append(
            Solid(
                CYLINDER,
                (0.0, 0.0, -0.55),
                (1.15, 1.15, 0.05),
                texture("checker", 6, 1.1, 0.35),
                gloss=0.1,
            )
        )
    else:
        # Floor and wall fill every image of a forward-facing camera: no ray may leave the scene,
        # since these photographs have no alpha. Thick boxes, because all solids are convex volumes.
        solids.append(
            Solid(
                BOX,
                (0.0, 0.0, -10.5),
                (20.0, 20.0, 10.0),
                texture("checker", 6, 1.1, 0.35),
                gloss=0.1,
            )
        )
        solids.append(
            Solid(
                BOX,
                (0.0, 11.5, 0.0),
                (20.0, 10.0, 20.0),
                texture("marble", 7, 2.2, 0.5),
                gloss=0.1,
            )
        )
    return RayTracer(solids)


def render(
    tracer: RayTracer, cameras: Cameras, view: int, has_alpha: bool
) -> Float[Tensor, "height width channels"]:
    """Render the image of a view.

    Args:
        tracer: The solids.
        cameras: The cameras.
        view: The view.
        has_alpha: Whether to add the share of rays that hit a solid as a fourth channel.

    Returns:
        The image, each pixel the mean of 2 x 2 rays.
    """
    fine = replace(
        cameras,
        width=cameras.width * SUPERSAMPLES,
        height=cameras.height * SUPERSAMPLES,
        focal=cameras.focal * SUPERSAMPLES,
        center=cameras.center * SUPERSAMPLES,
    )
    origins, directions = fine.image_rays(view)
    colors, hit = tracer.shade(origins, directions)
    pixels = torch.cat((colors, hit[:, None].to(colors)), -1) if has_alpha else colors
    return reduce(pixels.float().reshape(fine.height, fine.width, -1), SUPERSAMPLES)


def depth(tracer: RayTracer, cameras: Cameras, view: int) -> Float[Tensor, "height width"]:
    """Compute the true distances along the rays through the pixel centres.

    Args:
        tracer: The solids.
        cameras: The cameras.
        view: The view.

    Returns:
        The distances, inf where a ray meets nothing.
    """
    # In double: this is what depths of renderings are measured against.
    origins, directions = cameras.image_rays(view)
    distance, _ = tracer.trace(origins.double(), directions.double())
    return distance.float().reshape(cameras.height, cameras.width)


def depth_range(tracer: RayTracer, cameras: Cameras, views: Sequence[int]) -> tuple[float, float]:
    """Find the least and the greatest depth along the optical axis that views see.

    Args:
        tracer: The solids.
        cameras: The cameras.
        views: The views.

    Returns:
        The depths, from a lattice of pixels, about 32 along the shorter side of the image.
    """
    stride = max(1, min(cameras.width, cameras.height) // 32)
    y, x = torch.meshgrid(
        torch.arange(0, cameras.height, stride),
        torch.arange(0, cameras.width, stride),
        indexing="ij",
    )
    pixels = torch.stack((x, y), -1).reshape(-1, 2)
    least, greatest = math.inf, 0.0
    for view in views:
        origins, directions = cameras.rays(torch.full((len(pixels),), view), pixels)
        distance, _ = tracer.trace(origins.double(), directions.double())
        depths = distance.float() * (directions @ cameras.axes[view])
        least, greatest = min(least, float(depths.min())), max(greatest, float(depths.max()))
    return least, greatest
