from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import pytest
import torch

from nerfreg import Regularizer, hookimpl
from nerfreg.checks.cases import CASES
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import DTYPES, cast
from nerfreg.checks.subject import Subject
from nerfreg.registry import PluginInfo
from nerfreg.rendering.compositing import composite

CASE = next(case for case in CASES if case.name == "thickness_1")
PARTS = ("density", "tau", "log_transmittance", "weights", "opacity", "depth", "rgb", "colored")


@dataclass
class Shift(Regularizer):
    """Moves one kind of input by a constant."""

    positions: float = 0.0
    t: float = 0.0
    directions: float = 0.0

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self):
        samples = yield
        return replace(
            samples,
            positions=samples.positions + self.positions,
            t=samples.t + self.t,
            directions=samples.directions + self.directions,
        )

    @hookimpl
    def nerfreg_contract(self):
        return {"unmoved": self.positions}


def make_driver(plugin: Regularizer, dtype: torch.dtype = torch.float64) -> Driver:
    values = [f"reg.shift.{key}={value}" for key, value in asdict(plugin).items()]
    return Driver(
        Subject.of(PluginInfo("shift", "tests", "0", Shift), values), cast(CASE.build(48), dtype)
    )


def test_rendering_is_what_the_compositor_makes_of_the_leaves():
    driver = make_driver(Shift())
    inputs = driver.inputs
    colors = torch.where(driver.rendering.colored[..., None], inputs.colors, 0.0)
    expected = composite(inputs.density, colors, inputs.t_edges, inputs.rays.background)
    for part in ("tau", "log_transmittance", "weights", "opacity", "depth", "rgb"):
        torch.testing.assert_close(getattr(driver.rendering, part), getattr(expected, part))


def test_rendering_again_changes_nothing_while_nothing_is_perturbed():
    driver = make_driver(Shift())
    again = driver.step().rerender(driver.rendering)
    for part in PARTS:
        assert torch.equal(getattr(again, part), getattr(driver.rendering, part)), part


@pytest.mark.parametrize("moved", ["positions", "t", "directions"])
def test_perturbation_reaches_the_rendering(moved):
    driver = make_driver(Shift(**{moved: 0.1}))
    again = driver.step().rerender(driver.rendering)
    assert not torch.allclose(again.rgb, driver.rendering.rgb, rtol=1e-6)
    # directions act on colour alone
    assert torch.equal(again.density, driver.rendering.density) == (moved == "directions")
    again.rgb.sum().backward()
    assert driver.density.grad.abs().min() > 0


def test_contract_is_asked_while_rendering_again():
    driver = make_driver(Shift(positions=0.25))
    assert driver.broken == {}
    driver.step().rerender(driver.rendering)
    assert driver.broken == {"unmoved": 0.25}


@pytest.mark.parametrize("dtype", DTYPES.values(), ids=str)
def test_rendering_has_the_precision_of_its_inputs(dtype):
    rendering = make_driver(Shift(), dtype).rendering
    assert {getattr(rendering, part).dtype for part in PARTS} == {dtype, torch.bool}
    assert rendering.log_weights.isfinite().all()


def test_randomness_begins_anew_with_every_step():
    driver = make_driver(Shift())
    first, second = (torch.rand(3, generator=driver.step().generator) for _ in range(2))
    assert torch.equal(first, second)


def test_steps_end_where_the_run_does():
    driver = make_driver(Shift())
    assert [(driver.step(at).index, driver.step(at).fraction) for at in (0.0, 0.5, 2.0)] == [
        (0, 0.0),
        (500, 0.5),
        (2000, 1.0),
    ]
