"""The viewer of `lfrender view` as a widget of notebooks (anywidget)."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError
from lfcal.runtime.packages import check_package

from ..data.depth_map import DepthMap
from .templates import read_asset
from .viewer import viewer_page

__all__ = ["light_field_widget"]


def light_field_widget(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    *,
    title: str = "Light field",
    height: int = 520,
) -> Any:
    """A light field in a notebook: click to focus, drag to look from aside.

    Its traits are those of the picture and can be read, set, observed and linked: `mode`
    (`"focus"`, `"range"`, `"sharp"`, `"tiles"` or `"traditional"`), `plane` (patch size in focus
    [px]), `range` (ends of the sharp range, `s`, or `s + 2 D` of binocular ones [px]), `brightness`
    (-3 to 3 [EV]), `aperture` (0.05 to 1), `viewpoint` (x, y [px]), `overlay` (0 to 1).

    `height` is that of the widget [CSS px]. LightFieldError if the package `anywidget` is not
    installed; other errors as of `viewer_page`.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> widget = light_field_widget(flat, camera, depth)  # doctest: +SKIP
    >>> widget.plane = -6.2  # doctest: +SKIP
    """
    check_package("anywidget", "the widget needs", LightFieldError)
    import anywidget
    import traitlets

    class LightField(anywidget.AnyWidget):  # type: ignore[misc, name-defined]
        """The viewer of a light field."""

        _esm = str(read_asset("widget.js"))
        page = traitlets.Unicode().tag(sync=True)
        height = traitlets.Int().tag(sync=True)
        mode = traitlets.Enum(["focus", "range", "sharp", "tiles", "traditional"], "focus").tag(
            sync=True
        )
        plane = traitlets.Float(None, allow_none=True).tag(sync=True)
        range = traitlets.List(traitlets.Float(), None, allow_none=True, minlen=2, maxlen=2).tag(
            sync=True
        )
        brightness = traitlets.Float(0.0, min=-3.0, max=3.0).tag(sync=True)
        aperture = traitlets.Float(1.0, min=0.05, max=1.0).tag(sync=True)
        overlay = traitlets.Float(0.0, min=0.0, max=1.0).tag(sync=True)
        viewpoint = traitlets.List(traitlets.Float(), [0.0, 0.0], minlen=2, maxlen=2).tag(sync=True)

    return LightField(page=viewer_page(flat, calibration, depth, title), height=height)
