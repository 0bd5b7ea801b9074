"""OpenCV of any version that the project allows can be silenced."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import pytest

from lfrender.live.sources import silence_opencv


@pytest.mark.parametrize("since", ["4.9", "4.13"])
def test_the_level_is_set_where_the_version_has_it(monkeypatch, since):
    levels = []
    log = SimpleNamespace(setLogLevel=levels.append)
    utils = SimpleNamespace(logging=log)
    if since == "4.9":
        utils = SimpleNamespace()
        monkeypatch.setattr(cv2, "setLogLevel", levels.append, raising=False)
    monkeypatch.setattr(cv2, "utils", utils)
    silence_opencv()
    assert levels == [0]
