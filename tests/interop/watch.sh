#!/usr/bin/env bash
# The live view as a user has it: in a terminal (tmux) of 80x24 and of 200x50, with keys; without a terminal; as a gate with its
# exit codes; with a reader that goes away. Takes a folder in which to leave the panes. Exit 77: tmux is missing.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v tmux >/dev/null || { echo "skipped: no tmux"; exit 77; }
isocat=${ISOCAT:-}
if [ -z "$isocat" ]; then
  cargo build --release --locked --quiet --bin isocat
  isocat="${CARGO_TARGET_DIR:-target}/release/isocat"
fi
folder=$(mktemp -d)
server="isocat-$$"
mux() { tmux -L "$server" "$@"; }
trap 'mux kill-server 2>/dev/null || true; rm -rf "$folder"' EXIT
failed() { echo "failed: $1"; shift; for file in "$@"; do echo "--- $file"; cat "$file"; done; exit 1; }
pane() { mux capture-pane -p -t view > "$folder/$1.txt"; [ -z "${keep:-}" ] || cp "$folder/$1.txt" "$keep/$1.txt"; }
keep=${1:-}
# Waits until the pane has a text; a machine that is busy takes its time.
until_pane() {
  for _ in $(seq 100); do
    pane "$1"
    if grep -qE -- "$2" "$folder/$1.txt"; then return 0; fi
    sleep 0.1
  done
  failed "$1 has no \"$2\"" "$folder/$1.txt"
}
has() { grep -qE -- "$2" "$folder/$1.txt" || failed "$1 has no \"$2\"" "$folder/$1.txt"; }
lacks() { ! grep -qE -- "$2" "$folder/$1.txt" || failed "$1 has \"$2\"" "$folder/$1.txt"; }
is_within() { [ "$(LC_ALL=C.UTF-8 wc -L < "$folder/$1.txt")" -le "$2" ] || failed "$1 is wider than $2" "$folder/$1.txt"; }
# The command's exit code stands in the pane behind it.
begin() {
  mux -f /dev/null new-session -d -s view -x "$1" -y "$2" "$3; echo \"exit \$?\"; stty -a | grep -qw icanon && echo 'cooked again'; sleep 60"
}

for size in "80 24" "200 50"; do
  read -r width height <<< "$size"
  name="${width}x$height"
  begin "$width" "$height" "'$isocat' watch"
  until_pane "$name" 'In sync: 3 of 5 SubDevices with SYNC, all in OP'
  until_pane "$name" '^4 .*SSC.* OP .* ns .* us .*\+[0-9.]+ '
  has "$name" '^host phase .* [▁▂▃▄▅▆▇█]+$'
  has "$name" 'all in OP: in operation'
  has "$name" '^#▼'
  is_within "$name" "$width"
  mux send-keys -t view s
  until_pane "$name-error" 'err(or)?\[t\]▼'
  mux send-keys -t view s s s s r
  until_pane "$name-reversed" '^#▲'
  rows=$(grep -oE '^[0-4] ' "$folder/$name-reversed.txt" | tr -d ' \n')
  [ "$rows" = 43210 ] || failed "reversed by position: $rows" "$folder/$name-reversed.txt"
  mux send-keys -t view r Home Down Enter
  until_pane "$name-cycle" 'SYNC0 +523\.[0-9]+ \.\. 524\.[0-9]+ +52[34]\.[0-9]+ \.\. 524\.[0-9]+'
  has "$name-cycle" 'SubDevice 1 \(AKD2G axis 2\): OP, dc-sync0'
  has "$name-cycle" '░ planned  █ seen'
  mux send-keys -t view '?'
  until_pane "$name-help" 'any key ends it'
  mux send-keys -t view x Escape
  until_pane "$name-back" '^#▼'
  mux send-keys -t view p
  until_pane "$name-paused" 'PAUSED'
  before=$(head -1 "$folder/$name-paused.txt"); sleep 1; pane "$name-still"
  [ "$before" = "$(head -1 "$folder/$name-still.txt")" ] || failed "it goes on in a pause" "$folder/$name-paused.txt" "$folder/$name-still.txt"
  mux send-keys -t view p
  mux resize-window -t view -x 60 -y 12
  until_pane "$name-small" '^#'
  is_within "$name-small" 60
  mux resize-window -t view -x "$width" -y "$height"
  if [ "$width" = 80 ]; then mux send-keys -t view q; else mux send-keys -t view C-c; fi
  until_pane "$name-end" 'cooked again'
  has "$name-end" '^exit 0'
  lacks "$name-end" '^#▼'
  mux kill-session -t view
  echo "ok: $name: table, sorting, cycle, help, pause, resize, and the terminal is as it was"
done

# A signal ends it, and the terminal is given back.
begin 80 24 "'$isocat' watch & pid=\$!; sleep 2; kill -TERM \$pid; wait \$pid"
until_pane signal 'cooked again'
mux kill-session -t view
# Colours, and none.
begin 80 24 "'$isocat' watch"; until_pane colour 'In sync'; mux capture-pane -e -p -t view > "$folder/colour.txt"; mux kill-session -t view
has colour $'\e\\[[0-9;]*38;5;[0-9]+m'
begin 80 24 "NO_COLOR=1 '$isocat' watch"; until_pane grey 'In sync'; mux capture-pane -e -p -t view > "$folder/grey.txt"; mux kill-session -t view
lacks grey $'\e\\[[0-9;]*38;5;[0-9]+m'
echo "ok: SIGTERM, colours, NO_COLOR"

code() { local expected=$1; shift; local got=0; "$@" > "$folder/out.txt" 2> "$folder/err.txt" || got=$?; [ "$got" = "$expected" ] || failed "exit $got, expected $expected: $*" "$folder/out.txt" "$folder/err.txt"; }
says() { grep -qE -- "$1" "$folder/err.txt" || failed "no \"$1\"" "$folder/err.txt"; }
code 0 "$isocat" watch --speed max --until 100ns --for 5s --within 60s
says '3 SubDevices with SYNC within 100 ns for 5 s, at 5\.[4-9]00 s \[t\]'
code 1 "$isocat" watch --speed max --until 13ns --for 5s --within 10s
says 'not within 13 ns for 5 s; worst: SubDevice [0-9] \(.*\) with [0-9.]+ ns at .*; the last stretch, of .*, was broken at .*: SubDevice .*: SYNC error'
code 1 "$isocat" watch --speed max --until 100ns --for 5s --within 20s --no-drift-compensation
printf 'cycle = "125us"\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\n' > "$folder/short.toml"
code 1 "$isocat" watch "$folder/short.toml" --speed max --until 100ns --for 1s
says '0x1C32:05'
code 1 "$isocat" watch "$folder/short.toml" --speed max
code 2 "$isocat" watch "$folder/nothing.toml"
code 2 "$isocat" watch --for 5s
code 2 "$isocat" watch --until 5s
code 2 "$isocat" watch --until 100ns --for 5s --within 4999ms
code 2 "$isocat" watch --speed 0
code 2 "$isocat" watch --serve nobody-serves-here
says 'no isocat serves there'
code 2 "$isocat" watch --metrics 192.0.2.1:1
says "can't be used"
code 2 "$isocat" watch --metrics 70000
code 2 "$isocat" run --metrics 9464
says 'isocat watch --metrics'
echo "ok: exit codes of the gate and of bad input"

code 0 "$isocat" watch --plain --speed max --within 5s
[ "$(grep -cE '^isocat\[[1-5]\.000\]: in sync  5 of 5 in OP' "$folder/out.txt")" = 5 ] || failed "lines a second" "$folder/out.txt"
grep -qE '^isocat\[4\.000\]: 4 SSC drive axis 3  error +-?[0-9]+ ns worst [0-9]+ ns  margin [0-9.]+ us  freq [+-][0-9.]+ ppm  OP$' "$folder/out.txt" || failed "a SubDevice's line" "$folder/out.txt"
set +o pipefail
"$isocat" watch --plain --speed max 2> "$folder/err.txt" | head -5 > "$folder/out.txt"
[ "${PIPESTATUS[0]}" = 0 ] || failed "a reader that went away is no error" "$folder/err.txt"
set -o pipefail
echo "ok: lines, and a reader that goes away"
