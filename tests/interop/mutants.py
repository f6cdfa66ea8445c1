#!/usr/bin/env python3
"""Four programs under `isocat virtual --mutate`: pysoem, KickCAT, ethercrab and our own `run`, each with one mistake at a time between it
and the segment.

What does harm in true time must not be green at `virtual`, and what does none must not be red there. What `diagnose --segment` says
otherwise is printed: it may let pass one in fifty of what does harm, and it tells errors on the way up that a program overcame. Neither
root nor an interface is needed.

    mutants.py [--isocat PATH] [--count N] [--only PROGRAM] [--rows FOLDER]

--rows keeps the whole of each table as JSON. Exit codes: 0 all well, 1 a door was wrong, 77 nothing could be tried.
"""
import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from main_devices import HERE, TARGET, TOOLS, install
from virtual_table import RECIPES, build_ethercrab

AXES = HERE / "mistakes" / "axes.toml"
# The share that diagnose may let pass, as no frame shows it; of few, one.
OUT_OF_SIGHT = 0.02
# A run of ethercrab, which polls, takes as long as this many of the others.
SLOW = 20


def programs(isocat):
    peers = install(["pysoem", "kickcat"])
    if "pysoem" in peers:
        yield "pysoem", AXES, [peers["pysoem"][0], HERE / "mistakes_pysoem.py", "good", "vt0", "100", "1000"]
    if "kickcat" in peers:
        yield "kickcat", HERE / "mistakes" / "outputs.toml", [peers["kickcat"][0], HERE / "mutants_kickcat.py", "vt0", "400"]
    if build_ethercrab():
        yield "ethercrab", AXES, [TOOLS / "debug" / "recipe-ethercrab", "vt0", "200"]
    yield "isocat", AXES, [isocat, "run", AXES, "--interface", "vt0", "--for", "1s"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--only")
    parser.add_argument("--rows", type=Path)
    arguments = parser.parse_args()
    wrong, tried = 0, 0
    for name, segment, command in programs(arguments.isocat):
        if arguments.only not in (None, name):
            continue
        began = time.monotonic()
        count = max(1, arguments.count // (SLOW if name == "ethercrab" else 1))
        done = subprocess.run([arguments.isocat, "virtual", segment, "--mutate", str(count), "--json", "--", *command],
                              capture_output=True, text=True)
        try:
            table = json.loads(done.stdout)
        except ValueError:
            print(f"{name}: could not be tried: {done.stderr.strip()}")
            wrong += 1
            continue
        tried += 1
        if arguments.rows:
            arguments.rows.mkdir(parents=True, exist_ok=True)
            (arguments.rows / f"{name}.json").write_text(done.stdout)
        wrong += judge(name, table, time.monotonic() - began)
    if not tried and not wrong:
        return 77
    return 1 if wrong else 0


def judge(name, table, seconds):
    virtual, diagnose = table["doors"]["virtual"], table["doors"]["diagnose"]
    rows = [row for row in table["rows"] if not row["at_the_edge"]]
    harmful = [row for row in rows if row["effects"]]
    missed = [row for row in harmful if row["diagnose"] == "green"]
    at_the_edge = table["mutants"] - len(rows)
    print(f"{name}: {table['mutants']} mutants of {table['classes']} classes, {len(harmful)} do harm, {at_the_edge} lie at a limit, "
          f"{seconds:.0f} s")
    for door, counts in ("virtual", virtual), ("diagnose", diagnose):
        print(f"  {door}: {counts}")
    for door in "virtual", "diagnose":
        for row in rows:
            if row[door] == ("green" if row["effects"] else "red"):
                first = row[f"{door}_first"]
                print(f"  {door} {row[door]}: {row['mutant']}: {row['effects'][:2] if row['effects'] else first}")
    wrong = [virtual["effect_green"], virtual["none_red"], len(missed) > max(1, OUT_OF_SIGHT * len(harmful))]
    return sum(map(bool, wrong))


if __name__ == "__main__":
    sys.exit(main())
