"""Results that show themselves: as a table, as a figure, and in a notebook's cell.

How a result looks is known to `rx90b_flex.view.shown` alone; here it is only asked, so that what computes does not draw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


class Showing:
    """A result that has a table and a figure."""

    def to_pandas(self) -> pd.DataFrame:
        """The result's main table, units in the column ``unit`` or in the columns' names."""
        from rx90b_flex.view.shown import appearance_of

        return appearance_of(self).table()

    def plot(self) -> Axes:
        """The figure that matters most; its first axes, from which ``.figure`` leads to the others.

        It knows of no window: a cell shows ``result.plot().figure``, and ``.figure.savefig(path)`` writes it.
        """
        from rx90b_flex.view.shown import appearance_of

        return appearance_of(self).figure().axes[0]

    def __repr__(self) -> str:
        from rx90b_flex.view.shown import appearance_of

        return f"<{type(self).__name__}: {appearance_of(self).words}>"

    def _repr_html_(self) -> str:
        """The verdict, the table and the figure, for a notebook."""
        from rx90b_flex.view.shown import cell_of

        return cell_of(self)
