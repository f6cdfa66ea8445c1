#!/usr/bin/env bash
# libisocat as a C programmer meets it: installed, found by pkg-config, a MainDevice linked with it that brings drives into OP, twice
# the same, shared and static; the header in C and C++ without a warning; memory under valgrind. Needs cc; without valgrind, c++ or
# pkg-config their part is left out, and the end is 77.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v cc >/dev/null || { echo "c_door: skipped, missing: cc"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
missing=()
fail() { printf 'c_door: %s\n' "$1"; exit 1; }
has() { command -v "$1" >/dev/null || { missing+=("$1"); return 1; }; }

crates/isocat-c/install.sh --prefix "$folder/usr"
library=$folder/usr/lib/libisocat.so
size=$(stat -Lc %s "$library")
[ "$size" -lt 2150000 ] || fail "libisocat.so has $size bytes; expected fewer than 2150000"
echo "libisocat.so: $size bytes"
if has nm; then
  # No clock, no thread, no socket; and nothing but its own names for others.
  used=$(nm -D --undefined-only "$library" | grep -E ' (clock_gettime|gettimeofday|time|nanosleep|pthread_create|socket)(@|$)' || true)
  [ -z "$used" ] || fail "it uses $used"
  named=$(nm -D --defined-only "$library" | awk '{ print $3 }' | sort)
  declared=$(grep -oE '\bisocat_[a-z0-9_]+\(' "$folder/usr/include/isocat.h" | tr -d '(' | sort -u)
  [ "$named" = "$declared" ] || fail "the library's names are not those of the header: $(diff <(echo "$named") <(echo "$declared"))"
fi

flags=(-I"$folder/usr/include" -L"$folder/usr/lib" -lisocat) static=(-lpthread -lm -ldl -lrt -lutil -lgcc_s)
if has pkg-config; then
  export PKG_CONFIG_PATH=$folder/usr/lib/pkgconfig
  read -ra flags < <(pkg-config --cflags --libs isocat)
  read -ra all < <(pkg-config --static --libs isocat)
  static=("${all[@]:2}")
fi
export LD_LIBRARY_PATH=$folder/usr/lib
strict=(-Wall -Wextra -pedantic -Werror)
example=crates/isocat-c/examples
cc -std=c99 "${strict[@]}" -O2 -o "$folder/main_device" "$example/main_device.c" "$example/port.c" "${flags[@]}"
cc -std=c99 "${strict[@]}" -O2 -o "$folder/c_door" tests/interop/c_door.c "${flags[@]}"
"$folder/c_door" 2
if has c++; then
  c++ -x c++ -std=c++11 "${strict[@]}" -O2 -o "$folder/c_door_cpp" tests/interop/c_door.c "${flags[@]}"
  "$folder/c_door_cpp" 2
fi
cc -std=c99 "${strict[@]}" -O2 -o "$folder/static" "$example/main_device.c" "$example/port.c" -I"$folder/usr/include" \
  "$folder/usr/lib/libisocat.a" "${static[@]}"

for name in main_device main_device static; do
  "$folder/$name" 10000 >"$folder/out" || fail "$name ended with $?: $(cat "$folder/out")"
  grep -q '^10000 cycles, 0 of them incomplete$' "$folder/out" || fail "$(cat "$folder/out")"
  [ ! -e "$folder/first" ] || cmp "$folder/first" "$folder/out" || fail "two runs differ"
  cp "$folder/out" "$folder/first"
done
cat "$folder/first"
# The program of docs/c.md: nothing comes to OP, so there is nothing to judge.
awk '/^```c$/ { on = 1; next } /^```$/ { on = 0 } on' docs/c.md >"$folder/docs.c"
cc -std=c99 "${strict[@]}" -O2 -o "$folder/docs" "$folder/docs.c" "${flags[@]}"
drive='[[subdevice]]\ndevice = "kollmorgen_akd2g"\n'
printf "cycle = \"1ms\"\n$drive$drive" >"$folder/my.toml"
code=0
(cd "$folder" && ./docs >out) || code=$?
[ "$code" -eq 3 ] && grep -qE '^2 SubDevices, after [0-9]+ ns$' "$folder/out" || fail "docs/c.md ended with $code: $(cat "$folder/out")"
# The other side: a drive that never pulses refuses OP, and the MainDevice gives up.
printf "cycle = \"1ms\"\n$drive${drive}misbehave = [\"dead-sync0\"]\n" >"$folder/bad.toml"
"$folder/main_device" 100 "$folder/my.toml" >/dev/null || fail "two drives by themselves: $?"
code=0
"$folder/main_device" 100 "$folder/bad.toml" >"$folder/out" 2>&1 || code=$?
[ "$code" -eq 2 ] || fail "without pulses it ended with $code: $(cat "$folder/out")"
grep -q "does not come to the state" "$folder/out" || fail "$(cat "$folder/out")"

if has valgrind; then
  check=(valgrind --quiet --error-exitcode=9 --leak-check=full --errors-for-leak-kinds=definite,indirect --show-leak-kinds=definite,indirect)
  "${check[@]}" "$folder/main_device" 1000 >/dev/null || fail "main_device under valgrind: $?"
  "${check[@]}" "$folder/c_door" 1 || fail "c_door under valgrind: $?"
  # What the library knows of a type of device stays for the life of a process, once: not more after twenty times.
  stays() { valgrind --leak-check=full "$folder/c_door" "$1" 2>&1 >/dev/null | grep -E 'possibly lost:|still reachable:' | sed 's/==[0-9]*==//'; }
  [ "$(stays 1)" = "$(stays 20)" ] || fail "memory grows: $(stays 1) once, $(stays 20) after twenty times"
  echo "valgrind: no error, nothing lost; stays for the life of a process: $(stays 1 | tr -s '\n ' ' ')"
fi
[ "${#missing[@]}" -eq 0 ] || { echo "c_door: passed, but for what is missing: ${missing[*]}"; exit 77; }
