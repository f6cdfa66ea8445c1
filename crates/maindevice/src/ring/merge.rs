//! Merges two copies into one frame, command by command.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::{Layout, Layouts};
use isocat_wire::frame::{LOCALLY_ADMINISTERED, payload_offset};
use isocat_wire::register;

/// Working counters of a frame's datagrams.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Counts {
    /// Its last broadcast read: SubDevices that answered to the primary port and to the secondary
    /// port.
    pub broadcast: Option<(u16, u16)>,
}

/// What a datagram becomes in copy B.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Role {
    Same,
    Nothing,
    /// It carries the time of another reference clock.
    Led(StationAddress),
}

fn role(layout: &Layout, leader: Option<StationAddress>) -> Role {
    use Command::*;
    let ado = layout.header.ado();
    match (layout.header.command(), leader) {
        (Ok(Fprd | Fpwr | Fprw | Brd | Lrd | Lwr | Lrw), _) => Role::Same,
        (Ok(Bwr | Brw), _) if ado != register::RECEIVE_TIME_0.address => Role::Same,
        (Ok(Frmw), Some(leader)) if ado == register::SYSTEM_TIME.address => Role::Led(leader),
        _ => Role::Nothing,
    }
}

/// Makes copy B of a frame.
pub(super) fn change(bytes: &mut [u8], leader: Option<StationAddress>) {
    let Ok(start) = payload_offset(bytes) else { return };
    let mut layouts = Layouts::new();
    while let Some(Ok(layout)) = layouts.next(&bytes[start..]) {
        let at = start + layout.start;
        match role(&layout, leader) {
            Role::Same => {}
            Role::Nothing => bytes[at] = Command::Nop as u8,
            Role::Led(station) => bytes[at + 2..at + 4].copy_from_slice(&station.0.to_le_bytes()),
        }
    }
}

/// Whether any datagram has a working counter above 0.
pub(super) fn counts(frame: &[u8]) -> bool {
    let Ok(start) = payload_offset(frame) else { return false };
    let payload = &frame[start..];
    let mut layouts = Layouts::new();
    core::iter::from_fn(|| layouts.next(payload)?.ok()).any(|layout| wkc(payload, &layout) > 0)
}

/// Merges both copies into `out`; `None` if they do not belong together.
pub(super) fn merge(
    a: &[u8],
    b: &[u8],
    sent: &[u8],
    leader: Option<StationAddress>,
    out: &mut Vec<u8>,
) -> Option<Counts> {
    use Command::*;
    let start = prepare(a, out)?;
    let (sent, a, b) = (sent.get(start..)?, a.get(start..)?, b.get(start..)?);
    let out = out.get_mut(start..)?;
    let mut counts = Counts::default();
    let mut layouts = Layouts::new();
    while let Some(layout) = layouts.next(sent) {
        let layout = layout.ok()?;
        if layout.end() > a.len().min(b.len()) {
            return None;
        }
        let role = role(&layout, leader);
        if role == Role::Nothing {
            continue;
        }
        let (near, far) = (wkc(a, &layout), wkc(b, &layout));
        put_wkc(out, &layout, near.wrapping_add(far));
        for at in events(&layout) {
            out[at] |= b[at];
        }
        let data = layout.data()..layout.wkc();
        match layout.header.command() {
            Ok(Fprd | Fprw) if far > 0 => out[data.clone()].copy_from_slice(&b[data]),
            Ok(Brd | Brw) => {
                if layout.header.command() == Ok(Brd) {
                    counts.broadcast = Some((near, far));
                }
                data.for_each(|at| out[at] |= b[at]);
            }
            Ok(Lrd | Lrw) => data.for_each(|at| out[at] ^= b[at] ^ sent[at]),
            Ok(Frmw) if near == 0 && leads_all(&layout, role) => {
                out[data.clone()].copy_from_slice(&b[data]);
            }
            _ => {}
        }
    }
    Some(counts)
}

/// Uses copy A alone.
pub(super) fn alone_a(a: &[u8], sent: &[u8], out: &mut Vec<u8>) -> Option<Counts> {
    let start = prepare(a, out)?;
    let (sent, a) = (sent.get(start..)?, a.get(start..)?);
    let mut counts = Counts::default();
    let mut layouts = Layouts::new();
    while let Some(layout) = layouts.next(sent) {
        let layout = layout.ok()?;
        if layout.end() > a.len() {
            return None;
        }
        if layout.header.command() == Ok(Command::Brd) {
            counts.broadcast = Some((wkc(a, &layout), 0));
        }
    }
    Some(counts)
}

/// Uses copy B alone: datagrams that were changed for it become as they were sent.
pub(super) fn alone_b(
    b: &[u8],
    sent: &[u8],
    leader: Option<StationAddress>,
    out: &mut Vec<u8>,
) -> Option<Counts> {
    let start = prepare(sent, out)?;
    out[6] |= LOCALLY_ADMINISTERED;
    let (sent, b) = (sent.get(start..)?, b.get(start..)?);
    let out = out.get_mut(start..)?;
    let mut counts = Counts::default();
    let mut layouts = Layouts::new();
    while let Some(layout) = layouts.next(sent) {
        let layout = layout.ok()?;
        if layout.end() > b.len() {
            return None;
        }
        let role = role(&layout, leader);
        if role == Role::Nothing {
            continue;
        }
        let far = wkc(b, &layout);
        put_wkc(out, &layout, far);
        for at in events(&layout) {
            out[at] = b[at];
        }
        // The time of a clock other than the requested one is not used.
        if role == Role::Same || leads_all(&layout, role) {
            let data = layout.data()..layout.wkc();
            out[data.clone()].copy_from_slice(&b[data]);
        }
        if layout.header.command() == Ok(Command::Brd) {
            counts.broadcast = Some((0, far));
        }
    }
    Some(counts)
}

/// Whether the requested clock is the reference behind the cut.
fn leads_all(layout: &Layout, role: Role) -> bool {
    role == Role::Led(StationAddress(layout.header.adp()))
}

/// Copies `frame` into `out`; returns the offset of its datagrams.
fn prepare(frame: &[u8], out: &mut Vec<u8>) -> Option<usize> {
    out.clear();
    out.extend_from_slice(frame);
    payload_offset(frame).ok()
}

fn wkc(payload: &[u8], layout: &Layout) -> u16 {
    u16::from_le_bytes([payload[layout.wkc()], payload[layout.wkc() + 1]])
}

fn put_wkc(payload: &mut [u8], layout: &Layout, value: u16) {
    payload[layout.wkc()..layout.end()].copy_from_slice(&value.to_le_bytes());
}

/// The bytes of a datagram's event bits.
fn events(layout: &Layout) -> core::ops::Range<usize> {
    layout.data() - 2..layout.data()
}
