//! The judges' knowledge of a served segment as a status: the answer to the request `watch`.

use isocat_engine::status::edges::Onlooker;
use isocat_engine::status::{Counter, Device, Event, Kind, Stage, Status};
use isocat_wire::AlState;
use isocat_wire::register;
use isocat_wire::time::{Nanos, Picos};

use crate::server::{self, Server};

/// Number of intervals in `recent`, so that a reader who asks from time to time misses none.
pub(crate) const INTERVALS: usize = 20;
/// Length of an interval.
pub(crate) const INTERVAL: Picos = Picos(100_000_000_000);
/// Number of events that each status repeats.
pub const MOST_EVENTS: usize = 64;

/// The present status of a served segment.
pub fn status(server: &Server, segment: &str, onlooker: &Onlooker) -> Status {
    let served = server.served();
    let judged = server.judged();
    let session = server.session();
    let bench = served.bench();
    let judging = session.is_some_and(|session| session.is_judged());
    let cycle = bench.host_phase().and(bench.intent()).map_or(Nanos::ZERO, |i| i.send.cycle);
    let cycle = if judging { cycle.0 } else { 0 };
    let limit = server.sync0_limit().0 / 1000;
    let mut status = Status::new(segment.to_owned(), Kind::Served, cycle, limit);
    status.at_ns = served.now().as_nanos() as i64;
    status.stage = match (session.is_some(), judging) {
        (false, _) => Stage::NoMainDevice,
        (true, false) => Stage::BroughtUp,
        (true, true) => Stage::InOperation,
    };
    let began = judged.as_ref().filter(|_| judging).map(|judged| judged.began);
    status.operation_ns = began.map(|began| (served.now() - began).0 / 1000);
    let counts = server.counts();
    status.host.frames_sent = counts.frames;
    status.host.frames_lost = counts.lost;
    let reference = server.reference();
    let devices = served.segment().devices().iter().enumerate();
    status.devices = devices
        .map(|(position, device)| {
            let name = server.names()[position].clone();
            let mut out = Device::new(position, name);
            let (sync, esc) = (device.stack.sync(), &device.esc);
            out.mode = sync.mode().name().into();
            out.has_sync = esc.sync_active() && sync.mode().uses_dc();
            out.is_reference = position == reference;
            // A SubDevice that its MainDevice does not ask to be in OP need not be there.
            out.asked = esc.register(register::AL_CONTROL).state() == Ok(AlState::Op);
            out.al_state = Some(device.stack.state());
            out.al_code = device.stack.status_code().0;
            out.al_error = esc.al_status().error();
            let before =
                judged.as_ref().map_or([0; 4], |judged| judged.devices[position].counters_before);
            let now: [u32; 4] = [
                sync.sm_event_missed().into(),
                sync.cycle_time_too_small().into(),
                sync.shift_time_too_short().into(),
                sync.sync_error().into(),
            ];
            for ((counter, now), before) in out.outputs.iter_mut().zip(now).zip(before) {
                let risen = now.checked_sub(before).unwrap_or(now);
                *counter = Counter { value: Some(now), risen: risen.into() };
            }
            if let Some(judges) = bench.devices().get(position) {
                // Counter 0B also counts down; the judge counts each missed event.
                out.outputs[0].risen = judges.missed.count();
            }
            out
        })
        .collect();
    if judging {
        onlooker.over(&mut status, bench);
        // The due times of a foreign MainDevice's frames are not known.
        status.host.phase_error_ns = None;
        status.host.phase_error_worst_ns = None;
    } else {
        status.since_ns = status.at_ns;
    }
    status.events = server.told().cloned().collect();
    status
}

/// The status event of an event of the segment, at `now_ns` of its time.
pub fn event(event: &server::Event, now_ns: i64) -> Event {
    use server::Event as Happened;
    let (at_ns, position, bad, what) = match event {
        Happened::SessionBegan { .. } => (now_ns, None, false, "a MainDevice begins".to_owned()),
        Happened::State { at, device, state, code } => {
            let why = if code.0 == 0 { String::new() } else { format!(", {code}") };
            let bad = code.0 != 0;
            (at.as_nanos() as i64, Some(*device), bad, format!("{state}{why}"))
        }
        Happened::InOperation { devices } => {
            (now_ns, None, false, format!("in operation: {devices} SubDevices"))
        }
        Happened::Fault(fault) => (now_ns, None, true, fault.to_string()),
        Happened::SessionEnded { abrupt } => {
            let how = if *abrupt { ", in the middle" } else { "" };
            (now_ns, None, *abrupt, format!("the MainDevice ends{how}"))
        }
    };
    Event { at_ns, position, bad, alarm: false, what }
}
