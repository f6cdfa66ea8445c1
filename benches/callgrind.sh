# Sourced by the scripts beside it that count instructions. Needs valgrind.
command -v valgrind >/dev/null || { echo "valgrind is missing: apt-get install valgrind" >&2; exit 77; }
release=${CARGO_TARGET_DIR:-target}/release
callgrind=()

# User instructions of one run of PROGRAM ARGUMENTS..., with the options in `callgrind`. Addresses are not shuffled: tables that are
# keyed by them would be walked in another order each time. The last figure counts, those before are of processes that it started.
instructions() {
  setarch -R valgrind --tool=callgrind --callgrind-out-file=/dev/null "${callgrind[@]}" "$@" 2>&1 >/dev/null |
    sed -n 's/.*Collected : //p' | tail -n 1
}

# User instructions of one cycle of PROGRAM N CYCLES, as the difference of a run of SHORT and one of LONG cycles, so that
# all that comes before is in neither figure. Both are written with as many digits: arguments lie above the stack, one more may move
# it by 16 bytes, and copies of what lies there cost up to 0.2 % more or less, which is much in a difference.
cycle() { # SHORT LONG PROGRAM N
  local short long
  short=$(instructions "$3" "$4" "$(printf '%06d' "$1")")
  long=$(instructions "$3" "$4" "$(printf '%06d' "$2")")
  echo $(((long - short) / ($2 - $1)))
}
