from __future__ import annotations

import mpmath
from nerfreg_plugins.references.full_geometry import full_geometry_loss_of_thickness


def test_by_hand(close):
    # Half and a quarter of the light pass: (1/4 + 1/16) / 2.
    tau = [[mpmath.log(2), mpmath.mpf(0)], [mpmath.log(2), mpmath.log(2)]]
    assert close(full_geometry_loss_of_thickness(tau), 0.15625)
