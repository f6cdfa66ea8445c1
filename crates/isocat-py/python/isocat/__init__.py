"""isocat: EtherCAT segments in deterministic virtual time, from Python.

Describe a segment, plan it, run it, and read the verdict of the judges in true time::

    import isocat

    seg = isocat.Segment(cycle="1ms", host={"jitter": "50us"})
    seg.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
    assert seg.plan().fits
    report = seg.run("10s", seed=1)
    assert report.in_sync, report.verdict

A `sweep` is many runs, on threads or a Ray cluster. A `Segment.bus` is the wire for programs in
Python, and `virtual` runs any unmodified MainDevice program on a segment.
"""

from __future__ import annotations

from ._errors import (
    Abort,
    BusError,
    Error,
    InputError,
    InternalError,
    PlanError,
    UnknownError,
)
from ._isocat import (
    Bus,
    Column,
    Conformance,
    Device,
    Diagnosis,
    Esi,
    Explanation,
    Finding,
    Plan,
    Report,
    Segment,
    Table,
    Verdict,
    __version__,
    conform,
    devices,
    diagnose,
    esi,
    explain,
    nanoseconds,
)

# Like typing.TYPE_CHECKING, but importing typing would take most of the time of this import.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from ._ray import ray
    from ._sweep import Frontier, SweepResult, sweep
    from ._virtual import VirtualRun, VirtualRuns, virtual

__all__ = [
    "Abort",
    "Bus",
    "BusError",
    "Column",
    "Conformance",
    "Device",
    "Diagnosis",
    "Error",
    "Esi",
    "Explanation",
    "Finding",
    "Frontier",
    "InputError",
    "InternalError",
    "Plan",
    "PlanError",
    "Report",
    "Segment",
    "SweepResult",
    "Table",
    "UnknownError",
    "Verdict",
    "VirtualRun",
    "VirtualRuns",
    "__version__",
    "conform",
    "devices",
    "diagnose",
    "esi",
    "explain",
    "nanoseconds",
    "ray",
    "sweep",
    "virtual",
]

# These are imported at first use, to keep `import isocat` fast.
_LATER = {
    "ray": "_ray",
    "sweep": "_sweep",
    "SweepResult": "_sweep",
    "Frontier": "_sweep",
    "virtual": "_virtual",
    "VirtualRun": "_virtual",
    "VirtualRuns": "_virtual",
}


def __getattr__(name: str) -> Any:
    module = _LATER.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f".{module}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
