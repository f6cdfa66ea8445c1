#!/usr/bin/env bash
# Opens the built playground in a headless browser and uses it as people do; SHOTS=folder keeps pictures of it.
# Exit 77: no browser, no node or no package index, and says what.
set -euo pipefail
cd "$(dirname "$0")/../.."
missing() { printf 'playground in a browser: skipped, missing: %s\n' "$1"; exit 77; }
[ -f playground/isocat_playground.wasm.gz ] || missing "playground/isocat_playground.wasm.gz (playground/build)"
command -v chromium >/dev/null || apt-get install -y -qq chromium >/dev/null 2>&1 || true
command -v chromium >/dev/null || missing "chromium"
command -v node >/dev/null || missing "node"
command -v npm >/dev/null || missing "npm"
work=$(mktemp -d)
server=
end() {
  [ -z "$server" ] || kill "$server" 2>/dev/null || true
  rm -rf "$work"
}
trap end EXIT
(cd "$work" && npm install --silent --no-audit --no-fund playwright-core@1 >/dev/null 2>&1) || missing "playwright-core (npm)"
cp tests/interop/playground.mjs "$work/"
: >"$work/server.txt" # the loop below may be faster than the server
python3 -u -m http.server 0 --bind 127.0.0.1 -d playground >"$work/server.txt" 2>/dev/null &
server=$!
for _ in $(seq 50); do
  port=$(sed -n 's/.* port \([0-9]*\) .*/\1/p' "$work/server.txt")
  [ -n "$port" ] && break
  sleep 0.1
done
[ -n "$port" ] || { printf 'playground in a browser: the static server did not start\n'; exit 1; }
node "$work/playground.mjs" "http://127.0.0.1:$port/" "$(command -v chromium)" "${SHOTS:-}"
