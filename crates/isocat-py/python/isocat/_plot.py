"""Plots of sweeps with matplotlib; imported at first use."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ._errors import InputError

if TYPE_CHECKING:
    from ._sweep import Frontier, SweepResult

GOOD, BAD = "#2e8b57", "#c0392b"


def _axes(ax: Any) -> Any:
    if ax is not None:
        return ax
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise ImportError(
            "plot() needs matplotlib, which is not installed: pip install matplotlib. "
            "Without it: frontier(x, y) prints itself"
        ) from error
    return pyplot.subplots(layout="constrained")[1]


def result(of: SweepResult, x: str | None, y: str | None, ax: Any) -> Any:
    """See ``SweepResult.plot``."""
    lists = [key for key, values in of.axes.items() if values is not None and len(values) > 1]
    for name, key in (("x", x), ("y", y)):
        if key is not None and key not in lists:
            expected = ", ".join(map(repr, lists)) or "none: no key has several values"
            raise InputError(f"{name}: found {key!r}; expected {expected}", place=name)
    rest = [key for key in lists if key not in (x, y)]
    # As in the frontier of the command: the first key is searched for each value of the second.
    if x is None and y is None and len(rest) > 1:
        y, x = rest[0], rest[1]
    elif x is None and rest:
        x = rest[0]
    if x is None:
        return histograms(of, ax)
    if y is None:
        return share(of, x, ax)
    return frontier(of.frontier(x, y), ax)


def frontier(of: Frontier, ax: Any) -> Any:
    """Plots a cell for each point of a frontier."""
    ax = _axes(ax)
    from matplotlib.colors import LinearSegmentedColormap

    # The question is whether all runs were as expected: only these are fully green.
    colours = LinearSegmentedColormap.from_list(
        "isocat", [(0, BAD), (0.5, "#f0b27a"), (0.999, "#f9e79f"), (1, GOOD)], N=1001
    ).with_extremes(bad="#dddddd")
    shares = [[of.share(x, y) for x in of.x_values] for y in of.y_values]
    ax.imshow(shares, cmap=colours, vmin=0, vmax=1, aspect="auto", origin="lower")
    for row in range(len(of.y_values)):
        for column in range(len(of.x_values)):
            value = shares[row][column]
            if not math.isnan(value):
                # A share below 1 must not be printed as 100.
                percent = "100" if value == 1 else f"{min(99.9, 100 * value):.3g}"
                dark = value == 1 or value < 0.3
                ax.text(
                    column,
                    row,
                    percent,
                    ha="center",
                    va="center",
                    color="white" if dark else "black",
                )
    _ticks(ax, of.x_values)
    ax.set_yticks(range(len(of.y_values)), of.y_values)
    ax.set_xlabel(of.x)
    ax.set_ylabel(of.y)
    ax.set_title("runs as expected [%]")
    return ax


def _ticks(ax: Any, values: list[str]) -> None:
    """Labels the x axis with values; rotates long ones, so that they do not overlap."""
    if sum(map(len, values)) > 70:
        ax.set_xticks(range(len(values)), values, rotation=30, ha="right", rotation_mode="anchor")
    else:
        ax.set_xticks(range(len(values)), values)


def share(of: SweepResult, key: str, ax: Any) -> Any:
    """Plots the share of runs as expected, with its 95 % interval (Wilson)."""
    ax = _axes(ax)
    values, _ = of._line(key)
    counts = {value: [0, 0] for value in values}
    axes = of._spec.axes
    for point, (runs, good) in of._points.items():
        for name, choices in axes:
            size = 1 if choices is None else len(choices)
            if name == key and choices is not None:
                counts[choices[point % size]][0] += runs
                counts[choices[point % size]][1] += good
            point //= size
    places = [place for place, value in enumerate(values) if counts[value][0]]
    middle, below, above = [], [], []
    for place in places:
        runs, good = counts[values[place]]
        low, high = _wilson(good, runs)
        middle.append(100 * good / runs)
        below.append(100 * (good / runs - low))
        above.append(100 * (high - good / runs))
    ax.errorbar(
        places, middle, yerr=[below, above], fmt="o-", color=GOOD, ecolor="#888888", capsize=4
    )
    _ticks(ax, values)
    ax.set_ylim(-4, 104)
    ax.set_xlabel(key)
    ax.set_ylabel("runs as expected [%]")
    ax.set_title(f"{of.runs} runs; bars: 95 % of what chance may do")
    ax.grid(alpha=0.3)
    return ax


def _wilson(good: int, runs: int) -> tuple[float, float]:
    z = 1.96
    share = good / runs
    middle = share + z * z / (2 * runs)
    half = z * math.sqrt(share * (1 - share) / runs + z * z / (4 * runs * runs))
    whole = 1 + z * z / runs
    return max(0.0, min(share, (middle - half) / whole)), min(
        1.0, max(share, (middle + half) / whole)
    )


def histograms(of: SweepResult, ax: Any) -> Any:
    """Plots histograms of the margins of runs as expected and of others."""
    ax = _axes(ax)
    good = of.table["as_expected"].to_list()
    margins = [None if one is None else one / 1000 for one in of.table["least_margin_ns"].to_list()]
    kinds = [("as expected", True, GOOD), ("not as expected", False, BAD)]
    data = [
        [one for one, ok in zip(margins, good) if one is not None and ok is kind]
        for _, kind, _ in kinds
    ]
    ax.hist(
        data,
        bins=40,
        stacked=True,
        color=[one[2] for one in kinds],
        label=[one[0] for one in kinds],
    )
    ax.set_xlabel("least margin of outputs before their pulse [us]")
    ax.set_ylabel("runs")
    ax.set_title(f"{of.good} of {of.runs} runs as expected")
    ax.legend()
    return ax
