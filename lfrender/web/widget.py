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

    number = traitlets.Float
    two = {"minlen": 2, "maxlen": 2}
    traits = {
        "page": traitlets.Unicode(),
        "height": traitlets.Int(),
        "mode": traitlets.Enum(["focus", "range", "sharp", "tiles", "traditional"], "focus"),
        "plane": number(None, allow_none=True),
        "range": traitlets.List(number(), None, allow_none=True, **two),
        "brightness": number(0.0, min=-3.0, max=3.0),
        "aperture": number(1.0, min=0.05, max=1.0),
        "overlay": number(0.0, min=0.0, max=1.0),
        "viewpoint": traitlets.List(number(), [0.0, 0.0], **two),
    }
    shared = {name: trait.tag(sync=True) for name, trait in traits.items()}
    script = str(read_asset("widget.js"))
    made: Any = type("LightField", (anywidget.AnyWidget,), {"_esm": script, **shared})
    return made(page=viewer_page(flat, calibration, depth, title), height=height)
