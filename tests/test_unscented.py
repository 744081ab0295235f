"""The unscented transform, the tangent line and the quadrature against numbers that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bms_ukf import unscented


def square(x: np.ndarray) -> np.ndarray:
    return x[:, 0] ** 2


def distance(x: np.ndarray) -> np.ndarray:
    return np.hypot(x[:, 0], x[:, 1])


def bearing(x: np.ndarray) -> np.ndarray:
    return np.arctan2(x[:, 1], x[:, 0])


def dense(f, mean: np.ndarray, P: np.ndarray) -> tuple[float, float]:
    """Mean and variance of f of two numbers on a grid of +-8 sigma both ways."""
    xi = np.linspace(-8, 8, 801)
    grid = np.stack(np.meshgrid(xi, xi), axis=-1).reshape(-1, 2)
    weights = np.exp(-(grid**2).sum(axis=1) / 2)
    weights /= weights.sum()
    values = f(mean + grid @ np.linalg.cholesky(P).T)
    expected = weights @ values
    return float(expected), float(weights @ (values - expected) ** 2)


def test_the_points_and_weights_of_a_gaussian_2_4_with_lambda_2():
    weights = unscented.scaled(1, alpha=1, beta=0, kappa=2)
    points = unscented.sigma_points(2, 4, weights.spread)
    assert points[:, 0] == pytest.approx([2, 5.4641016, -1.4641016], abs=1e-7)
    assert weights.w_mean == pytest.approx([2 / 3, 1 / 6, 1 / 6], abs=1e-15)


@pytest.mark.parametrize("beta", [0.0, 2.0])
def test_the_square_of_a_gaussian_2_4_has_mean_8_and_the_variance_its_weights_imply(beta):
    weights = unscented.scaled(1, alpha=1, beta=beta, kappa=2)
    mean, variance = unscented.transform(square, 2, 4, weights)
    # The points' values less 8 are -4, 8 + s and 8 - s with s^2 = 4 * 2^2 * 12.
    implied = weights.w_cov[0] * 16 + (2 * 64 + 2 * 192) / 6
    assert mean.item() == pytest.approx(8, abs=1e-14)
    assert variance.item() == pytest.approx(implied, rel=1e-14)
    assert implied == pytest.approx(96 + 16 * beta)  # 96 is the true one: 4 mu^2 sigma^2 + 2 sigma^4
    line, line_variance = unscented.tangent_line(square, 2, 4)
    assert line.item() == 4
    assert line_variance.item() == pytest.approx(64, rel=1e-9)


def test_the_quadrature_is_exact_for_the_square():
    mean, variance = unscented.quadrature(square, 2, 2)
    assert [mean.item(), variance.item()] == pytest.approx([8, 96], rel=1e-12)


def test_the_error_of_the_tangent_line_grows_with_the_variance_and_that_of_sigma_points_does_not():
    sigmas = np.geomspace(1e-3, 1e3, 13)
    weights = unscented.scaled(1, kappa=2)
    errors = np.empty((2, len(sigmas)))
    for k, sigma in enumerate(sigmas):
        true, _ = unscented.quadrature(square, 2, sigma)
        errors[0, k] = true.item() - unscented.tangent_line(square, 2, sigma**2)[0].item()
        errors[1, k] = unscented.transform(square, 2, sigma**2, weights)[0].item() / (4 + sigma**2) - 1
    assert errors[0] == pytest.approx(sigmas**2, rel=1e-7)
    assert np.abs(errors[1]).max() < 1e-15


@pytest.mark.parametrize("alpha", [1.0, 1e-3])
def test_a_linear_function_is_transformed_exactly(alpha):
    A = np.array([[1.0, 2.0, -1.0], [0.5, 0.0, 3.0]])
    mean, root = np.array([1.0, -2.0, 0.5]), np.array([[1.0, 0, 0], [0.3, 0.5, 0], [-0.2, 0.1, 2.0]])
    P = root @ root.T
    results = [
        unscented.transform(lambda x: x @ A.T, mean, P, unscented.scaled(3, alpha)),
        unscented.tangent_line(lambda x: x @ A.T, mean, P),
    ]
    for transformed, covariance in results:
        assert transformed == pytest.approx(A @ mean, abs=1e-8)
        np.testing.assert_allclose(covariance, A @ P @ A.T, rtol=1e-8)


# At 3.6 m, known to 0.7 m along the view and 0.3 m across, or the other way round.
MEAN = np.array([3.0, 2.0])


@pytest.mark.parametrize("sigmas", [(0.7, 0.3), (0.3, 0.7)], ids=["long", "broad"])
@pytest.mark.parametrize("f", [distance, bearing])
def test_range_and_bearing_come_out_ten_times_closer_than_by_the_tangent_line(f, sigmas):
    along = math.atan2(2.0, 3.0) + 0.4  # turned, so that the bearing's second derivative does count
    turn = np.array([[math.cos(along), -math.sin(along)], [math.sin(along), math.cos(along)]])
    P = turn @ np.diag(sigmas) ** 2 @ turn.T
    true_mean, true_variance = dense(f, MEAN, P)
    mean, variance = (value.item() for value in unscented.transform(f, MEAN, P, unscented.scaled(2, beta=2, kappa=1)))
    line, _ = unscented.tangent_line(f, MEAN, P)
    assert abs(line.item() - true_mean) > 0.002
    assert abs(mean - true_mean) < 0.1 * abs(line.item() - true_mean)
    assert variance == pytest.approx(true_variance, rel=0.1)


def test_weights_that_would_put_the_points_nowhere_are_refused():
    with pytest.raises(ValueError, match="expected above 0"):
        unscented.scaled(3, kappa=-3.0)
