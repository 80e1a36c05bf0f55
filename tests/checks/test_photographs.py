"""Plugins that misread photographs, and what is said of them."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from nerfreg import Regularizer, hookimpl
from nerfreg.checks.photographs import PHOTOGRAPH_CASES
from nerfreg.checks.run import check_plugin

CASES = len(PHOTOGRAPH_CASES)


@dataclass
class Everywhere(Regularizer):
    """Between `first` and `last` everywhere."""

    first: float = 1.0
    last: float = 2.0

    @hookimpl
    def nerfreg_known_depth(self, photographs):
        return torch.tensor([self.first, self.last]).expand(*photographs.images.shape[:3], 2)


def test_right_intervals_pass(subject):
    report = check_plugin(subject(Everywhere), PHOTOGRAPH_CASES)
    assert report.failures == []
    assert len(report.spots) == CASES
    assert {spot.dtype for spot in report.spots} == {"float32"}


@dataclass
class Behind(Everywhere):
    first: float = -1.0


@dataclass
class Endless(Everywhere):
    last: float = float("inf")


@dataclass
class Turned(Everywhere):
    first: float = 3.0


@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        (Behind, "an interval begins behind the camera"),
        (Endless, "an interval has no end"),
        (Turned, "some intervals end before they begin"),
    ],
)
def test_wrong_intervals_fail_in_every_case(subject, plugin, message):
    report = check_plugin(subject(plugin), PHOTOGRAPH_CASES)
    assert len(report.failures) == CASES
    assert all(message in failure.message for failure in report.failures)


@dataclass
class Brightest(Everywhere):
    """Turns the photographs up."""

    @hookimpl
    def nerfreg_known_depth(self, photographs):
        photographs.images.mul_(2)


def test_photographs_must_stay_as_they_were(subject):
    report = check_plugin(subject(Brightest), PHOTOGRAPH_CASES)
    assert {failure.message for failure in report.failures} == {"images has been edited in place"}
    assert {failure.check for failure in report.failures} == {"contract"}


@dataclass
class TwoViews(Everywhere):
    """Takes it that there is a second view."""

    @hookimpl
    def nerfreg_known_depth(self, photographs):
        photographs.images[1]


def test_a_single_view_is_tried(subject):
    report = check_plugin(subject(TwoViews), PHOTOGRAPH_CASES)
    assert [failure.spot.case for failure in report.failures] == ["photos_one"]
    assert report.reproduction(report.failures[0].spot).endswith(
        "--case photos_one --dtype float32"
    )
