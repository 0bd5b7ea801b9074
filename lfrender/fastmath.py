"""Which liberties kernels take with floating point: any order of sums, but NaN and infinity keep their meaning."""

__all__ = ["FAST"]

FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
