"""Which liberties kernels take with floating point: any order of sums, but NaN and infinity keep their meaning."""

from lfcal.fastmath import square

__all__ = ["FAST", "square"]

FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
