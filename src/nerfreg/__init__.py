"""Few-shot NeRF regularization as plugins.

What the author of a plugin or of a script imports:

- the contract: `Regularizer`, from which every plugin derives; `hookimpl`, which marks its hooks;
- what passes through the hooks: `Needs`, `Rays`, `Samples`, `Rendering`, `Step`, and the training
  views as `Photographs`;
- `NerfregError`, the one exception that a user is meant to read.

Everything else is imported from the module that defines it, such as
`nerfreg.config.compose.compose` and `nerfreg.runs.train.train` to run a training from a script.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # Types for checkers; at run time `__getattr__` finds these names when they are used.
    from nerfreg.errors import NerfregError
    from nerfreg.hooks import Needs, Rays, Regularizer, Rendering, Samples, Step, hookimpl
    from nerfreg.scenes.scene import Photographs

__version__ = "0.1.0"
__all__ = [
    "Needs",
    "NerfregError",
    "Photographs",
    "Rays",
    "Regularizer",
    "Rendering",
    "Samples",
    "Step",
    "hookimpl",
]


def __getattr__(name: str) -> Any:
    # torch takes seconds to import; `nerfreg --help` must not wait for it.
    if name not in __all__:
        raise AttributeError(f"module 'nerfreg' has no attribute '{name}'")
    if name == "NerfregError":
        from nerfreg.errors import NerfregError

        return NerfregError
    from nerfreg import hooks

    return getattr(hooks, name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
