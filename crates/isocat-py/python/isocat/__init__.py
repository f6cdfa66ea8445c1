"""isocat: EtherCAT segments in deterministic virtual time, from Python.

Describe a segment, plan it, run it, and look at what the judges say in true time::

    import isocat

    seg = isocat.Segment(cycle="1ms", host={"jitter": "50us"})
    seg.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
    assert seg.plan().fits
    report = seg.run("10s", seed=1)
    assert report.in_sync, report.verdict

Many runs are a `sweep`, over threads or a Ray cluster; a `Segment.bus` is the wire for programs in
Python, and `virtual` runs any unmodified MainDevice program on it.
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

# As in typing, whose import would be the longest part of this one's.
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

# What a first look does not need is imported when it is asked for.
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
