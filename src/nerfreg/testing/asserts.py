"""Assertions on losses. What fails is said in an AssertionError: what was expected, and found."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from nerfreg.checks.accuracy import not_finite_gradients, relative_error, wrong_gradient
from nerfreg.checks.cases import SIZES
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import DTYPES, Inputs
from nerfreg.checks.report import LIMITS
from nerfreg.checks.subject import Subject
from nerfreg.testing.cases import CASE_NAMES, SAMPLES, case_named, inputs_of
from nerfreg.testing.losses import Loss, subject_of
from nerfreg.training.contracts import wrong_terms

FACTOR = 2.0**10
"""By how much a scene grows: a power of two, so that growing rounds nothing."""

SHOWN = 5
"""How many faults a message lists."""


def assert_finite(
    loss: Loss,
    case: str | None = None,
    dtype: torch.dtype | None = None,
    samples: int | None = None,
) -> None:
    """Assert that value and gradient are finite, on stiff and extreme rays.

    Args:
        loss: A plugin, or a function of what a rendering has.
        case: Name of a case; None: all of them.
        dtype: One precision; None: float32 and float64, and both half precisions at one size.
        samples: A number of samples on a ray; None: those of `nerfreg check`, 1 and 2 among them.

    Raises:
        AssertionError: A term or a gradient is not finite; names case, precision, size and term.
        NerfregError: There is no such case, or what the loss returns is no scalar.
    """
    subject, wrong = subject_of(loss), list[str]()
    dtypes = [name for name, known in DTYPES.items() if dtype in (None, known)]
    for name in CASE_NAMES if case is None else (case,):
        for spot, inputs in case_named(name).points(dtypes, samples):
            # What only very many samples can show takes `nerfreg check` a while.
            if samples is None and spot.samples not in SIZES:
                continue
            driver = Driver(subject, inputs)
            lines = _not_finite(driver, driver.terms(driver.step()))
            where = f"case '{name}', {spot.dtype}, {spot.samples} samples a ray"
            wrong += [f"{where}: {line}" for line in lines]
    _fail(wrong, "finite values and gradients")


def assert_gradients(
    loss: Loss, case: str = "fog", samples: int = SAMPLES, fraction: float = 0.5
) -> None:
    """Assert that autograd agrees with finite differences, in float64.

    What the loss detaches is held constant.

    Args:
        loss: A plugin, or a function of what a rendering has.
        case: Name of a case on which the loss is smooth.
        samples: Number of samples on a ray.
        fraction: Share of the run that is done, for a loss that depends on the step.

    Raises:
        AssertionError: A term has no gradient, or another one than finite differences have it.
        NerfregError: There is no such case.
    """
    subject, inputs = subject_of(loss), inputs_of(case, samples, torch.float64)
    wrong = []
    for name, value in _terms(subject, inputs, fraction, case).items():
        if value.requires_grad:
            lines = wrong_gradient(partial(_term, subject, name, fraction), inputs)
        else:
            lines = ["has no gradient: nothing that it is computed from requires one"]
        wrong += [f"case '{case}': term '{name}': {line}" for line in lines]
    _fail(wrong, "the gradient of finite differences")


def assert_scale_free(
    loss: Loss, case: str = "fog", samples: int = SAMPLES, fraction: float = 0.5
) -> None:
    """Assert that the loss stays the same where all distances are 1024 times as large.

    Densities are a 1024th then, so that optical thickness and weights stay the same.

    Args:
        loss: A plugin, or a function of what a rendering has.
        case: Name of a case.
        samples: Number of samples on a ray.
        fraction: Share of the run that is done, for a loss that depends on the step.

    Raises:
        AssertionError: A term has changed; names both values.
        NerfregError: There is no such case.
    """
    subject, inputs = subject_of(loss), inputs_of(case, samples, torch.float64)
    before = _terms(subject, inputs, fraction, case)
    after = _terms(subject, inputs.scaled(FACTOR), fraction, case)
    wrong = [
        f"case '{case}': term '{name}': {value.item():.7g} became {after[name].item():.7g} "
        f"where all distances are {FACTOR:g} times as large"
        for name, value in before.items()
        if not relative_error(after[name], value, "float64") <= LIMITS["float64"]
    ]
    _fail(wrong, "a loss that does not depend on the unit of length")


def _not_finite(driver: Driver, terms: dict[str, Tensor]) -> list[str]:
    wrong = wrong_terms(terms)
    if wrong:
        return wrong
    return [
        line
        for name, value in terms.items()
        if value.requires_grad
        for line in not_finite_gradients(f"gradient of '{name}' by ", value, driver.leaves)
    ]


def _terms(subject: Subject, inputs: Inputs, fraction: float, case: str) -> dict[str, Tensor]:
    driver = Driver(subject, inputs)
    terms = driver.terms(driver.step(fraction))
    # A test of no term at all would hold whatever the plugin does.
    _fail([] if terms else [f"case '{case}': no term was returned"], "a loss")
    _fail([f"case '{case}': {line}" for line in wrong_terms(terms)], "finite scalars")
    return terms


def _term(
    subject: Subject, name: str, fraction: float, inputs: Inputs
) -> tuple[Tensor, list[Tensor]]:
    driver = Driver(subject, inputs)
    return driver.terms(driver.step(fraction))[name], [driver.density, driver.colors]


def _fail(wrong: Sequence[str], expected: str) -> None:
    if not wrong:
        return
    rest = [f"and {len(wrong) - SHOWN} more"] if len(wrong) > SHOWN else []
    raise AssertionError("\n".join([f"expected {expected}, found", *wrong[:SHOWN], *rest]))
