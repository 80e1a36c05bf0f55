"""Each assertion holds for what is right, and fails in the right words for what is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from nerfreg_plugins.distortion import Distortion, distortion_loss
from torch import Tensor

from nerfreg import NerfregError, Regularizer, Rendering, Step, hookimpl
from nerfreg.testing import assert_finite, assert_gradients, assert_scale_free


class DoubledGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, grad):
        return 2 * grad


@dataclass
class Late(Regularizer):
    """The mean opacity, from a share of the run on."""

    after: float = 0.75

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        return {"late": rendering.opacity.mean()} if step.fraction >= self.after else {}


@pytest.mark.parametrize("check", [assert_finite, assert_gradients, assert_scale_free])
@pytest.mark.parametrize("loss", [Distortion(), distortion_loss], ids=["plugin", "function"])
def test_what_is_right_passes(check, loss) -> None:
    check(loss)


def test_infinite_gradient_of_empty_rays() -> None:
    with pytest.raises(AssertionError) as failure:
        assert_finite(lambda opacity: opacity.sqrt().mean(), "empty", torch.float32, samples=2)
    expected = (
        "expected finite values and gradients, found\ncase 'empty', float32, 2 samples a ray: "
        "gradient of 'loss' by density: 40 of 40 values not finite, the first at [0, 0]: inf"
    )
    assert str(failure.value) == expected


def test_every_case_is_tried_and_the_message_stays_short() -> None:
    with pytest.raises(AssertionError, match=r"and \d+ more$") as failure:
        assert_finite(lambda opacity: (opacity / 0).mean())
    assert len(str(failure.value).splitlines()) == 7


def test_wrong_gradient() -> None:
    with pytest.raises(AssertionError, match=r"'loss': derivative is \S+ by autograd, \S+ by fin"):
        assert_gradients(lambda depth: DoubledGradient.apply(depth).mean())


def test_missing_gradient() -> None:
    with pytest.raises(AssertionError, match=r"term 'loss': has no gradient"):
        assert_gradients(lambda depth: depth.detach().mean())


def test_what_is_detached_is_a_constant() -> None:
    assert_gradients(lambda depth, opacity: (depth * opacity.detach()).mean())


def test_a_loss_with_a_unit() -> None:
    with pytest.raises(AssertionError, match=r"became \S+ where all distances are 1024 times"):
        assert_scale_free(lambda depth: depth.mean())


def test_a_loss_without_terms_does_not_pass() -> None:
    with pytest.raises(AssertionError, match="case 'fog': no term was returned"):
        assert_gradients(Late())
    assert_gradients(Late(), fraction=0.8)


def test_configuration_of_an_instance_counts() -> None:
    assert_gradients(Late(after=0.25))


def test_a_vector_is_no_term() -> None:
    with pytest.raises((NerfregError, AssertionError), match=r"term 'loss' has shape \(20,\)"):
        assert_scale_free(lambda opacity: opacity)


def test_an_argument_that_means_nothing() -> None:
    with pytest.raises(NerfregError, match=r"the argument 'opacities'; did you mean 'opacity'\?"):
        assert_finite(lambda opacities: opacities.mean())


def test_arguments_with_a_default_are_left_alone() -> None:
    def scaled(opacity: Tensor, weights: float = 2.0) -> Tensor:
        return weights * opacity.mean()

    assert_gradients(scaled)


def test_a_class_is_no_plugin() -> None:
    with pytest.raises(NerfregError, match=r"plugins are instances$"):
        assert_gradients(Distortion)
