from __future__ import annotations

import pytest
import torch

from nerfreg import NerfregError
from nerfreg.testing import CASE_NAMES, make_rendering, make_step


@pytest.mark.parametrize("case", CASE_NAMES)
def test_every_case_is_rendered_as_asked_for(case: str) -> None:
    rendering = make_rendering(case, samples=5, dtype=torch.float64)
    assert rendering.t_edges.shape == (20, 6)
    assert rendering.rgb.dtype == rendering.tau.dtype == torch.float64


def test_density_is_a_leaf_and_colours_have_a_gradient() -> None:
    rendering = make_rendering()
    assert rendering.density.is_leaf
    [grad] = torch.autograd.grad(rendering.opacity.sum(), rendering.density, retain_graph=True)
    assert grad.all()
    [grad] = torch.autograd.grad(rendering.rgb.sum(), rendering.rgb)
    assert grad.all()


def test_weights_follow_from_density() -> None:
    rendering = make_rendering("two_walls", dtype=torch.float64)
    thickness = rendering.density * rendering.t_edges.diff(dim=1)
    before = thickness.cumsum(1) - thickness
    weights = torch.exp(-before) * (1 - torch.exp(-thickness))
    torch.testing.assert_close(rendering.weights, weights, atol=1e-12, rtol=1e-9)


def test_the_same_each_time() -> None:
    assert torch.equal(make_rendering("fog").weights, make_rendering("fog").weights)


def test_unknown_case() -> None:
    with pytest.raises(NerfregError, match=r"^case 'fogg': did you mean 'fog'\?$"):
        make_rendering("fogg")


def test_a_case_beyond_a_precision() -> None:
    with pytest.raises(NerfregError, match=r"^case 'thickness_1e30' has numbers that"):
        make_rendering("thickness_1e30", dtype=torch.float16)


def test_step_stands_where_it_is_asked_to() -> None:
    step = make_step(fraction=0.25)
    assert (step.index, step.total, step.fraction) == (250, 1000, 0.25)
    assert step.bounds == (2.0, 6.0)


def test_step_renders_the_case_again() -> None:
    rendering, step = make_rendering("wall_middle"), make_step("wall_middle")
    torch.testing.assert_close(step.rerender(rendering).rgb, rendering.rgb)
