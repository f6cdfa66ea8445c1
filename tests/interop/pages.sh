#!/usr/bin/env bash
# A foreign witness for the reports as pages: a headless Chromium opens them, points, zooms, hides, prints. Needs chromium, node
# and npm; with a folder as its argument it leaves pictures of the pages there.
set -euo pipefail
cd "$(dirname "$0")/../.."
for tool in chromium node npm; do
  command -v "$tool" >/dev/null || { echo "missing: $tool"; exit 77; }
done
pictures=${1:+$(mkdir -p "$1" && cd "$1" && pwd)}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
npm install --silent --no-fund --no-audit --prefix "$folder" playwright-core@1.65.1 >/dev/null 2>&1 || { echo "missing: npm's registry"; exit 77; }
cargo build --release --quiet --bin isocat
isocat="$PWD/${CARGO_TARGET_DIR:-target}/release/isocat"
[ -x "$isocat" ] || isocat="${CARGO_TARGET_DIR:-target}/release/isocat"
cp tests/interop/pages.mjs "$folder/"
cat > "$folder/late.toml" <<'TOML'
cycle = "1ms"
clocks = "0ppm" # so that the CPU's times are those of true time
hop_jitter = false
for = "2s"
shift = "200us"
[[subdevice]]
device = "model_every_mode"
name = "conveyor"
[[subdevice]]
device = "model_every_mode"
name = "gripper"
copy_time = "178us"
[[subdevice]]
device = "model_every_mode"
name = "labeller"
TOML
cat > "$folder/many.toml" <<'TOML'
cycle = "500us"
for = "200ms"
[[subdevice]]
device = "beckhoff_ek1100"
name = "coupler"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "late"
connect = "coupler:2"
copy_time = "400us"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis"
[[subdevice]]
device = "simple_io16"
name = "io"
count = 12
TOML
cd "$folder"
"$isocat" run --for 1s --report run.html > run.txt
"$isocat" run late.toml --report late.html > late.txt && { echo "the late device was not found"; exit 1; }
"$isocat" run many.toml --report many.html > many.txt && { echo "the late drive was not found"; exit 1; }
"$isocat" plan --prove --for 100ms --report plan.html > plan.txt
"$isocat" conform simple_io16 --report conform.html > conform.txt
"$isocat" sweep late.toml --vary shift=100us,200us,400us --vary 'subdevice[1].copy_time=50us,150us' --seeds 2 --page sweep.html > sweep.txt || [ $? = 1 ]
node pages.mjs "$folder" "$pictures"
