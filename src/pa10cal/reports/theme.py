"""Colours of pictures and page, and how figures of the page look."""

from __future__ import annotations

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

_GRID = "rgba(128,128,128,0.35)"
_CLEAR = "rgba(0,0,0,0)"
_FONT = {"family": "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif", "size": 13}
_AXIS = {"gridcolor": _GRID, "zerolinecolor": GREY, "linecolor": GREY, "tickcolor": GREY}
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

    return Figure(
        layout={
            **_ground(height),
            "margin": {"l": 10, "r": 10, "t": 30, "b": 10},
            "dragmode": False,
            "xaxis": {**_AXIS, "automargin": True, "showline": True, "ticks": "outside", **x},
            "yaxis": {**_AXIS, "automargin": True, **y},
            **layout,
        }
    )


def new_space(height: int, ranges_mm: NDArray[np.float64]) -> Any:
    """Return an empty figure in three dimensions, that can be turned.

    Args:
        height: in pixels; the width is that of the page.
        ranges_mm: (3, 2) ends of the axes.
    """
    axis = {
        "gridcolor": GREY,
        "zerolinecolor": GREY,
        "showbackground": False,
        "showspikes": False,
        "color": GREY,
        "nticks": 6,
    }
    scene = {
        f"{name}axis": {**axis, "title": {"text": f"{name} [mm]"}, "range": ends.tolist()}
        for name, ends in zip("xyz", ranges_mm, strict=True)
    }
    camera = {"eye": {"x": 1.6, "y": -1.6, "z": 1.0}, "center": {"x": 0, "y": 0, "z": -0.15}}
    from plotly.graph_objects import Figure  # late: half a second, and tables need none

    return Figure(
        layout={
            **_ground(height),
            "margin": {"l": 0, "r": 0, "t": 30, "b": 0},
            "modebar": {"bgcolor": _CLEAR, "color": GREY, "activecolor": BLUE},
            "scene": {**scene, "aspectmode": "data", "camera": camera, "dragmode": "turntable"},
        }
    )


def _ground(height: int) -> dict[str, Any]:
    return {
        "template": "none",
        "height": height,
        "autosize": True,
        "paper_bgcolor": _CLEAR,
        "plot_bgcolor": _CLEAR,
        "font": {**_FONT, "color": GREY},
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


def drawn(drawing: Drawing) -> Markup:
    """Return a figure as it stands in the page, without the library."""
    from markupsafe import Markup

    return Markup(
        drawing.figure.to_html(
            include_plotlyjs=False,
            full_html=False,
            div_id=drawing.id,
            config=_CONFIG_IN_SPACE if drawing.in_space else _CONFIG,
            default_width="100%",
            default_height=f"{drawing.figure.layout.height}px",
        )
    )


def library() -> Markup:
    """Return plotly's own code, which stands in the page once."""
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    return Markup(get_plotlyjs())
