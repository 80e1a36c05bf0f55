"""Rays against a box."""

from __future__ import annotations

import pytest
import torch

from nerfreg.scenes.clipping import clip_to_box

BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


@pytest.mark.parametrize(
    "origin, direction, expected",
    [
        ((0, 0, 3), (0, 0, -1), (2, 4)),  # through the middle, parallel to two axes
        ((0, 0, 0), (0, 0, 1), (0.1, 1)),  # from inside: begins at near
        ((0, 0, 3), (0, 0, 1), None),  # behind the camera
        ((0, 2, 3), (0, 0, -1), None),  # beside the box
        ((0, 0.999, 3), (0, 0, -1), (2, 4)),  # along a face
        ((3, 3, 3), (-1, -1, -1), (2 * 3**0.5, 4 * 3**0.5)),  # along the diagonal
        ((0, 0, 30), (0, 0, -1), None),  # beyond far
    ],
)
def test_entry_and_exit(origin: tuple, direction: tuple, expected: tuple | None) -> None:
    d = torch.nn.functional.normalize(torch.tensor([direction], dtype=torch.float32), dim=-1)
    near, far = clip_to_box(torch.tensor([origin], dtype=torch.float32), d, BOX, 0.1, 10.0)
    if expected is None:
        assert torch.equal(near, far)
    else:
        assert (near.item(), far.item()) == pytest.approx(expected)
