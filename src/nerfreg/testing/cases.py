"""Renderings and steps of the cases of `nerfreg check`."""

from __future__ import annotations

from dataclasses import replace

import torch

from nerfreg.checks.cases import CASES, Case
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import Inputs, cast
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer, Rendering, Step
from nerfreg.testing.losses import Loss, subject_of

CASE_NAMES = tuple(case.name for case in CASES)
"""The names of all cases; `nerfreg check --list` says what each of them is."""

SAMPLES = 48
"""Samples on a ray, if nothing else is asked for."""

STEPS = 1000
"""Length of the run that the steps belong to."""


def case_named(name: str) -> Case:
    """Return a case.

    Raises:
        NerfregError: There is none of this name.
    """
    if name not in CASE_NAMES:
        raise NerfregError(f"case '{name}': {nearest(name, CASE_NAMES)}")
    return next(case for case in CASES if case.name == name)


def inputs_of(case: str, samples: int, dtype: torch.dtype) -> Inputs:
    """Return the rays of a case, in a precision.

    Raises:
        NerfregError: There is no such case, or its numbers are infinite in this precision.
    """
    inputs = cast(case_named(case).build(samples), dtype)
    if not (inputs.density.isfinite().all() and inputs.t_edges.isfinite().all()):
        raise NerfregError(f"case '{case}' has numbers that {dtype} cannot express")
    return inputs


def make_rendering(
    case: str = "fog", samples: int = SAMPLES, dtype: torch.dtype = torch.float32
) -> Rendering:
    """Render the rays of a case of `nerfreg check`, by the compositor of every run.

    There are a patch of 4 x 4 pixels (2 x 2 from 256 samples on), its pairs of neighbours, and
    another of 2 x 2 from an unseen pose; every case is the same each time. In float32 and float64,
    `density` is a leaf that requires a gradient. `rgb` has one by colours that do.

    Args:
        case: Name of the case, one of `CASE_NAMES`.
        samples: N, the number of samples on a ray.
        dtype: Precision of all its floating point tensors.

    Raises:
        NerfregError: There is no such case, or its numbers are infinite in this precision.
    """
    return Driver(subject_of(Regularizer()), inputs_of(case, samples, dtype)).rendering


def make_step(
    case: str = "fog",
    samples: int = SAMPLES,
    dtype: torch.dtype = torch.float32,
    fraction: float = 0.5,
    loss: Loss | None = None,
) -> Step:
    """Return the step of a run of 1000 in which a case is rendered.

    `step.rerender` repeats the rendering of the same case, size and precision, and asks the plugin
    for what the encoders are to see.

    Args:
        case: Name of the case, one of `CASE_NAMES`.
        samples: N, the number of samples on a ray.
        dtype: Precision of the rendering.
        fraction: Share of the run that is done, 0 to 1.
        loss: The plugin whose hooks take part when the rays are rendered again.

    Raises:
        NerfregError: There is no such case, or its numbers are infinite in this precision.
    """
    subject = subject_of(Regularizer() if loss is None else loss)
    step = Driver(subject, inputs_of(case, samples, dtype)).step(fraction)
    return replace(step, index=round(fraction * STEPS), total=STEPS, fraction=fraction)
