from dataclasses import dataclass
from nerfreg import Regularizer, hookimpl

@dataclass
class BinaryOpacity(Regularizer):
    """Opacity is 0 or 1 (Lombardi et al. 2019)."""
    weight: float = 1e-3
    sharpness: float = 1.0

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        o = rendering.opacity                      # (R,)
        return {"binary_opacity": (o * (1 - o)).pow(self.sharpness).mean()}
