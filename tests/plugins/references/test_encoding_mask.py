from __future__ import annotations

from nerfreg_plugins.references.encoding_mask import fractional_features, whole_features


def test_by_hand(numbers):
    assert fractional_features(30, numbers("0.25")) == 7.5
    assert whole_features(30, numbers("0.25")) == 7
    assert whole_features(32, numbers("0.25")) == 8
