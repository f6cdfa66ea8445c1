#!/usr/bin/env bash
# Foreign readers of the metrics. Debian's promtool checks what `isocat watch --metrics` answers; a real Prometheus scrapes it for
# some seconds and evaluates every expression of docs/grafana-dashboard.json; Grafana's own classes read that file; a page in a headless
# browser draws its panels from that Prometheus. Takes a folder in which to leave the picture. Exit 77: prometheus is missing.
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$PWD
folder=$(mktemp -d)
pids=()
cleanup() { for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null || true; done; wait 2>/dev/null || true; rm -rf "$folder"; }
trap cleanup EXIT
skips=()

# Unpacked and not installed, so that no service begins.
if ! command -v prometheus >/dev/null || ! command -v promtool >/dev/null; then
  (cd "$folder" && apt-get download prometheus >/dev/null 2>&1 && dpkg-deb -x prometheus_*.deb tools) || { echo "skipped: no prometheus, and apt-get can't fetch it"; exit 77; }
  PATH="$folder/tools/usr/bin:$PATH"
fi

isocat=${ISOCAT:-}
if [ -z "$isocat" ]; then
  cargo build --release --locked --quiet --bin isocat
  isocat="${CARGO_TARGET_DIR:-target}/release/isocat"
fi
# Port 0: one that is free, which is told.
"$isocat" watch --plain --metrics 0 > "$folder/lines.txt" 2> "$folder/words.txt" &
pids+=($!)
for _ in $(seq 100); do grep -q '^metrics: ' "$folder/words.txt" && break; sleep 0.1; done
url=$(sed -n 's/^metrics: //p' "$folder/words.txt")
for _ in $(seq 100); do grep -q 'in sync' "$folder/lines.txt" && break; sleep 0.1; done

curl --fail --silent --show-error "$url" > "$folder/metrics.txt"
said=$(promtool check metrics < "$folder/metrics.txt" 2>&1) || { echo "promtool: $said"; exit 1; }
[ -z "$said" ] || { echo "promtool complains: $said"; exit 1; }
echo "ok: promtool has nothing to say about $(grep -c '^# TYPE' "$folder/metrics.txt") families"
if sed 's/isocat_frames_lost_total/isocat frames/' "$folder/metrics.txt" | promtool check metrics >/dev/null 2>&1; then
  echo "promtool takes anything"; exit 1
fi

port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
target=${url#http://}
printf 'scrape_configs:\n  - job_name: isocat\n    scrape_interval: 1s\n    static_configs:\n      - targets: ["%s"]\n' "${target%/metrics}" > "$folder/prometheus.yml"
promtool check config "$folder/prometheus.yml" >/dev/null
prometheus --config.file="$folder/prometheus.yml" --storage.tsdb.path="$folder/data" --web.listen-address="127.0.0.1:$port" \
  --log.level=warn > "$folder/prometheus.txt" 2>&1 &
pids+=($!)
sleep 12
python3 tests/interop/dashboard.py "http://127.0.0.1:$port" docs/grafana-dashboard.json

if python3 -m venv "$folder/venv" >/dev/null 2>&1 && "$folder/venv/bin/pip" install --quiet "grafana-foundation-sdk==1769699998!10.1.0" 2>/dev/null; then
  "$folder/venv/bin/python" - docs/grafana-dashboard.json <<'PYTHON'
import json, sys
from grafana_foundation_sdk.models import dashboard
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
register_default_plugins()
ours = json.load(open(sys.argv[1]))
read = dashboard.Dashboard.from_json(ours)
written = json.loads(JSONEncoder().encode(read))
assert len(read.panels) == len(ours["panels"]) > 10
for before, after in zip(ours["panels"], written["panels"]):
    for key in ("title", "type", "gridPos"):
        assert before[key] == after[key], (key, before[key], after[key])
    assert before["fieldConfig"]["defaults"]["unit"] == after["fieldConfig"]["defaults"]["unit"], before["title"]
    assert [t["expr"] for t in before["targets"]] == [t["expr"] for t in after["targets"]], before["title"]
assert [v["name"] for v in ours["templating"]["list"]] == [v["name"] for v in written["templating"]["list"]]
print(f"ok: Grafana's classes read the dashboard and write the same {len(read.panels)} panels")
PYTHON
else
  skips+=("Grafana's classes: no venv or package index")
fi

browser=$(command -v chromium || command -v chromium-browser || true)
if [ -n "$browser" ] && command -v npm >/dev/null && (cd "$folder" && npm install --silent --no-fund --no-audit playwright-core@1.56.1 >/dev/null 2>&1); then
  cp "$root/tests/interop/dashboard.html" "$root/tests/interop/dashboard.mjs" "$root/docs/grafana-dashboard.json" "$folder"
  (cd "$folder" && node dashboard.mjs "$browser" "http://127.0.0.1:$port")
  if [ -n "${1:-}" ]; then cp "$folder/dashboard.png" "$1/dashboard.png"; fi
else
  skips+=("drawn panels: no chromium, npm or package index")
fi
for skip in "${skips[@]}"; do echo "skipped: $skip"; done
