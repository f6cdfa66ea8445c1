"""Tables as text, HTML, numpy arrays and pandas frames; imported at first use."""

from __future__ import annotations

import html as _html
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._isocat import Column, Table

_SHOWN = 20


def to_numpy(column: Column, dtype: Any = None, copy: bool | None = None) -> Any:
    """A copy of a column; see ``Column.__array__``."""
    import numpy

    if copy is False:
        raise ValueError(
            f'column "{column.name}" can\'t be a view: it has texts, flags or empty cells'
        )
    values: list[Any] = column.to_list()
    if dtype is None:
        if column.kind == "text" or (column.kind == "flag" and column.null_count):
            dtype = object
        elif column.kind == "integer" and column.null_count:
            values, dtype = [float("nan") if one is None else one for one in values], float
    return numpy.array(values, dtype=dtype)


def to_pandas(table: Table) -> Any:
    """A pandas frame of a table; see ``Table.to_pandas``."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(
            "to_pandas() needs pandas, which is not installed: pip install pandas. "
            "Without it: table.rows(), table.to_parquet(path), or whatever takes an Arrow stream"
        ) from error
    import numpy

    kinds = {"integer": "Int64", "float": "Float64", "flag": "boolean"}
    series: dict[str, Any] = {}
    for name in table.column_names:
        column = table[name]
        if column.kind == "text":
            series[name] = pandas.Series(column.to_list(), dtype="str")
        elif column.null_count and column.kind != "float":
            series[name] = pandas.Series(column.to_list(), dtype=kinds[column.kind])
        elif column.null_count:
            nan = float("nan")
            series[name] = [nan if one is None else one for one in column.to_list()]
        else:
            # A frame may be modified, a table may not: so this is a copy.
            series[name] = numpy.array(column)
    return pandas.DataFrame(series, columns=table.column_names)


def text(table: Table) -> str:
    """The first rows as text in columns."""
    names = table.column_names
    rows = table.slice(0, _SHOWN).rows()
    cells = [["" if row[name] is None else str(row[name]) for name in names] for row in rows]
    cells = [[one if len(one) <= 40 else one[:39] + "…" for one in row] for row in cells]
    widths = [max([len(name), *(len(row[at]) for row in cells)]) for at, name in enumerate(names)]
    lines = ["  ".join(name.ljust(width) for name, width in zip(names, widths)).rstrip()]
    lines += [
        "  ".join(one.ljust(width) for one, width in zip(row, widths)).rstrip() for row in cells
    ]
    if len(table) > _SHOWN:
        lines.append(f"... {len(table)} rows")
    return "\n".join(lines)


def html(table: Table) -> str:
    """The first rows as HTML for a notebook."""
    names = table.column_names
    head = "".join(f"<th>{_html.escape(name)}</th>" for name in names)
    body = ""
    for row in table.slice(0, _SHOWN).rows():
        cells = ("" if row[name] is None else str(row[name]) for name in names)
        body += "<tr>" + "".join(f"<td>{_html.escape(cell)}</td>" for cell in cells) + "</tr>"
    more = f"<p>{len(table)} rows</p>" if len(table) > _SHOWN else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
