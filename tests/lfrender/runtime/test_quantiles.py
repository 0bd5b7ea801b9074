import numpy as np
import pytest

from lfrender.runtime.quantiles import quantile


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 10, 777])
def test_quantiles_are_those_of_numpy(n, kind):
    values = np.random.default_rng(n).normal(size=n).astype(kind)
    for share in (0.0, 0.1, 0.25, 0.9, 1.0):
        assert quantile(values, share) == pytest.approx(np.quantile(values.astype(float), share), abs=1e-6)


def test_infinite_values_are_only_counted():
    assert quantile(np.array([1.0, np.inf, 2.0, 3.0, np.inf]), 0.5) == 3.0
    assert quantile(np.array([1.0, 2.0, np.inf]), 0.5) == 2.0
