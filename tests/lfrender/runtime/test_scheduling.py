import numpy as np
import pytest

from lfrender.runtime.scheduling import plan_chunks


def order(n):
    count, length, stride = plan_chunks(n)
    begins = [part * stride % count * length for part in range(count)]
    return [np.arange(begin, min(begin + length, n)) for begin in begins]


@pytest.mark.parametrize("n", [0, 1, 2, 31, 32, 33, 63, 64, 100, 9027])
def test_chunks_visit_every_item_once(n):
    visited = np.concatenate(order(n)) if n else np.empty(0)
    np.testing.assert_array_equal(np.sort(visited), np.arange(n))


def test_two_threads_share_a_cluster():
    n = 9000
    cluster = np.zeros(n, bool)
    cluster[5000:7500] = True
    visited = order(n)
    half = np.concatenate(visited[: len(visited) // 2])
    assert cluster[half].sum() == pytest.approx(1250, abs=300)
