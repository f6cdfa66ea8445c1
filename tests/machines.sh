#!/usr/bin/env bash
# README's test command on machines of many kinds: it must end the same on all of them.
#
#   tests/machines.sh [RUNS]    each kind so many times, by default once; a table of all runs
#   tests/machines.sh --brief   one run: stalled and poor, beside whatever else the machine does
#
# The tests are built first; a run is `cargo test --no-fail-fast` with what was built. KINDS="quarter load" picks kinds, TESTS="--lib"
# gives the command more arguments.
#
#   root       as root, undisturbed
#   quarter    a quarter of one processor, by a control group
#   load       eight programs that compute, beside it
#   stalls     all processes of it stopped for 3 s at random instants, as on a virtual machine that its host holds up
#   poor       an ordinary user without rights, without network, without `ip`, whose HOME can't be written
#   tarball    another user, from an archive without .git, in a folder with spaces, a build of its own
#
# Exit 77: not root, which it takes to make these machines.
set -euo pipefail
cd "$(dirname "$0")/.."
[ "$(id -u)" = 0 ] || { echo "machines: skipped, missing: root"; exit 77; }
runs=1 kinds=${KINDS:-root quarter load stalls poor tarball}
case ${1:-} in
  --brief) kinds="brief" ;;
  "") ;;
  *[!0-9]*) echo "usage: tests/machines.sh [RUNS | --brief]" >&2; exit 2 ;;
  *) runs=$1 ;;
esac
folder=$(mktemp -d)
chmod 755 "$folder"
helpers=() sessions=()
finish() {
  [ ${#helpers[@]} -eq 0 ] || kill "${helpers[@]}" 2>/dev/null || true
  # What stands still would stay for ever if this ends before it.
  local session
  for session in "${sessions[@]}"; do pkill -KILL --session "$session" || true; done
  wait 2>/dev/null || true
  rm -rf "$folder"
}
trap finish EXIT

read -ra more <<<"${TESTS:-}"
test=(cargo test --locked --offline --no-fail-fast "${more[@]}")
cargo fetch --locked --quiet
cargo test --locked --quiet --no-run "${more[@]}"

# quarter COMMAND...: in a control group that gets a quarter of one processor.
quarter() {
  local group
  if [ -w /sys/fs/cgroup/cpu/cpu.cfs_quota_us ]; then
    group=/sys/fs/cgroup/cpu/isocat-machines
    mkdir -p "$group"
    echo 25000 >"$group/cpu.cfs_quota_us"
  elif grep -qw cpu /sys/fs/cgroup/cgroup.subtree_control 2>/dev/null; then
    group=/sys/fs/cgroup/isocat-machines
    mkdir -p "$group"
    echo "25000 100000" >"$group/cpu.max"
  else
    echo "no control group for processors"
    return 77
  fi
  (echo $BASHPID >"$group/cgroup.procs" && exec "$@")
}
# load COMMAND...: beside eight programs that compute.
load() {
  local busy=() code=0
  for _ in 1 2 3 4 5 6 7 8; do
    (while :; do :; done) &
    busy+=($!)
  done
  helpers+=("${busy[@]}")
  "$@" || code=$?
  kill "${busy[@]}"
  return $code
}
# stalls COMMAND...: in a session of its own, all of whose processes stand still for 3 s now and then.
stalls() {
  local code=0
  setsid "$@" &
  local session=$!
  sessions+=("$session")
  (
    while kill -0 $session 2>/dev/null; do
      sleep $((RANDOM % 15 + 3)).$((RANDOM % 10))
      pkill -STOP --session $session || continue
      sleep 3
      pkill -CONT --session $session
    done
  ) &
  helpers+=($!)
  wait $session || code=$?
  return $code
}
# poor COMMAND...: to the kernel an ordinary user, who owns the files here and has no rights beyond that; no network, not even a
# loopback that is up; no `ip`; HOME can't be written.
poor() {
  mkdir -p "$folder/programs"
  local cargo=${CARGO_HOME:-$HOME/.cargo} rustup=${RUSTUP_HOME:-$HOME/.rustup}
  unshare --user --net --map-user=1000 --map-group=1000 \
    env HOME=/proc CARGO_HOME="$cargo" RUSTUP_HOME="$rustup" PATH="$(without_ip)" "$@"
}
# PATH without the folders that have `ip`; what else is in these stays by links.
without_ip() {
  local part parts kept=() link=$folder/programs
  IFS=: read -ra parts <<<"$PATH"
  for part in "${parts[@]}"; do
    if [ -x "$part/ip" ]; then
      find "$part" -maxdepth 1 ! -name ip ! -type d -exec ln -sf -t "$link" {} +
      [[ " ${kept[*]} " == *" $link "* ]] || kept+=("$link")
    else
      kept+=("$part")
    fi
  done
  (IFS=:; echo "${kept[*]}")
}
# tarball: an archive of what is committed or about to be, unpacked in a folder with spaces, for the user nobody, without network.
tarball() {
  local tree="$folder/a folder with spaces/isocat"
  mkdir -p "$tree" "$folder"/{toolchain,cargo,upper,work}
  git ls-files -z --cached --others --exclude-standard | xargs -0 ls -d 2>/dev/null | tar -c -T - | tar -x -C "$tree"
  chown -R nobody "$folder/a folder with spaces" "$folder/upper"
  # This user reaches neither root's toolchain nor its registry; in a namespace of its own both are elsewhere.
  local code=0
  # shellcheck disable=SC2016 # expanded there
  unshare --mount --net bash -euc '
    folder=$0
    mount --bind "$1" "$folder/toolchain"
    mount -t overlay overlay -o "lowerdir=$2,upperdir=$folder/upper,workdir=$folder/work" "$folder/cargo"
    # Some packages come with files that their owner alone may read.
    find "$folder/cargo/registry/src" ! -perm -o+r -exec chmod a+rX {} +
    cd "$folder/a folder with spaces/isocat"
    shift 2
    exec setpriv --reuid=nobody --regid=nogroup --clear-groups \
      env -u RUSTUP_HOME HOME=/proc CARGO_HOME="$folder/cargo" PATH="$folder/toolchain/bin:$PATH" "$@"
  ' "$folder" "$(rustc --print sysroot)" "${CARGO_HOME:-$HOME/.cargo}" "${test[@]}" || code=$?
  rm -rf "$folder/a folder with spaces"
  return $code
}

run() { # KIND NUMBER
  local code=0 begin=$EPOCHREALTIME log=$folder/$1-$2.txt
  case $1 in
    root) "${test[@]}" ;;
    brief)
      export -f poor without_ip
      export folder
      stalls bash -c 'poor "$@"' poor "${test[@]}"
      ;;
    tarball) tarball ;;
    *) "$1" "${test[@]}" ;;
  esac >"$log" 2>&1 </dev/null || code=$?
  local span passed failed ignored
  span=$(awk -v a="$begin" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.0f", b - a }')
  read -r passed failed ignored < <(awk '/^test result:/ { p += $4; f += $6; i += $8 } END { print p + 0, f + 0, i + 0 }' "$log")
  printf '%-10s %3d %8s %8d %8d %8d  %s\n' "$1" "$2" "$span" "$passed" "$failed" "$ignored" "exit $code"
  if [ "$code" -eq 77 ]; then
    return
  fi
  if [ "$code" -ne 0 ] || [ "$failed" -ne 0 ] || [ "$passed" -eq 0 ]; then
    bad=$((bad + 1))
    grep -E "^(test .* FAILED|error|---- .* ----)|panicked at" -A 3 "$log" | head -60 || true
    [ -z "${KEEP:-}" ] || cp "$log" "$KEEP/"
  fi
}
bad=0
printf '%-10s %3s %8s %8s %8s %8s\n' machine run seconds passed failed ignored
for number in $(seq "$runs"); do
  for kind in $kinds; do run "$kind" "$number"; done
done
[ "$bad" -eq 0 ] || { echo "machines: $bad of the runs failed"; exit 1; }
