#!/usr/bin/env bash
# A foreign witness for traces: Perfetto's Python package reads them and finds tracks, slices, pulses and counters as they are in a
# run. With Perfetto's trace processor if `TRACE_PROCESSOR` names its binary (the package would load it from the net); else by the
# schema that comes with the package. The output says which. Needs python3 with venv and a package index.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "perfetto==0.59.1" "protobuf==7.36.2"
if [ -z "${ISOCAT:-}" ]; then
  cargo build --release --quiet --bin isocat
  ISOCAT="${CARGO_TARGET_DIR:-target}/release/isocat"
fi
"$ISOCAT" run --for 100ms --trace "$folder/run.perfetto-trace" --waves "$folder/run.vcd" > "$folder/report.txt"
"$folder/venv/bin/python" - "$folder/run.perfetto-trace" "$folder/run.vcd" <<'PYTHON'
import collections, os, re, sys
from google.protobuf.unknown_fields import UnknownFieldSet
from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent

trace = Trace()
trace.ParseFromString(open(sys.argv[1], "rb").read())
processes, tracks, events = {}, {}, collections.defaultdict(list)
for packet in trace.packet:
    if packet.HasField("track_descriptor"):
        described = packet.track_descriptor
        if described.HasField("process"):
            processes[described.uuid] = described.process.process_name
        else:
            tracks[described.uuid] = (processes[described.parent_uuid], described.name, described.HasField("counter"))
    else:
        assert packet.HasField("timestamp") and packet.trusted_packet_sequence_id, packet
        events[tracks[packet.track_event.track_uuid][:2]].append((packet.timestamp, packet.track_event))
for packet in trace.packet:
    for message in [packet, packet.track_event, packet.track_descriptor, packet.track_descriptor.process]:
        assert len(UnknownFieldSet(message)) == 0, message
for rows in events.values():
    rows.sort(key=lambda row: row[0])
names = sorted(processes.values())
assert names == ["MainDevice", "SubDevice 0 (AKD2G axis 1)", "SubDevice 1 (AKD2G axis 2)",
                 "SubDevice 2 (EK1100)", "SubDevice 3 (EL2502-0010 PWM)", "SubDevice 4 (SSC drive axis 3)"], names
steps = ["copy outputs", "application", "outputs valid", "latch inputs", "copy inputs"]
wanted = ["AL state", "SYNC0", "SYNC1", "SM2", "SM3", "SM event missed", *steps, "SYNC0 error", "0x092C"]
for name in names[1:]:
    assert {track for process, track, _ in tracks.values() if process == name} == set(wanted), name
print(f"ok: {len(processes)} processes, {len(tracks)} tracks, {sum(map(len, events.values()))} events")

slices = 0
for (process, track), rows in events.items():
    open_since = []
    for at, event in rows:
        if event.type == TrackEvent.TYPE_SLICE_BEGIN:
            open_since.append(at)
        elif event.type == TrackEvent.TYPE_SLICE_END:
            assert open_since and open_since.pop() <= at, (process, track, at)
            slices += 1
        elif event.type == TrackEvent.TYPE_COUNTER:
            assert event.HasField("counter_value") or event.HasField("double_counter_value"), (process, track)
    assert not open_since, (process, track, open_since)
print(f"ok: {slices} slices, each with its end")

# Pulses are those of the waveforms, whose stamps are ps.
waves, scope, now, codes = collections.defaultdict(list), [], 0, {}
for line in open(sys.argv[2]):
    word = line.split()
    if line.startswith("$scope"):
        scope.append(word[2])
    elif line.startswith("$upscope"):
        scope.pop()
    elif line.startswith("$var"):
        codes[word[3]] = (scope[-1], word[4])
    elif line.startswith("#"):
        now = int(line[1:])
    elif line.startswith("1") and len(word) == 1 and word[0][1:] in codes:
        waves[codes[word[0][1:]]].append(now)
for position, name in enumerate(names[1:]):
    for track, signal in [("SYNC0", "sync0"), ("SM2", "sm2"), ("SM3", "sm3")]:
        stamps = [at for at, _ in events[name, track]]
        [exact] = [times for (scope, what), times in waves.items() if scope.startswith(f"d{position}_") and what == signal] or [[]]
        assert stamps == [ps // 1000 for ps in exact], (name, track)
    pulses = [at for at, _ in events[name, "SYNC0"]]
    if position in (2, 3):
        assert not pulses, "a coupler and Free Run have no SYNC0"
        continue
    apart = [b - a for a, b in zip(pulses, pulses[1:])]
    # A cycle by the reference's oscillator, up to 50 ppm off, and a tick of 10 ns at either end.
    assert len(pulses) >= 100 and max(abs(a - 1_000_000) for a in apart) <= 60 and max(apart) - min(apart) <= 20, (name, min(apart), max(apart))
    errors = [event.double_counter_value for _, event in events[name, "SYNC0 error"]]
    assert len(errors) >= 99 and max(map(abs, errors)) < 100, (name, len(errors))
    states = [event.name for _, event in events[name, "AL state"] if event.type == TrackEvent.TYPE_SLICE_BEGIN]
    assert states == ["INIT", "PREOP", "SAFEOP", "OP"], states
    print(f"ok: {name}: {len(pulses)} pulses at the ns of the waveforms, {min(apart)} to {max(apart)} ns apart")
for track in ["frames", "host phase error", "servo"]:
    assert events["MainDevice", track], track

binary = os.environ.get("TRACE_PROCESSOR")
if binary:
    from perfetto.trace_processor import TraceProcessor, TraceProcessorConfig
    processor = TraceProcessor(trace=sys.argv[1], config=TraceProcessorConfig(bin_path=binary))
    found = processor.query("select count(*) as n from slice where dur < 0").as_pandas_dataframe()
    assert found["n"][0] == 0, "slices without an end"
    print("ok: read by Perfetto's schema and its trace processor")
else:
    print("ok: read by Perfetto's schema (perfetto_trace_pb2); the trace processor's binary is not in the package")
PYTHON
