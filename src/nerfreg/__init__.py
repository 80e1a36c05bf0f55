"""Few-shot NeRF regularization as plugins. The names below are all that a plugin needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
