"""How axes look in every figure."""

from __future__ import annotations

from matplotlib.axes import Axes


def plain_axes(ax: Axes) -> None:
    """Small numbers, no frame above and beside, a light grid behind what is drawn."""
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#e6e6e6", linewidth=0.5)
    ax.set_axisbelow(True)
