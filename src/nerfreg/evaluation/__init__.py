"""How good a field is: scores against photographs, pictures, videos, and the files that hold them.

Light on purpose: the configuration is read before torch is imported. Everything else is imported from its module.
"""

from __future__ import annotations

from nerfreg.evaluation.config import EvalConfig, evaluation_times, subset_of

__all__ = ["EvalConfig", "evaluation_times", "subset_of"]
