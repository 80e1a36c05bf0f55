from dataclasses import dataclass

from nerfreg import Regularizer


@dataclass
class Twin(Regularizer):
    """There are two of these."""
