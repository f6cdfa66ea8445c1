"""What a user's program looks like to mypy and pyright."""

from __future__ import annotations

from datetime import timedelta

import isocat


def fits(cycle: str) -> bool:
    seg = isocat.Segment(cycle=cycle, host={"jitter": "5us"})
    axis: int = seg.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
    plan = seg.plan(suggest=True)
    slack: list[int] = plan.lines["slack_ns"].to_list()
    report = seg.run(timedelta(seconds=1), seed=1)
    kinds: set[str] = {finding.kind for finding in report.findings}
    with seg.bus(behaviours={"axis 1": object()}) as bus:
        back = bus.exchange(bytes(60), at="1ms")
        when: int | None = None if back is None else back[0]
        bus.device(axis).inputs = b"\0"
        answer: str = bus.verdict().answer
    result = isocat.sweep(seg, {"cycle": ["1ms", 500_000]}, seeds=range(3), executor=isocat.ray())
    edges: dict[str, str] = result.frontier("host.jitter", "cycle").edges
    runs = isocat.virtual(["./main", "vt0"], seg, seeds=3)
    first: isocat.VirtualRun = runs[0]
    print(slack, kinds, when, answer, edges, first.verdict)
    return plan.fits
