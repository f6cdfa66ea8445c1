#!/usr/bin/env bash
# A foreign witness for the wire: tshark decodes every frame of a run as EtherCAT, and what it shows of commands, addresses
# and working counters is what an EtherCAT segment does. Needs tshark.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
capture="$folder/run.pcapng"
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
expect "BRD 0x0000 counted by five" "$(count "$inbound && ecat.cmd == 0x07 && ecat.ado == 0x0000 && ecat.cnt == 5")" -gt 0
expect "five station addresses by APWR" "$(count "$inbound && ecat.cmd == 0x02 && ecat.ado == 0x0010 && ecat.cnt == 1")" -ge 1
expect "FRMW of the system time counted by five" "$(count "$inbound && ecat.cmd == 0x0e && ecat.ado == 0x0910 && ecat.cnt == 5")" -gt 100
# Four SubDevices with outputs and inputs: 4 x (2 + 1).
expect "LRW counted 12 in operation" "$(count "$inbound && ecat.cmd == 0x0c && ecat.cnt == 12")" -gt 150
# A datagram that goes out carries a working counter of 0.
expect "sent datagrams that already count" "$(count "!($inbound) && ecat.cnt != 0")" -eq 0
# SDO uploads of 0x1C32 are visible as such.
expect "SDO uploads of 0x1C32" "$(count "ecat_mailbox.coe.sdoidx == 0x1c32")" -gt 20

# A capture with a place in front of SubDevice 2, which misses one copy in twenty.
capture="$folder/taps.pcapng"
printf 'cycle = "1ms"\n' > "$folder/taps.toml"
for axis in 1 2 3; do
  printf '[[subdevice]]\ndevice = "kollmorgen_akd2g"\nname = "axis %s"\n' "$axis" >> "$folder/taps.toml"
done
printf 'misbehave = ["missed-copy 20"]\n' >> "$folder/taps.toml"
${ISOCAT:-cargo run --release --quiet --} run "$folder/taps.toml" --for 200ms --capture "$capture" --tap 2 > /dev/null || [ $? -eq 1 ]
fields() { tshark -r "$capture" -Y "$1" -T fields -e "$2" 2>/dev/null; }
expect "two interfaces" "$(fields frame frame.interface_name | sort -u | paste -sd ' ')" = "main subdevice-2"
main="frame.interface_name == \"main\""
probe="frame.interface_name == \"subdevice-2\""
entering="$probe && frame.packet_flags_direction == 1"
leaving="$probe && frame.packet_flags_direction == 2"
passes=$(count "$main && frame.packet_flags_direction == 2")
expect "frames that enter SubDevice 2, as the MainDevice sent" "$(count "$entering")" -eq "$passes"
expect "frames that leave SubDevice 2" "$(count "$leaving")" -eq "$passes"
expect "packets out of the order of time" "$(fields frame frame.time_epoch | sort -s -n -c 2>&1 | wc -l)" -eq 0
# Two SubDevices before it with outputs and inputs (2 + 1 each), three behind it; clocks: 2, then 3.
expect "LRW counted 6 before SubDevice 2" "$(count "$entering && ecat.cmd == 0x0c && ecat.cnt == 6")" -gt 150
expect "LRW counted 9 before SubDevice 2" "$(count "$entering && ecat.cmd == 0x0c && ecat.cnt == 9")" -eq 0
expect "LRW counted 9 behind SubDevice 2" "$(count "$leaving && ecat.cmd == 0x0c && ecat.cnt == 9")" -gt 150
expect "FRMW counted 2 before SubDevice 2" "$(count "$entering && ecat.cmd == 0x0e && ecat.cnt == 2")" -gt 100
expect "FRMW counted 3 behind SubDevice 2" "$(count "$leaving && ecat.cmd == 0x0e && ecat.cnt == 3")" -gt 100
# Exact nanoseconds: what a frame stays in the SubDevice is the same each time, but for the ps that are cut off.
stays=$(fields "$probe" frame.time_epoch | awk '{ split($1, t, "."); ns = t[2] + 0; if (NR % 2) in_ns = ns; else print (ns - in_ns + 1000000000) % 1000000000 }' | sort -n | uniq)
expect "lengths of a stay in SubDevice 2, ns: $(paste -sd ' ' <<<"$stays")" "$(wc -l <<<"$stays")" -le 2
expect "their spread, ns" "$(( $(tail -1 <<<"$stays") - $(head -1 <<<"$stays") ))" -le 1
expect "stamps that are whole microseconds" "$(fields frame frame.time_epoch | grep -c '000$')" -lt $((passes / 50))
expect "comments: SubDevice 2 in OP" "$(count 'frame.comment contains "SubDevice 2 (axis 3): now in OP"')" -eq 1
expect "comments: missed events" "$(count 'frame.comment contains "SubDevice 2 (axis 3): SM event missed, 0x1C32:0B now "')" -gt 5
