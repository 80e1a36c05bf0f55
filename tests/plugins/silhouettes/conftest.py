"""Photographs of solids, as a sensor with square pixels without gaps takes them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pytest
import torch
from nerfreg_plugins.silhouettes import Silhouettes
from torch import Tensor
from torch.nn.functional import normalize

from nerfreg import OccupancyGrid, Photographs
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.poses import look_at
from nerfreg.scenes.solids import BOX, CYLINDER, SPHERE, RayTracer, Shape, Solid, Texture

BOX_OF_SCENE = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
PLAIN = Texture("marble", torch.ones(2, 3), 1.0, torch.zeros(3))


def solid(
    shape: Shape, center: Sequence[float], half_size: Sequence[float], rotation: float = 0.0
) -> Solid:
    return Solid(shape, tuple(center), tuple(half_size), PLAIN, rotation)


def sphere(center: Sequence[float], radius: float) -> Solid:
    return solid(SPHERE, center, (radius,) * 3)


def random_cameras(
    count: int,
    size: int = 32,
    seed: int = 0,
    target: Sequence[float] = (0.0, 0.0, 0.0),
    distance: tuple[float, float] = (3.0, 5.0),
    distortion: Sequence[float] = (0.0,) * 5,
    field_of_view: float = 1.0,
) -> Cameras:
    """Cameras all around that look about at a target, with any roll."""
    draw = torch.Generator().manual_seed(seed)
    away = normalize(torch.randn(count, 3, dtype=torch.float64, generator=draw), dim=1)
    length = distance[0] + (distance[1] - distance[0]) * torch.rand(count, 1, generator=draw)
    aim = torch.tensor(target) + 0.1 * torch.randn(count, 3, generator=draw)
    up = torch.randn(count, 3, dtype=torch.float64, generator=draw)
    poses = look_at(torch.tensor(target) + away * length, aim.double(), up).float()
    focal = 0.5 * size / math.tan(0.5 * field_of_view) * torch.tensor([1.0, 1.1])
    center = size / 2 + torch.rand(count, 2, generator=draw)
    lens = torch.tensor(distortion).expand(count, 5)
    return Cameras(size, size, poses, focal.expand(count, 2), center, lens)


def taken(
    tracer: RayTracer, cameras: Cameras, samples: int = 6, box: Tensor = BOX_OF_SCENE
) -> Photographs:
    """Photographs whose alpha is the share of samples^2 points of a pixel that see a solid."""
    steps = (torch.arange(samples) + 0.5) / samples
    x, y = torch.arange(cameras.width), torch.arange(cameras.height)
    across = (x[:, None] + steps).flatten()
    down = (y[:, None] + steps).flatten()
    points = torch.stack(torch.meshgrid(down, across, indexing="ij")[::-1], dim=-1).view(-1, 2)
    images = []
    for view in range(len(cameras)):
        rays = cameras.rays_through(torch.full((len(points),), view), points)
        hit = tracer.trace(*(part.double() for part in rays))[0].isfinite().float()
        alpha = hit.view(cameras.height, samples, cameras.width, samples).mean(dim=(1, 3))
        images.append(torch.cat([torch.ones(*alpha.shape, 3), alpha[..., None]], dim=-1))
    return Photographs(
        images=torch.stack(images), cameras=cameras, box=box, near=0.01, far=20.0, layout="orbit"
    )


def matter(solids: Sequence[Solid], count: int = 1000, seed: int = 0) -> Tensor:
    """Points inside of solids and on their surfaces, (P, 3)."""
    draw = torch.Generator().manual_seed(seed)
    found = []
    for each in solids:
        unit = 2 * torch.rand(4 * count, 3, dtype=torch.float64, generator=draw) - 1
        unit[: 2 * count] = normalize(unit[: 2 * count], dim=1) * 1.8
        # Those outside are moved onto the surface, by a ray from the middle.
        leave = each.shape.intersect(torch.zeros_like(unit), unit)[1]
        unit = unit * leave.clamp_max(1.0)[:, None]
        c, s = math.cos(each.rotation), math.sin(each.rotation)
        axes = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
        local = unit * torch.tensor(each.half_size, dtype=torch.float64)
        # A millionth inside, since a surface has no side in float32.
        found.append(local * (1 - 1e-6) @ axes.T + torch.tensor(each.center, dtype=torch.float64))
    return torch.cat(found).float()


def carved(photographs: Photographs, **options: float) -> OccupancyGrid | None:
    plugin = Silhouettes(**{"resolution": 48, **options})
    plugin.nerfreg_module()
    assert plugin.nerfreg_prepare(photographs) == {}
    return plugin.nerfreg_occupancy()


SHAPES: dict[str, list[Solid]] = {
    "blobs": [sphere((-0.3, 0.2, 0.1), 0.4), solid(BOX, (0.4, -0.2, 0.0), (0.2, 0.3, 0.4), 0.5)],
    # A fifth of a pixel wide, as seen from 4.5 away by 32 pixels.
    "rods": [
        solid(CYLINDER, (0.3, 0.1, 0.0), (0.016, 0.016, 0.7)),
        solid(BOX, (0.0, 0.0, -0.2), (0.8, 0.016, 0.016), 0.7),
    ],
    "plate": [solid(BOX, (0.1, 0.0, 0.2), (0.6, 0.5, 0.016), 0.3)],
    "cup": [
        solid(BOX, (0.0, 0.0, -0.4), (0.4, 0.4, 0.05)),
        *(solid(BOX, (x, 0.0, 0.0), (0.05, 0.4, 0.4)) for x in (-0.4, 0.4)),
        *(solid(BOX, (0.0, y, 0.0), (0.4, 0.05, 0.4)) for y in (-0.4, 0.4)),
    ],
    "two pieces": [sphere((-0.7, 0.0, 0.0), 0.15), sphere((0.7, 0.3, 0.2), 0.2)],
}


@pytest.fixture(params=SHAPES)
def solids(request: pytest.FixtureRequest) -> list[Solid]:
    return SHAPES[request.param]


@pytest.fixture
def several() -> list[Solid]:
    """Thick and thin ones, for tests that are not about shapes."""
    return SHAPES["blobs"] + SHAPES["rods"][:1]


@pytest.fixture
def cameras() -> Callable[..., Cameras]:
    return random_cameras


@pytest.fixture
def photographs() -> Callable[..., Photographs]:
    """Take photographs of solids."""
    return lambda solids, cameras, **options: taken(RayTracer(solids), cameras, **options)


@pytest.fixture
def points() -> Callable[..., Tensor]:
    return matter


@pytest.fixture
def hull() -> Callable[..., OccupancyGrid | None]:
    return carved


@pytest.fixture
def ball() -> Callable[..., Solid]:
    return sphere


@pytest.fixture
def unit_box() -> Tensor:
    return BOX_OF_SCENE
