"""How good a field is: scores against photographs, pictures and videos.

Only the configuration is imported here, since it is read before torch is. Everything else is
imported from its module.
"""

from __future__ import annotations

from nerfreg.evaluation.config import EvalConfig, evaluation_times, subset_of

__all__ = ["EvalConfig", "evaluation_times", "subset_of"]
