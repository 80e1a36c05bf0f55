"""What is wrong with an answer of the hooks around a rendering is said in a line each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from nerfreg.hooks import (
    ColorSamples,
    DensitySamples,
    OccupancyGrid,
    Rays,
    Rendering,
    TrainedModule,
)
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Photographs
from nerfreg.training.contracts import Untouched
from nerfreg.training.contracts_rendering import (
    wrong_color_input,
    wrong_density,
    wrong_empty,
    wrong_metrics,
    wrong_occupancy,
    wrong_rays,
    wrong_rendering,
    wrong_unseen_poses,
)
from nerfreg.training.contracts_setup import (
    wrong_encoder,
    wrong_module,
    wrong_prepared,
    wrong_state,
)


class Encoder(torch.nn.Linear):
    """A linear map that tells its width, or another one."""

    def __init__(self, width: object, outputs: int = 4) -> None:
        super().__init__(3, outputs)
        self.width = width


@pytest.fixture
def densities(rays: Rays) -> DensitySamples:
    """Two rays with three samples each."""

    def read_raw() -> torch.Tensor:
        raise AssertionError("nobody has asked for raw densities")

    edges = torch.tensor([[1.0, 1.5, 2.0, 3.0]]).repeat(2, 1)
    return DensitySamples(rays, edges[:, 1:], edges, torch.ones(2, 3), read_raw)


def test_rays_may_move_and_nothing_else(rays: Rays) -> None:
    moved = replace(rays, origins=rays.origins + 1, near=rays.near / 2)
    assert wrong_rays(rays, moved) == []
    assert wrong_rays(rays, None) == [
        "returned None, not Rays; return `rays` to leave them as they are"
    ]
    assert wrong_rays(rays, replace(rays, directions=3 * rays.directions)) == [
        "directions: not of unit length, off by up to 2"
    ]
    assert wrong_rays(rays, replace(rays, origins=rays.origins.double())) == [
        "origins: has dtype torch.float64, not torch.float32"
    ]
    assert wrong_rays(rays, replace(rays, targets=rays.targets + 1)) == [
        "targets: is not what it was; leave it"
    ]
    # An equal copy does no harm.
    assert wrong_rays(rays, replace(rays, targets=rays.targets.clone())) == []


def test_what_targets_count_may_change(rays: Rays) -> None:
    assert wrong_rays(rays, replace(rays, target_weights=torch.tensor([0.0, 1.0]))) == []
    assert wrong_rays(rays, replace(rays, target_weights=torch.tensor([torch.nan, 1.0]))) == [
        "target_weights: 1 of 2 values not finite, the first at [0]: nan"
    ]


def test_densities(densities: DensitySamples) -> None:
    assert wrong_density(densities, densities.density * 2) == []
    assert wrong_density(densities, None) == [
        "returned None; return densities (R, N), or `samples.density` to leave them"
    ]
    below = densities.density.clone()
    below[1, 2] = -0.5
    assert wrong_density(densities, below) == ["density: negative at 1 of 6 samples, as -0.5"]
    assert wrong_density(densities, below[:1]) == ["density: has shape (1, 3), not (2, 3)"]


def test_watching_densities_asks_for_no_raw_ones(densities: DensitySamples) -> None:
    watch = Untouched(densities)
    densities.density[0, 0] = 0
    assert watch.edits() == ["density has been edited in place"]


def test_emptiness_is_a_truth_value_for_each_position() -> None:
    positions = torch.zeros(5, 3)
    assert wrong_empty(positions, None) == []
    assert wrong_empty(positions, torch.ones(5, dtype=torch.bool)) == []
    assert wrong_empty(positions, torch.ones(5)) == [
        "empty: has dtype torch.float32, not torch.bool"
    ]
    assert wrong_empty(positions, torch.ones(4, dtype=torch.bool)) == [
        "empty: has shape (4,), not (5,)"
    ]


def test_occupancy_is_a_grid_of_cells() -> None:
    cells, low = torch.ones(4, 5, 6, dtype=torch.bool), torch.zeros(3)
    assert wrong_occupancy(None) == wrong_occupancy(OccupancyGrid(cells, low, 0.5)) == []
    assert wrong_occupancy(cells) == ["returned of type Tensor, not an OccupancyGrid"]


@pytest.mark.parametrize(
    ("part", "value", "wrong"),
    [
        ("occupied", torch.ones(4, 5, 6), "occupied: has dtype torch.float32, not torch.bool"),
        ("occupied", torch.ones(4, 5) > 0, "occupied: is (4, 5), not a tensor (X, Y, Z)"),
        ("occupied", torch.ones(4, 0, 5) > 0, "occupied: is (4, 0, 5), not a tensor (X, Y, Z)"),
        ("low", torch.zeros(2), "low: has shape (2,), not (3,)"),
        (
            "low",
            torch.tensor([0.0, torch.inf, 0.0]),
            "low: 1 of 3 values not finite, the first at [1]: inf",
        ),
        ("cell", 0.0, "cell: is 0.0, not a positive number"),
        ("cell", float("nan"), "cell: is nan, not a positive number"),
        ("cell", torch.ones(()), "cell: is of type Tensor, not a positive number"),
    ],
)
def test_grids_of_cells(part: str, value: object, wrong: str) -> None:
    grid = OccupancyGrid(torch.ones(4, 5, 6, dtype=torch.bool), torch.zeros(3), 0.5)
    # Outside of the tests, nobody checks the types of what a plugin makes.
    object.__setattr__(grid, part, value)
    assert wrong_occupancy(grid) == [wrong]


def test_a_grid_is_on_one_device() -> None:
    cells = torch.ones(4, 5, 6, dtype=torch.bool)
    apart = OccupancyGrid(cells, torch.zeros(3, device="meta"), 0.5)
    assert wrong_occupancy(apart) == ["low: has device meta, not cpu"]


def test_color_inputs(rays: Rays) -> None:
    samples = ColorSamples(rays, torch.tensor([0, 1, 1]), torch.tensor([1.0, 2.0, 2.5]))
    assert wrong_color_input(samples, torch.zeros(3, 2)) == []
    assert wrong_color_input(samples, None) == ["returned None; return features of all 3 samples"]
    assert wrong_color_input(samples, torch.zeros(2, 2)) == [
        "features: has shape (2, 2), not (3, 2)"
    ]


def test_renderings(rendering: Callable[..., Rendering]) -> None:
    given = rendering(torch.tensor([0.25, 0.5]))
    assert wrong_rendering(given, replace(given, rgb=given.rgb * 2)) == []
    assert wrong_rendering(given, replace(given, rgb=given.rgb / 0)) == [
        "rgb: 6 of 6 values not finite, the first at [0, 0]: nan"
    ]
    # Colours that were left out are NaN, and stay so.
    without = replace(given, rgb=given.rgb * torch.nan)
    assert wrong_rendering(without, replace(without)) == []
    other = replace(given, rays=replace(given.rays))
    assert wrong_rendering(given, other) == ["rays: are not what they were; leave them"]


def test_unseen_poses() -> None:
    poses = torch.eye(3, 4).repeat(2, 1, 1)
    assert wrong_unseen_poses(None, 2, 3) == wrong_unseen_poses(poses, 2, 3) == []
    assert wrong_unseen_poses((poses, torch.tensor([0, 2])), 2, 3) == []
    assert wrong_unseen_poses((poses, torch.tensor([0, 3])), 2, 3) == [
        "views: must be numbers of training views, 0 to 2"
    ]
    assert wrong_unseen_poses(2 * poses, 2, 3) == ["poses: 2 of 2 are no rotations, off by up to 3"]
    mirrored = poses * torch.tensor([-1.0, 1.0, 1.0, 1.0])
    assert wrong_unseen_poses(mirrored, 2, 3) == [
        "poses: some are reflections; OpenGL axes are right-handed"
    ]
    assert wrong_unseen_poses(poses, 3, 3) == ["poses: has shape (2, 3, 4), not (3, 3, 4)"]


def test_metrics() -> None:
    assert wrong_metrics(None) == wrong_metrics({"gain": 1.0, "count": 2}) == []
    assert wrong_metrics(1.0) == ["returned of type float; return a dict of numbers by name"]
    assert wrong_metrics({"gain": torch.ones(())}) == [
        "metric 'gain' is of type Tensor, not a number; return gain=float(...)"
    ]


def test_encoders() -> None:
    assert wrong_encoder(None) == wrong_encoder(Encoder(4)) == []
    assert wrong_encoder(Encoder(None)) == [
        "has no attribute `width`: must be an integer, the number of its features"
    ]
    assert wrong_encoder(Encoder(5)) == ["output: has shape (2, 4), not (2, 5)"]
    assert wrong_encoder("grid") == ["returned of type str, not a torch module"]


def test_modules() -> None:
    assert wrong_module(None) == wrong_module(torch.nn.Linear(1, 1)) == []
    assert wrong_module(torch.nn.Parameter(torch.ones(1))) == [
        "returned of type Parameter, not a torch module; wrap parameters in an nn.Module"
    ]
    assert wrong_module(TrainedModule(torch.nn.Linear(1, 1), lr_scale=float("nan"))) == [
        "lr_scale=nan: must be finite and not negative"
    ]


def test_data_of_pixels() -> None:
    cameras = Cameras(
        5, 4, torch.eye(3, 4)[None], torch.ones(1, 2), torch.ones(1, 2), torch.zeros(1, 5)
    )
    box = torch.tensor([[-1.0] * 3, [1.0] * 3])
    photographs = Photographs(
        cameras=cameras, images=torch.zeros(1, 4, 5, 3), box=box, near=0.1, far=2.0, layout="object"
    )
    assert wrong_prepared(photographs, None) == []
    assert wrong_prepared(photographs, {"rank": torch.zeros(1, 4, 5, 7)}) == []
    assert wrong_prepared(photographs, {"rank": torch.zeros(1, 5, 4)}) == [
        "'rank' has shape (1, 5, 4), not (1, 4, 5, ...): a value for each pixel"
    ]
    assert wrong_prepared(photographs, {"rank": torch.zeros(1, 4, 5).double()}) == [
        "'rank' is in float64; return float32"
    ]
    assert wrong_prepared(photographs, torch.zeros(1, 4, 5)) == [
        "returned of type Tensor; return a dict of tensors (V, H, W, ...) by name"
    ]


def test_state() -> None:
    sound = {"count": 1, "mean": torch.ones(2), "names": ["a", None], "more": {"on": True}}
    assert wrong_state(sound) == []
    assert wrong_state(None) == ["state_dict(): is None, not a dict"]
    held = "a checkpoint holds tensors, numbers, text, lists and dicts of these"
    assert wrong_state({"more": [{1, 2}]}) == [f"state_dict()['more'][0]: is of type set; {held}"]
    assert wrong_state({3: 1}) == ["state_dict(): key 3 is of type int, not text"]
