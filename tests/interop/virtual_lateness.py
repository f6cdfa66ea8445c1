#!/usr/bin/env python3
"""How late may the wake-ups of a MainDevice's machine be? A program at many seeds for each lateness, in virtual time, judged in true time.

Beside the judges' verdict stands what the program could have known: whether all SubDevices were in OP at the end without a status
code, and whether their counters (0x1C32:0B, :0C, :0D, :20) stayed at zero. The table and the picture of docs/virtual.md.

    virtual_lateness.py --program COMMAND [--isocat PATH] [--seeds N] [--lateness US,US,...] [--rows FILE.csv] [--picture FILE.svg]

COMMAND is started as COMMAND vt0, at the segment of docs/recipes.md: docs/recipes/soem.c, built, is what the table was made with.
Exit codes: 0 tried, 1 a run ended in a way that is not known.
"""
import argparse
import csv
import json
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from main_devices import ROOT, TARGET

LATENESS = [0, 500, 1000, 1500, 2000, 2250, 2500, 2750, 3000, 3500, 4000]
COUNTERS = ("sm_event_missed", "cycle_time_too_small", "shift_time_too_short", "sync_error")


class Run:
    def __init__(self, isocat, segment, program, lateness, seed):
        late = ["--lateness", f"{lateness}us"] if lateness else []
        done = subprocess.run([isocat, "virtual", segment, "--seed", str(seed), *late, "--json", "--", *program, "vt0"],
                              capture_output=True, text=True)
        if done.returncode not in (0, 1, 3, 4):
            raise RuntimeError(f"lateness {lateness} us, seed {seed}: {done.stderr.strip()}")
        summary = json.loads(done.stdout.splitlines()[-1])
        self.lateness, self.seed = lateness, seed
        session = summary["sessions"][-1]
        devices = (session["judged"] or {}).get("devices", [])
        margins = [device["sync0_margin"]["min_ns"] for device in devices if device.get("sync0_margin")]
        self.answer, self.margin = session["answer"], min(margins) if margins else None
        kinds = [kind for device in devices for kind in device["kinds"]]
        self.first = min(kinds, key=lambda kind: (kind["since_ns"] is None, kind["since_ns"] or 0))["kind"] if kinds else ""
        said = [line for line in done.stdout.splitlines() if ": state " in line]
        # What a MainDevice reads at the end, and what it could read.
        self.clean = (bool(said) and all("state 8, No error" in line for line in said)
                      and not any(device[counter] for device in devices for counter in COUNTERS))
        self.lost = self.answer != "in-sync" or bool((session["judged"] or {}).get("earlier"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--program", required=True)
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--seeds", type=int, default=300)
    parser.add_argument("--lateness", type=lambda text: [int(word) for word in text.split(",")], default=LATENESS)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="isocat-lateness-") as folder:
        segment = Path(folder) / "segment.toml"
        segment.write_text(re.search(r"```toml\n(.*?)```", (ROOT / "docs" / "recipes.md").read_text(), re.S)[1])
        cases = [(lateness, seed) for lateness in arguments.lateness for seed in range(1, arguments.seeds + 1)]
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            runs = list(threads.map(lambda case: Run(arguments.isocat, segment, arguments.program.split(), *case), cases))
    by_lateness = {lateness: [run for run in runs if run.lateness == lateness] for lateness in arguments.lateness}
    print(table(by_lateness))
    if arguments.rows:
        with arguments.rows.open("w", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["lateness_us", "seed", "answer", "lost", "clean", "margin_ns", "first_finding"])
            rows.writerows([run.lateness, run.seed, run.answer, int(run.lost), int(run.clean), run.margin, run.first] for run in runs)
    if arguments.picture:
        arguments.picture.write_text(picture(by_lateness))
    return 0


def us(ns):
    return f"{ns / 1000:.0f}"


def table(by_lateness):
    lines = ["| lateness up to | in sync | lost, and the devices tell | lost, and all looks clean | least margin, of all seeds | median | first clean loss |",
             "|---|---|---|---|---|---|---|"]
    for lateness, runs in by_lateness.items():
        lost = [run for run in runs if run.lost]
        clean = [run for run in lost if run.clean]
        margins = sorted(run.margin for run in runs if run.margin is not None) or [0]
        first = f"seed {clean[0].seed}: `{clean[0].first}`" if clean else ""
        lines.append(f"| {lateness} us | {len(runs) - len(lost)} of {len(runs)} | {len(lost) - len(clean)} | {len(clean)} | "
                     f"{us(margins[0])} us | {us(margins[len(margins) // 2])} us | {first} |")
    return "\n".join(lines)


def picture(by_lateness):
    """Each run a dot: least margin over lateness; the colour says what became of it."""
    width, height, left, right, top, bottom = 760, 400, 64, 16, 56, 48
    every = [run for runs in by_lateness.values() for run in runs if run.margin is not None]
    most = max(run.margin for run in every) / 1000
    least = min(0, min(run.margin for run in every) / 1000)
    last = max(by_lateness) or 1
    x = lambda lateness: left + (width - left - right) * (0.03 + 0.94 * lateness / last)
    y = lambda margin: top + (height - top - bottom) * (most - margin) / (most - least)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="#ffffff"/>']
    for margin in range(int(least // 500) * 500, int(most) + 1, 500):
        if margin >= least:
            out.append(f'<path d="M{left} {y(margin):.1f}H{width - right}" stroke="{"#555555" if margin == 0 else "#dddddd"}"/>'
                       f'<text x="{left - 6}" y="{y(margin) + 4:.1f}" text-anchor="end" fill="#333333">{margin}</text>')
    for lateness in by_lateness:
        out.append(f'<text x="{x(lateness):.1f}" y="{height - bottom + 18}" text-anchor="middle" fill="#333333">{lateness}</text>')
    kinds = [("in sync", "#2a7f62"), ("lost, and the devices tell", "#c98500"), ("lost, and all looks clean", "#c0392b")]
    dots = [[], [], []]
    for run in every:
        kind = 0 if not run.lost else 2 if run.clean else 1
        spread = ((run.seed * 37) % 101 / 101 - 0.5) * 0.05 * (width - left - right)
        dots[kind].append(f"M{x(run.lateness) + spread:.0f} {y(run.margin / 1000):.0f}h0")
    for (_, colour), places in zip(kinds, dots):
        out.append(f'<path d="{"".join(places)}" stroke="{colour}" stroke-width="3.6" stroke-linecap="round" stroke-opacity="0.5"/>')
    for place, (name, colour) in enumerate(kinds):
        out.append(f'<circle cx="{left + 8 + 190 * place}" cy="20" r="5" fill="{colour}"/><text x="{left + 18 + 190 * place}" y="24" fill="#333333">{name}</text>')
    out.append(f'<text x="{(left + width - right) / 2}" y="{height - 10}" text-anchor="middle" fill="#333333">wake-ups late by up to, us</text>')
    out.append(f'<text x="14" y="{(top + height - bottom) / 2}" text-anchor="middle" fill="#333333" '
               f'transform="rotate(-90 14 {(top + height - bottom) / 2})">least margin before SYNC0, us</text></svg>')
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    sys.exit(main())
