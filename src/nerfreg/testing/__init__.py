"""What the tests of a plugin need: renderings of every kind, assertions, and short trainings.

Nothing here has to be installed or registered, and nothing but `nerfreg.testing.fixtures` needs
pytest. A *loss* is a plugin, or a plain function whose arguments are named like what they are: any
attribute of `Rendering` or of its `Rays`, or `rendering` and `step` themselves.
"""

from nerfreg.testing.asserts import assert_finite, assert_gradients, assert_scale_free
from nerfreg.testing.cases import CASE_NAMES, make_rendering, make_step
from nerfreg.testing.losses import Loss
from nerfreg.testing.training import ShortRun, run_steps, small_scene

__all__ = [
    "CASE_NAMES",
    "Loss",
    "ShortRun",
    "assert_finite",
    "assert_gradients",
    "assert_scale_free",
    "make_rendering",
    "make_step",
    "run_steps",
    "small_scene",
]
