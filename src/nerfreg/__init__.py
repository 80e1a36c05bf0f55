"""Few-shot NeRF regularization as plugins.

What the author of a plugin or of a script imports, and all that is promised to stay:

- the contract: `Regularizer`, from which every plugin derives; `hookimpl`, which marks its hooks;
  `TrainedModule` and `Schedule` for what it trains;
- what passes through the hooks: `SceneInfo`, `Photographs`, `Cameras`, `Needs`, `Rays`, `Samples`,
  `DensitySamples`, `ColorSamples`, `Rendering`, `Step` with its `FieldView`, and `EvaluatedView`;
- layers that stay in the fused kernels: `AffineLayer`, `Linear` and `WrappedLayer`;
- `OccupancyGrid`, which answers whether space is empty; `read_image`, for maps beside photographs;
- `NerfregError`, the one exception that a user is meant to read.

A name in this list, or a hook, is never removed or changed in meaning without having been
deprecated for one minor version. A deprecated name works as before and warns by a
`DeprecationWarning` that says what to write in its place. `nerfreg.hooks.HOOKS_VERSION` grows when
a hook specification changes, and a plugin states by `Regularizer.hook_versions` which it knows.

Everything else is imported from the module that defines it, such as
`nerfreg.config.compose.compose` and `nerfreg.runs.train.train` to run a training from a script.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # Types for checkers; at run time `__getattr__` finds these names when they are used.
    from nerfreg.errors import NerfregError
    from nerfreg.field.layers import AffineLayer, Linear, WrappedLayer
    from nerfreg.hooks import (
        ColorSamples,
        DensitySamples,
        EvaluatedView,
        FieldView,
        Needs,
        Rays,
        Regularizer,
        Rendering,
        Samples,
        Schedule,
        Step,
        TrainedModule,
        hookimpl,
    )
    from nerfreg.hooks.occupancy import OccupancyGrid
    from nerfreg.scenes.cameras import Cameras
    from nerfreg.scenes.images import read_image
    from nerfreg.scenes.scene import Photographs, SceneInfo

__version__ = "0.1.0"
__all__ = [
    "AffineLayer",
    "Cameras",
    "ColorSamples",
    "DensitySamples",
    "EvaluatedView",
    "FieldView",
    "Linear",
    "Needs",
    "NerfregError",
    "OccupancyGrid",
    "Photographs",
    "Rays",
    "Regularizer",
    "Rendering",
    "Samples",
    "SceneInfo",
    "Schedule",
    "Step",
    "TrainedModule",
    "WrappedLayer",
    "hookimpl",
    "read_image",
]
ELSEWHERE = {
    "NerfregError": "nerfreg.errors",
    "AffineLayer": "nerfreg.field.layers",
    "Linear": "nerfreg.field.layers",
    "WrappedLayer": "nerfreg.field.layers",
    "OccupancyGrid": "nerfreg.hooks.occupancy",
    "Cameras": "nerfreg.scenes.cameras",
    "read_image": "nerfreg.scenes.images",
    "Photographs": "nerfreg.scenes.scene",
    "SceneInfo": "nerfreg.scenes.scene",
}
"""The modules of those names that do not come from `nerfreg.hooks`."""


def __getattr__(name: str) -> Any:
    # torch takes seconds to import; `nerfreg --help` must not wait for it.
    if name not in __all__:
        raise AttributeError(f"module 'nerfreg' has no attribute '{name}'")
    return getattr(import_module(ELSEWHERE.get(name, "nerfreg.hooks")), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
