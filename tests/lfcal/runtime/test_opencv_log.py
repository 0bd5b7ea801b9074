"""OpenCV of any version that the project allows is silent while it decodes, and as before
afterwards.
"""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import pytest

from lfcal.runtime.opencv_log import silent_opencv


@pytest.mark.parametrize("since", ["4.9", "4.13"])
def test_the_level_is_set_where_the_version_has_it(monkeypatch, since):
    levels = [3]
    log = {"getLogLevel": lambda: levels[-1], "setLogLevel": levels.append}
    monkeypatch.setattr(
        cv2,
        "utils",
        SimpleNamespace(**({} if since == "4.9" else {"logging": SimpleNamespace(**log)})),
    )
    if since == "4.9":
        for name, function in log.items():
            monkeypatch.setattr(cv2, name, function, raising=False)
    with silent_opencv():
        assert levels == [3, 0]
    assert levels == [3, 0, 3]
