"""Colours of pictures and page, and how figures of the page look."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from markupsafe import Markup

    from pa10cal.reports.blocks import Drawing

# Okabe and Ito's colours, distinguished by colour-blind readers.
BLACK = "#000000"
#: Has the same contrast to a light and to a dark ground.
GREY = "#767676"
SEPARATOR = "#bdbdbd"
ORANGE = "#e69f00"
SKY = "#56b4e9"
GREEN = "#009e73"
BLUE = "#0072b2"
VERMILLION = "#d55e00"
PURPLE = "#cc79a7"
#: Models, in the order in which they improve.
MODELS = {
    "uncalibrated": VERMILLION,
    "geometry": ORANGE,
    "linear": GREEN,
    "cubic": BLUE,
    "calibrated": BLUE,
    "extended": PURPLE,
}
BEFORE, AFTER, AFTER_COMBINED = VERMILLION, BLUE, SKY

_CLEAR = "rgba(0,0,0,0)"
_AXIS = {
    "gridcolor": "rgba(128,128,128,0.35)",
    "zerolinecolor": GREY,
    "linecolor": GREY,
    "tickcolor": GREY,
    "automargin": True,
}
_LAYOUT: dict[str, Any] = {
    "template": "none",
    "autosize": True,
    "paper_bgcolor": _CLEAR,
    "plot_bgcolor": _CLEAR,
    "font": {
        "family": "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif",
        "size": 13,
        "color": GREY,
    },
    "legend": {
        "orientation": "h",
        "y": 1.0,
        "yanchor": "bottom",
        "x": 0,
        "bgcolor": _CLEAR,
        "itemsizing": "constant",
    },
    "hoverlabel": {"font": {"size": 13}},
}
#: No button that leads elsewhere; only figures that can be turned have some.
_CONFIG = {"responsive": True, "displaylogo": False, "scrollZoom": False, "displayModeBar": False}
_CONFIG_IN_SPACE = {
    **_CONFIG,
    "displayModeBar": True,
    "modeBarButtons": [["orbitRotation", "pan3d", "zoom3d", "resetCameraDefault3d"]],
}


def new_figure(height: int, x: dict[str, Any], y: dict[str, Any], **layout: Any) -> Any:
    """Return an empty figure with two axes.

    Args:
        height: in pixels; the width is that of the page.
        x, y: what the axes are given besides their looks.
        layout: anything else of plotly's layout.
    """
    from plotly.graph_objects import Figure  # late: half a second, and tables need none

    axes = {"xaxis": {**_AXIS, "showline": True, "ticks": "outside", **x}, "yaxis": {**_AXIS, **y}}
    margin = {"l": 10, "r": 10, "t": 30, "b": 10}
    own = {"height": height, "margin": margin, "dragmode": False, **axes, **layout}
    return Figure(layout={**_LAYOUT, **own})


def new_space(height: int, ranges_mm: NDArray[np.float64]) -> Any:
    """Return an empty figure in three dimensions, that can be turned.

    Args:
        height: in pixels; the width is that of the page.
        ranges_mm: (3, 2) ends of the axes.
    """
    from plotly.graph_objects import Figure

    look = {"gridcolor": GREY, "zerolinecolor": GREY, "color": GREY, "nticks": 6}
    look |= {"showbackground": False, "showspikes": False}
    scene: dict[str, Any] = {
        f"{name}axis": {**look, "title": {"text": f"{name} [mm]"}, "range": ends.tolist()}
        for name, ends in zip("xyz", ranges_mm, strict=True)
    }
    eye, center = {"x": 1.6, "y": -1.6, "z": 1.0}, {"x": 0, "y": 0, "z": -0.15}
    scene |= {"aspectmode": "data", "dragmode": "turntable"}
    scene |= {"camera": {"eye": eye, "center": center}}
    modebar = {"bgcolor": _CLEAR, "color": GREY, "activecolor": BLUE}
    margin = {"l": 0, "r": 0, "t": 30, "b": 0}
    own = {"height": height, "margin": margin, "modebar": modebar, "scene": scene}
    return Figure(layout={**_LAYOUT, **own})


def packed_figure(drawing: Drawing) -> Markup:
    """Return what plotly's own code draws a figure from: JSON that stands within the page."""
    from markupsafe import Markup

    config = _CONFIG_IN_SPACE if drawing.in_space else _CONFIG
    text = f'{{"config": {json.dumps(config)}, {drawing.figure.to_json()[1:]}'
    return Markup(text.replace("<", "\\u003c"))  # in a script tags would end or hide it


@cache
def packed_library() -> str:
    """Return plotly's own code, which stands in the page once, packed: a third of its size."""
    from plotly.offline import get_plotlyjs

    return b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()
