from __future__ import annotations

import pytest
import torch

from nerfreg.bench.inputs import INPUTS, PATCH

NAMED = {given.name: given for given in INPUTS}


@pytest.mark.parametrize("given", INPUTS, ids=lambda given: given.name)
@pytest.mark.parametrize("samples", [8, 64])
def test_rays_form_patches_that_share_t(given, samples: int) -> None:
    rendering = given.rendering(32, samples)
    assert rendering.weights.shape == (32, samples)
    assert (rendering.t_edges[:, 0] == given.near).all()
    assert (rendering.t_edges[:, -1] == given.far).all()
    assert (rendering.t_edges.diff(dim=1) > 0).all()
    assert rendering.visible.all()
    patches, neighbors = rendering.rays.patches, rendering.rays.neighbors
    assert patches.shape == (2, PATCH, PATCH)
    # Three pairs in each of four rows of two patches, side by side.
    assert neighbors.shape == (24, 2)
    assert (neighbors[:, 1] - neighbors[:, 0] == 1).all()
    assert torch.equal(rendering.t_edges[neighbors[:, 0]], rendering.t_edges[neighbors[:, 1]])
    assert not torch.equal(rendering.weights[neighbors[:, 0]], rendering.weights[neighbors[:, 1]])
    assert torch.equal(rendering.rays.groups, patches.flatten() // PATCH**2)


def test_packed_rays_are_the_benign_ones_elsewhere() -> None:
    benign, packed = (NAMED[name].rendering(16, 32, torch.float64) for name in ("benign", "packed"))
    torch.testing.assert_close(packed.tau, benign.tau, rtol=1e-6, atol=0.0)


def test_weights_of_peaked_rays_are_one_number() -> None:
    weights = NAMED["peaked"].rendering(16, 64).weights
    assert (weights.max(dim=1).values > 0.999).all()


def test_weights_underflow_but_their_logarithms_do_not() -> None:
    # Behind three walls of 30 light has gone down to exp(-90), less than the smallest normal
    # float32.
    rendering = NAMED["underflow"].rendering(16, 64)
    vanished = rendering.weights == 0
    assert vanished.any(dim=1).all()
    assert rendering.log_weights[vanished].isfinite().all()


def test_every_precision_gets_the_same_rays() -> None:
    single, double = (
        NAMED["benign"].rendering(16, 8, dtype) for dtype in (torch.float32, torch.float64)
    )
    torch.testing.assert_close(single.weights.double(), double.weights, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", ["peaked", "packed"])
def test_what_is_known_of_depth_holds_the_surface(name: str) -> None:
    given = NAMED[name]
    rendering = given.rendering(32, 64, torch.float64)
    first, last = rendering.rays.known_depth.unbind(1)
    known = first.isfinite()
    assert known.tolist() == [ray % 4 > 0 for ray in range(32)]
    assert torch.equal(known, last.isfinite())
    torch.testing.assert_close(
        (last - first)[known], torch.full((24,), 0.1 * (given.far - given.near)).double()
    )
    # The middle of the interval that most light is lost in is next to where the surface was put.
    place = rendering.t.gather(1, rendering.tau.argmax(dim=1, keepdim=True)).squeeze(1)
    assert ((place > first) & (place < last))[known].all()
