//! Buses: a segment in virtual time, the frames that pass it, and faults.

use std::ffi::c_char;
use std::sync::Mutex;

use ::isocat_segment::fault::Order;
use isocat_serve::bus::{LENGTHS, LONGEST};
use isocat_serve::{Answer, Bus, Setup};
use isocat_sim::MainPort;
use isocat_wire::time::{Host, Time};

use crate::failure::{Failure, guard, isocat_code, isocat_error, lock};
use crate::segment::isocat_segment;
use crate::sys;

/// For isocat_bus_receive: an answer at any port.
pub const ISOCAT_ANY_PORT: u32 = 0xFFFFFFFF;
/// Length of the longest frame, bytes, from the destination address on, without check sequence.
pub const ISOCAT_LONGEST_FRAME: usize = 1514;

/// A segment in virtual time.
///
/// Instants are ns of the caller's clock. The bus has a present, which only the caller advances: by
/// isocat_bus_advance, and by isocat_bus_send to the instant of the frame. It never goes back, and
/// advances by at most an hour at once and 30 days in total.
pub struct isocat_bus {
    inside: Mutex<Inside>,
}

pub(crate) struct Inside {
    pub bus: Bus,
    /// The place of the segment's description.
    pub source: String,
}

/// The fate of a frame that was sent.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_sent {
    /// sizeof(isocat_sent).
    pub size: usize,
    /// When the last bit of its answer is back at the port, ns; 0 if the answer is lost.
    pub back_ns: u64,
    /// 1 if an answer comes back; 0 if it is lost, in the segment or by a fault.
    pub comes_back: i32,
    /// The port at which the answer arrives: in an unbroken ring, the other one.
    pub port: u32,
}

/// An answer that has come back.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_arrival {
    /// sizeof(isocat_arrival).
    pub size: usize,
    /// When its last bit came back, ns.
    pub at_ns: u64,
    /// Its length in bytes, from the destination address on, without check sequence.
    pub length: usize,
    /// The port at which it arrived.
    pub port: u32,
    /// Always 0.
    pub reserved: u32,
}

impl isocat_bus {
    /// Locks the bus and calls `work` with it.
    pub(crate) fn with<T>(
        pointer: *const Self,
        work: impl FnOnce(&mut Inside) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let handle = sys::borrow("bus", pointer)?;
        work(&mut *lock("bus", &handle.inside)?)
    }
}

fn port(number: u32) -> Result<MainPort, Failure> {
    match number {
        0 => Ok(MainPort::Primary),
        1 => Ok(MainPort::Secondary),
        _ => Err(Failure::range(format!("port {number}; expected 0, or 1 in a ring"))),
    }
}

const fn number(port: MainPort) -> u32 {
    match port {
        MainPort::Primary => 0,
        MainPort::Secondary => 1,
    }
}

/// Makes a bus from a segment: all SubDevices that are present from the start are switched on at
/// `now_ns`.
///
/// `now_ns`: the present on the caller's clock, ns since any instant; at most 2^63 - 1 minus 30
/// days.
/// `bus`: receives the handle, which is freed by isocat_bus_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_new(
    segment: *const isocat_segment,
    now_ns: u64,
    bus: *mut *mut isocat_bus,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let latest = (i64::MAX - LONGEST.0) as u64;
        if now_ns > latest {
            let text = format!("the instant {now_ns} ns is too late; expected {latest} ns at most");
            return Err(Failure::new(isocat_code::ISOCAT_TIME, text));
        }
        sys::give("bus", bus, || {
            let inside = sys::borrow("segment", segment)?.with(|described| {
                let mut setup = Setup::from(&described.scenario);
                for (position, own) in &described.applications {
                    setup = setup.with_application(*position, *own);
                }
                let source = described.scenario.source.clone();
                Ok(Inside { bus: Bus::new(setup, Time::new(now_ns)), source })
            })?;
            Ok(isocat_bus { inside: Mutex::new(inside) })
        })
    })
}

/// Frees a bus; NULL is ignored. A bus that is in use, for example by the call that a callback
/// comes from, is not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_free(bus: *mut isocat_bus) {
    let used = sys::borrow("bus", bus)
        .and_then(|handle| lock("bus", &handle.inside).map(drop))
        .is_err_and(|failure| failure.code() == isocat_code::ISOCAT_BUSY);
    if !used {
        sys::take(bus);
    }
}

/// The present of a bus, ns.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_now(
    bus: *const isocat_bus,
    now_ns: *mut u64,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        isocat_bus::with(bus, |inside| sys::put("now_ns", now_ns, inside.bus.now().count()))
    })
}

/// Sends a frame at the instant `at_ns`, to which time advances. The frame leaves after the
/// previous frame has left. If an answer comes back, isocat_bus_receive returns it.
///
/// `port`: 0, or 1 for the other end of a ring.
/// `frame`: is copied; 14 to ISOCAT_LONGEST_FRAME bytes, from the destination address on, without
/// check sequence. A frame below 60 bytes takes as long on the wire as one of 60.
/// `sent`: receives the fate of the frame; may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_send(
    bus: *mut isocat_bus,
    port: u32,
    at_ns: u64,
    frame: *const u8,
    length: usize,
    sent: *mut isocat_sent,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let from = self::port(port)?;
        let frame = sys::bytes("frame", frame, length, *LENGTHS.end())?;
        if !sent.is_null() {
            sys::check_size(sent)?;
        }
        isocat_bus::with(bus, |inside| {
            let answer = inside.bus.send(from, Time::new(at_ns), frame)?;
            if sent.is_null() {
                return Ok(());
            }
            sys::fill(sent, isocat_sent::of(answer))
        })
    })
}

impl isocat_sent {
    fn of(answer: Answer) -> Self {
        let size = size_of::<Self>();
        match answer {
            Answer::Back { port, last_bit, .. } => {
                Self { size, back_ns: last_bit.count(), comes_back: 1, port: number(port) }
            }
            Answer::Lost => Self { size, back_ns: 0, comes_back: 0, port: 0 },
        }
    }
}

/// When the next answer is back, ns, at any port; in the past if it was not received yet.
/// ISOCAT_NOTHING if no answer is in flight.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_next_arrival(
    bus: *const isocat_bus,
    at_ns: *mut u64,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        isocat_bus::with(bus, |inside| match inside.bus.next_arrival() {
            Some(at) => sys::put("at_ns", at_ns, at.count()).map(isocat_code::from),
            None => Ok(isocat_code::ISOCAT_NOTHING),
        })
    })
}

/// Takes the next answer that has come back, including copies made by a fault. ISOCAT_NOTHING if
/// there is none. Time does not advance.
///
/// `port`: 0, 1, or ISOCAT_ANY_PORT.
/// `buffer`: holds up to `capacity` bytes. ISOCAT_TOO_SMALL: the answer remains, and `arrival` has
/// its length.
/// `arrival`: receives the data of the answer; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_receive(
    bus: *mut isocat_bus,
    port: u32,
    buffer: *mut u8,
    capacity: usize,
    arrival: *mut isocat_arrival,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let port = if port == ISOCAT_ANY_PORT { None } else { Some(self::port(port)?) };
        isocat_bus::with(bus, |inside| {
            let next = port.map_or_else(|| inside.bus.peek(), |port| inside.bus.peek_at(port));
            let Some(next) = next else { return Ok(isocat_code::ISOCAT_NOTHING) };
            let filled = isocat_arrival {
                size: size_of::<isocat_arrival>(),
                at_ns: next.at.count(),
                length: next.frame.len(),
                port: number(next.port),
                reserved: 0,
            };
            sys::fill(arrival, filled)?;
            sys::copy("buffer", &next.frame, buffer, capacity)?;
            let port = next.port;
            inside.bus.receive_at(port);
            Ok(isocat_code::ISOCAT_OK)
        })
    })
}

/// Advances time to `to_ns`, with all that SubDevices do until then. Advancing to the present is
/// allowed and does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_advance(
    bus: *mut isocat_bus,
    to_ns: u64,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || isocat_bus::with(bus, |inside| Ok(inside.bus.advance(Time::new(to_ns))?)))
}

/// When the bus next processes its SubDevices by itself, ns: for programs that want to know when
/// something may happen. isocat_bus_advance does not need it: it processes all such instants on its
/// way. ISOCAT_NOTHING if nothing will happen by itself.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_next_timeout(
    bus: *const isocat_bus,
    at_ns: *mut u64,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        isocat_bus::with(bus, |inside| match inside.bus.next_timeout() {
            Some(at) => sys::put("at_ns", at_ns, at.count()).map(isocat_code::from),
            None => Ok(isocat_code::ISOCAT_NOTHING),
        })
    })
}

/// Removes (`up` is 0) or restores the link at a port of the MainDevice now.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_link(
    bus: *mut isocat_bus,
    port: u32,
    up: i32,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let port = self::port(port)?;
        isocat_bus::with(bus, |inside| Ok(inside.bus.link(port, up != 0)?))
    })
}

/// Causes a fault now.
///
/// `fault`: a line as for `isocat control` and `[[fault]]` tables (docs/faults.md), for example
/// "drop 3", "pull axis 2 for 500ms", "power-cycle 1", "misbehave 1 dead-sync0", "heal". Faults of
/// the host (stall, late-wake-ups, slow-send, clock of the host) are refused, because the caller is
/// the host.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_fault(
    bus: *mut isocat_bus,
    fault: *const c_char,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let text = sys::text("fault", fault)?;
        isocat_bus::with(bus, |inside| {
            let order = order(inside, text)?;
            inside.bus.inject(order).map_err(|wrong| Failure::bad_input(format!("{text}: {wrong}")))
        })
    })
}

/// Causes a fault at the instant `at_ns`, now or later.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_fault_at(
    bus: *mut isocat_bus,
    at_ns: u64,
    fault: *const c_char,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let text = sys::text("fault", fault)?;
        isocat_bus::with(bus, |inside| {
            let at: Time<Host> = Time::new(at_ns);
            inside.bus.check_plan(at)?;
            let order = order(inside, text)?;
            let planned = inside.bus.inject_at(at, order);
            planned.map_err(|wrong| Failure::bad_input(format!("{text}: {wrong}")))
        })
    })
}

fn order(inside: &Inside, text: &str) -> Result<Order, Failure> {
    let order = Order::parse(text, inside.bus.server().names());
    order.map_err(|wrong| Failure::bad_input(format!("{text}: {wrong}")))
}

/// Ends the session of the MainDevice at its last frame. A later frame begins another session.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_finish(
    bus: *mut isocat_bus,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        isocat_bus::with(bus, |inside| {
            inside.bus.finish();
            Ok(())
        })
    })
}
