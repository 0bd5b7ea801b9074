"""Values cached with their owner."""

from __future__ import annotations

import gc

from lfrender.runtime.cache import cached


def test_a_cached_value_is_made_once_and_goes_with_its_owner():
    class Owner:
        pass

    made = []
    owner = Owner()
    for _ in range(3):
        assert cached(owner, "a", lambda: made.append(0) or len(made)) == 1
    assert cached(owner, "b", lambda: "other") == "other"
    before = id(owner)
    from lfrender.runtime.cache import _entries

    assert before in _entries
    del owner
    gc.collect()
    assert before not in _entries
