#!/usr/bin/env python3
"""Asks a Prometheus that scrapes a segment in sync for every expression of a Grafana dashboard.

Each must parse and give series with finite values. Those that can't have any while all is well are named here.
"""
import json
import math
import sys
import urllib.error
import urllib.parse
import urllib.request

prometheus, path = sys.argv[1:]
MAY_BE_EMPTY = set()


def ask(expression):
    url = f"{prometheus}/api/v1/query?" + urllib.parse.urlencode({"query": expression})
    try:
        return json.load(urllib.request.urlopen(url, timeout=10))
    except urllib.error.HTTPError as error:
        return json.load(error)


def plain(expression):
    """As Grafana fills in variables when all are chosen."""
    for name, value in {"$job": ".*", "$device": ".*", "$__rate_interval": "8s"}.items():
        expression = expression.replace(name, value)
    assert "$" not in expression, f"a variable is left: {expression}"
    return expression


dashboard = json.load(open(path))
count = 0
for panel in dashboard["panels"]:
    assert panel["title"] and panel["fieldConfig"]["defaults"]["unit"], panel
    assert panel["targets"], f"{panel['title']} asks for nothing"
    for target in panel["targets"]:
        expression = plain(target["expr"])
        answer = ask(expression)
        assert answer["status"] == "success", (expression, answer)
        series = answer["data"]["result"]
        assert series or expression in MAY_BE_EMPTY, f"{panel['title']}: {expression} gives nothing"
        for one in series:
            assert math.isfinite(float(one["value"][1])), (expression, one)
        count += 1

# What the figures must be in this run, so that empty zeros would not pass.
value = lambda expression: float(ask(expression)["data"]["result"][0]["value"][1])
assert value("isocat_in_sync") == 1
assert value("count(isocat_al_state == 8)") == 5
cycles = value("rate(isocat_cycles_total[8s])")
# A busy machine may hold the pace up; faster than the clock it never is.
assert 100 < cycles < 1100, f"{cycles} cycles a second, at 1 ms and the pace of a clock"
assert 0 < value("max(isocat_sync0_error_worst_seconds)") < 1e-6
assert ask("no such thing")["status"] == "error" and not ask("isocat_nothing")["data"]["result"], "it takes anything"
up = value("max_over_time(scrape_duration_seconds[10s])")
print(f"ok: {len(dashboard['panels'])} panels, {count} expressions; the slowest scrape took {up * 1e3:.1f} ms")
