//! Interesting states, with what they show.

use serde::Serialize;

/// A state by name.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Preset {
    /// Name in links.
    pub id: &'static str,
    /// Its title on the page.
    pub title: &'static str,
    /// What it shows.
    pub shows: &'static str,
    /// The state, as in the address line.
    pub state: &'static str,
}

/// All presets, in the order of the page.
pub const PRESETS: [Preset; 16] = [
    Preset {
        id: "sync",
        title: "Three devices in sync",
        shows: "The way up, then SYNC0 of all devices within some ten nanoseconds.",
        state: "at=0",
    },
    Preset {
        id: "slack-0",
        title: "Slack 0 ns",
        shows: "Outputs are ready in the very nanosecond of SYNC0: in time. The counter 0x1C32:0B stays 0.",
        state: "devices=2&clocks=0ppm&host-clock=0ppm&host-jitter=0ns&phase=300us&copy-time=292670ns",
    },
    Preset {
        id: "slack-1",
        title: "Slack -1 ns",
        shows: "One nanosecond more copy time: the last device finds no new outputs at SYNC0 and counts in 0x1C32:0B.",
        state: "devices=2&clocks=0ppm&host-clock=0ppm&host-jitter=0ns&phase=300us&copy-time=292671ns",
    },
    Preset {
        id: "slack-jitter",
        title: "Jitter eats the slack",
        shows: "The host is late now and then, more than the slack allows: 0x1C32:0B goes up by 3 and down by 1.",
        state: "devices=2&phase=300us&copy-time=276us&force=on&host-jitter=40us&seed=22",
    },
    Preset {
        id: "no-drift",
        title: "No drift compensation",
        shows: "Clocks that nobody leads: SYNC0 edges run apart, 50 ns in each cycle of 1 ms for 50 ppm.",
        state: "drift-compensation=off&cycles=400",
    },
    Preset {
        id: "cut",
        title: "A cable is pulled",
        shows: "Behind the cut, devices miss their outputs at SYNC0, leave OP by themselves and come back with the link.",
        state: "recovery=again&cycles=1500&at=52&faults=in-operation + 50ms: pull 1 for 20ms",
    },
    Preset {
        id: "sm-jitter",
        title: "SM: the host's jitter is the device's",
        shows: "SM-synchronous devices follow the frame, and with it the host's jitter of 200 us.",
        state: "mode=sm&host-jitter=200us",
    },
    Preset {
        id: "dc-jitter",
        title: "DC: the same jitter, steady outputs",
        shows: "The same host; SYNC0 comes from the devices' own clocks, and outputs do not move.",
        state: "mode=dc-sync0&host-jitter=200us",
    },
    Preset {
        id: "sm-sync0",
        title: "SM/SYNC0",
        shows: "SM2 starts: outputs are copied. SYNC0 acts: outputs become valid, inputs are taken.",
        state: "mode=dc-sync0&devices=1&calc-copy=60us",
    },
    Preset {
        id: "sm-sync0-sync1",
        title: "SM/SYNC0/SYNC1",
        shows: "SM2 starts, outputs act at SYNC0, inputs are taken at SYNC1.",
        state: "mode=dc-shift-sync1&devices=1&calc-copy=60us&sync1=250us",
    },
    Preset {
        id: "subordinated",
        title: "Subordinated cycles",
        shows: "SYNC0 runs four times in a bus cycle, SYNC1 marks the bus cycle.",
        state: "mode=dc-subordinated&devices=1&sync0-cycle=250us",
    },
    Preset {
        id: "free-run",
        title: "Free Run",
        shows: "A timer of the device's own: its cycle has nothing to do with that of the bus.",
        state: "mode=free-run&devices=1",
    },
    Preset {
        id: "cyclic",
        title: "SYNC generation: cyclic",
        shows: "Pulse length and cycle above 0: a pulse in each cycle, SYNC1 behind each SYNC0.",
        state: "view=pulses&pulse=100us&sync1=250us",
    },
    Preset {
        id: "single-shot",
        title: "SYNC generation: single shot",
        shows: "Cycle 0: one pulse at the start time, and no more.",
        state: "view=pulses&pulse=100us&sync0-cycle=0ns&sync1=250us",
    },
    Preset {
        id: "cyclic-acknowledge",
        title: "SYNC generation: cyclic acknowledge",
        shows: "Pulse length 0: the signal stays active until the local CPU reads 0x098E.",
        state: "view=pulses&pulse=0ns&acknowledge=300us",
    },
    Preset {
        id: "single-shot-acknowledge",
        title: "SYNC generation: single shot acknowledge",
        shows: "Both 0: one edge at the start time, active until it is acknowledged.",
        state: "view=pulses&pulse=0ns&sync0-cycle=0ns&acknowledge=700us",
    },
];
