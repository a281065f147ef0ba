"""Metrics against values worked out by hand, and against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from validation import metrics


def test_difference_of_the_same_infinity_is_zero() -> None:
    a = np.array([1.0, np.inf, -np.inf, np.inf, np.nan])
    b = np.array([3.5, np.inf, -np.inf, -np.inf, 1.0])
    found = metrics.difference(a, b)
    assert found[:4].tolist() == [2.5, 0.0, 0.0, math.inf]
    assert math.isnan(found[4])


def test_difference_of_integers_does_not_wrap() -> None:
    a, b = np.array([0, 255], np.uint8), np.array([255, 0], np.uint8)
    assert metrics.difference(a, b).tolist() == [255.0, 255.0]


def test_difference_of_two_precisions_is_taken_in_the_larger() -> None:
    third = np.array([1 / 3])
    assert metrics.difference(third, third.astype(np.float32))[0] == abs(1 / 3 - float(np.float32(1 / 3)))


def test_maximum() -> None:
    assert metrics.maximum(np.array([0.5, 2.0, 1.0])) == 2.0
    assert metrics.maximum(np.array([])) == 0.0


def test_rmse_by_hand() -> None:
    assert metrics.rmse(np.array([3.0, 4.0, 0.0, 0.0])) == pytest.approx(2.5)  # sqrt((9 + 16) / 4)
    assert metrics.rmse(np.array([])) == 0.0


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1.0, 1e160, 1e300])
def test_rmse_neither_overflows_nor_underflows(scale: float) -> None:
    assert metrics.rmse(np.array([3.0, 4.0, 0.0, 0.0]) * scale) == pytest.approx(2.5 * scale)


def test_rmse_of_an_infinite_error_is_infinite() -> None:
    assert metrics.rmse(np.array([0.0, np.inf])) == math.inf


def test_percentile_is_an_error_that_occurs() -> None:
    errors = np.arange(1000.0)
    assert metrics.percentile(errors) == 998.0  # 999 of 1000 pixels are at most that
    assert metrics.percentile(errors, 50) == 499.0
    assert metrics.percentile(np.array([])) == 0.0
    assert metrics.percentile(np.array([1.0, np.inf]), 100) == math.inf


def image(*levels: tuple[int, int, int]) -> np.ndarray:
    """An image of one row whose 8-bit levels are these: in the middle of each level, as quantisation truncates."""
    return (np.array([levels], dtype=np.float64) + 0.5) / 255


def test_levels_count_the_worst_channel_of_a_pixel() -> None:
    a = image((10, 20, 30), (10, 20, 30), (10, 20, 30), (0, 0, 0))
    b = image((10, 20, 30), (11, 19, 30), (10, 23, 31), (255, 0, 0))
    assert metrics.levels(a, b) == metrics.Levels(by_one=1, by_more=2, max=255)


def test_levels_clamp_as_the_image_file_does() -> None:
    assert metrics.levels(np.full((2, 2, 3), 1.5), np.full((2, 2, 3), 7.0)) == metrics.Levels(0, 0, 0)


def test_psnr_by_hand() -> None:
    a = np.zeros((2, 2, 3))
    assert metrics.psnr(a, a + 0.1) == pytest.approx(20.0)  # -20 log10(0.1)
    assert metrics.psnr(a, a + 0.001) == pytest.approx(60.0)
    assert metrics.psnr(a, a) == math.inf
    assert metrics.psnr(a + 1, a + 5) == math.inf  # both are white


def test_ciede2000_of_equal_images_is_zero() -> None:
    a = image((1, 2, 3), (200, 100, 50))
    assert metrics.ciede2000(a, a) == metrics.ColorDifference(0.0, 0.0)


def test_ciede2000_of_black_and_white_is_a_hundred() -> None:
    # L* runs from 0 to 100; the formula's weights of lightness, chroma and hue are 1 for two greys at L* mean 50.
    found = metrics.ciede2000(image((0, 0, 0), (9, 9, 9)), image((255, 255, 255), (9, 9, 9)))
    assert found.max == pytest.approx(100, abs=1e-3)
    assert found.mean == pytest.approx(50, abs=1e-3)


def test_ciede2000_weighs_every_pixel_once() -> None:
    # The same pair of colours in many pixels is converted once and counted as often as it occurs.
    a = np.repeat(image((200, 30, 30), (10, 10, 10)), 5, axis=0)
    b = np.repeat(image((30, 200, 30), (10, 10, 10)), 5, axis=0)
    found = metrics.ciede2000(a, b)
    assert found.mean == pytest.approx(found.max / 2)
    assert found.max > 50
