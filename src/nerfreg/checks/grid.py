"""All checks of one plugin, over cases, precisions and numbers of samples."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from nerfreg.checks import compositor
from nerfreg.checks.cases import CASES, SIZES, Case
from nerfreg.checks.inputs import DTYPES, Inputs
from nerfreg.checks.layers import LAYER_CASES, LayerCase, check_layers
from nerfreg.checks.losses import check_losses
from nerfreg.checks.photographs import PHOTOGRAPH_CASES, PhotographCase, check_known_depth
from nerfreg.checks.report import LIMITS, Report, Spot
from nerfreg.checks.subject import Subject
from nerfreg.checks.transforms import check_encoder_input, check_needs, check_ray_bounds


@dataclass(frozen=True)
class Grid:
    """What to run. samples: instead of every case's own numbers."""

    cases: tuple[Case, ...] = CASES
    layer_cases: tuple[LayerCase, ...] = LAYER_CASES
    photograph_cases: tuple[PhotographCase, ...] = PHOTOGRAPH_CASES
    dtypes: tuple[str, ...] = tuple(DTYPES)
    samples: int | None = None

    def points(self) -> Iterator[tuple[Case, Inputs, Spot]]:
        """Every case that its precision can express, at every size; half precision at one."""
        for case in self.cases:
            for dtype in self.dtypes:
                usual = case.sizes if dtype in LIMITS else SIZES[-1:]
                for samples in (self.samples,) if self.samples else usual:
                    inputs = case.build(samples)
                    if inputs.fits(DTYPES[dtype]):
                        yield case, inputs.to(DTYPES[dtype]), Spot(case.name, dtype, samples)

    def layer_points(self) -> Iterator[tuple[LayerCase, Spot]]:
        for case in self.layer_cases:
            for dtype in self.dtypes:
                if dtype in LIMITS:
                    yield case, Spot(case.name, dtype)

    def photograph_points(self) -> Iterator[tuple[PhotographCase, Spot]]:
        """Photographs are read as float32."""
        for case in self.photograph_cases if "float32" in self.dtypes else ():
            yield case, Spot(case.name, "float32")


def check_plugin(subject: Subject, grid: Grid) -> Report:
    """Everything about one plugin; whatever it raises is a failure of the case."""
    report = Report(subject.name, subject.hook_points, subject.overrides)
    points = subject.hook_points
    for index, (case, inputs, spot) in enumerate(grid.points()):
        if "needs" in points and index == 0:
            with _guarded(report, "contract", spot):
                check_needs(report, subject, inputs, spot)
        if "ray_bounds" in points:
            with _guarded(report, "contract", spot):
                check_ray_bounds(report, subject, inputs, spot)
        if "encoder_input" in points:
            with _guarded(report, "contract", spot):
                check_encoder_input(report, subject, inputs, spot)
        if "loss" in points:
            with _guarded(report, "value", spot):
                check_losses(report, subject, case, inputs, spot)
    if "layer" in points:
        for layer_case, spot in grid.layer_points():
            with _guarded(report, "value", spot):
                check_layers(report, subject, layer_case, spot)
    if "known_depth" in points:
        for photograph_case, spot in grid.photograph_points():
            with _guarded(report, "value", spot):
                check_known_depth(report, subject, photograph_case, spot)
    return report


def check_compositor(grid: Grid) -> Report:
    """The compositor, as if it were a plugin."""
    report = Report(compositor.NAME, ("core",))
    for case, inputs, spot in grid.points():
        with _guarded(report, "value", spot):
            compositor.check_compositing(report, case, inputs, spot)
    return report


@contextmanager
def _guarded(report: Report, check: str, spot: Spot) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # a stranger's plugin may raise anything
        report.judge(check, spot, [f"raises {type(error).__name__}: {error}".partition("\n")[0]])
