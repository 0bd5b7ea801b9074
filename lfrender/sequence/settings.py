"""Tuned values of sequences: which frames are compared with which, and how many are worked on at once."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "SequenceSettings"]


@dataclass(frozen=True)
class SequenceSettings:
    """Tuned values of `render_frames` and `render_frames_on`."""

    segment: int = 30  # [frames] from one key frame to the next; set by hand
    group: int = 5  # [frames] that are compared with the same one, the first of them; set by hand
    at_once: int = 2  # [frames] worked on at once on this machine ...
    shared_bytes: int = (
        1 << 26
    )  # [bytes] ... unless a flat has more: then one keeps all cores busy, and memory is short
    groups_ahead: int = 2  # groups in flight for each thread of a cluster: none is idle, and videos fit into memory
    least_ahead: int = 4  # groups in flight at least: with fewer, workers are idle at the end of a segment
    retries: int = 3  # of a task whose worker was lost


#: The values that are used unless others are given.
DEFAULT = SequenceSettings()
