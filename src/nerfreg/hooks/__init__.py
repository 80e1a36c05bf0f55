"""The hook points, and the few dataclasses that pass through them.

`nerfreg.hooks.specs` is the page to read before writing a regularizer.
"""

from nerfreg.hooks.evaluated import EvaluatedView
from nerfreg.hooks.occupancy import OccupancyGrid
from nerfreg.hooks.rays import NEIGHBORS, Needs, Rays
from nerfreg.hooks.regularizer import CHANGED, HOOKS_VERSION, Regularizer, TrainedModule
from nerfreg.hooks.samples import ColorSamples, DensitySamples, Rendering, Samples
from nerfreg.hooks.schedule import Schedule
from nerfreg.hooks.specs import (
    ALWAYS_IN_EVALUATION,
    IN_EVALUATION_IF_ASKED,
    PROJECT,
    HookSpecs,
    hookimpl,
)
from nerfreg.hooks.step import FieldView, RayRenderer, Step, TableLevel, Teacher

__all__ = [
    "ALWAYS_IN_EVALUATION",
    "CHANGED",
    "HOOKS_VERSION",
    "IN_EVALUATION_IF_ASKED",
    "NEIGHBORS",
    "PROJECT",
    "ColorSamples",
    "DensitySamples",
    "EvaluatedView",
    "FieldView",
    "HookSpecs",
    "Needs",
    "OccupancyGrid",
    "RayRenderer",
    "Rays",
    "Regularizer",
    "Rendering",
    "Samples",
    "Schedule",
    "Step",
    "TableLevel",
    "Teacher",
    "TrainedModule",
    "hookimpl",
]
