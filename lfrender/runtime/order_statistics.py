"""Places in ordered values, for kernels: those of Numba and NumPy cost several times as much to compile."""

from __future__ import annotations

from numba import njit

__all__ = ["count_below", "median_of", "select"]


@njit
def count_below(ordered, value):
    """How many of the `ordered` values (n,) are below a value; NaN counts as the largest of all."""
    first, beyond = 0, len(ordered)
    while first < beyond:
        middle = (first + beyond) // 2
        if ordered[middle] < value:
            first = middle + 1
        else:
            beyond = middle
    return first


@njit(fastmath=False)
def select(values, place):
    """The value at a `place` in the order of `values` (n,), which are reordered: smaller ones before it, larger after.

    Hoare's selection (Communications of the ACM 4, 1961).
    """
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) // 2]
        left, right = low, high
        while left <= right:
            while values[left] < pivot:
                left += 1
            while pivot < values[right]:
                right -= 1
            if left <= right:
                values[left], values[right] = values[right], values[left]
                left += 1
                right -= 1
        if place <= right:
            high = right
        elif place >= left:
            low = left
        else:
            break
    return values[place]


@njit(fastmath=False)
def median_of(values):
    """Median of `values` (n,), n at least 1 and none NaN, which are reordered."""
    half = len(values) // 2
    upper = select(values, half)
    if len(values) % 2:
        return upper
    lower = values[0]
    for k in range(1, half):
        lower = max(lower, values[k])
    return 0.5 * (lower + upper)
