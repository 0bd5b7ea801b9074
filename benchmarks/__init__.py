"""Commands that measure the figures of the documentation."""

from .kernels import discard_outdated

discard_outdated()
