#!/usr/bin/env bash
# A foreign witness for the wire: tshark decodes every frame of a run as EtherCAT, and what it shows of commands, addresses
# and working counters is what an EtherCAT segment does. Needs tshark.
set -euo pipefail
cd "$(dirname "$0")/../.."
capture=$(mktemp --suffix .pcapng)
trap 'rm -f "$capture"' EXIT
${ISOCAT:-cargo run --release --quiet --} run --for 200ms --capture "$capture" >/dev/null

count() { tshark -r "$capture" -Y "$1" 2>/dev/null | wc -l; }
expect() { # what, found, test and value
  if [ "$2" "$3" "$4" ]; then echo "ok: $1: $2"; else echo "FAILED: $1: $2, expected $3 $4" >&2; exit 1; fi
}

all=$(count "frame")
expect "frames are in the capture" "$all" -gt 1000
expect "all of them decode as EtherCAT" "$(count "ecat")" -eq "$all"
expect "none is malformed" "$(count "_ws.malformed || _ws.expert.severity >= 8388608")" -eq 0
inbound="eth.src[0] == 12"  # the first ESC sets the locally administered bit: 10 becomes 12
expect "answers carry the source address that the first ESC changes" "$(count "$inbound")" -eq $((all / 2))
# BRD counts every SubDevice; APWR of the station address exactly one; FPRD of an empty mailbox none.
expect "BRD 0x0000 counted by four" "$(count "$inbound && ecat.cmd == 0x07 && ecat.ado == 0x0000 && ecat.cnt == 4")" -gt 0
expect "four station addresses by APWR" "$(count "$inbound && ecat.cmd == 0x02 && ecat.ado == 0x0010 && ecat.cnt == 1")" -ge 1
expect "FRMW of the system time counted by four" "$(count "$inbound && ecat.cmd == 0x0e && ecat.ado == 0x0910 && ecat.cnt == 4")" -gt 100
# Four SubDevices with outputs and inputs: 4 x (2 + 1).
expect "LRW counted 12 in operation" "$(count "$inbound && ecat.cmd == 0x0c && ecat.cnt == 12")" -gt 150
# A datagram that goes out carries a working counter of 0.
expect "sent datagrams that already count" "$(count "!($inbound) && ecat.cnt != 0")" -eq 0
# SDO uploads of 0x1C32 are visible as such.
expect "SDO uploads of 0x1C32" "$(count "ecat_mailbox.coe.sdoidx == 0x1c32")" -gt 20
