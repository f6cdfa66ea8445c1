//! tDiff of a device: the time that it keeps a frame on its way through the processing unit, less
//! the time that it keeps it on its way back.
//!
//! Receive times alone contain only the sum of both ways. So the ports behind the device are closed
//! for a moment. The device then turns the frame around behind the processing unit, and the frame's
//! time away from the device above changes by tDiff. That closed ports add no time is taken from
//! the data sheets. The setting is a temporary one (0x0100 bit 1): the device reverts it by itself
//! after about a second, even if it can no longer be reached.

use isocat_wire::Command;
use isocat_wire::PortNumber;
use isocat_wire::datagram::Address;
use isocat_wire::register;
use isocat_wire::time::Nanos;

use super::bus::{Bus, Trouble, number};
use super::found::Found;
use super::hops::{branch, parents, round_trip};

/// tDiff of each device by position, ns, and its standard error; `None` at the end of a line, and
/// without receive times here or above.
pub(super) fn measure(
    bus: &mut Bus<'_>,
    found: &[Found],
) -> Result<Vec<Option<(f64, f64)>>, Trouble> {
    let parents = parents(found);
    let mut all = Vec::with_capacity(found.len());
    for device in found {
        let above = parents.get(device.position).copied().flatten();
        let above = above.map(|(above, port)| (&found[above], port));
        let leads_on = device.open[1..].iter().any(|open| *open);
        all.push(
            match above.filter(|(above, _)| above.has_times && device.has_times && leads_on) {
                Some(above) => one(bus, device, above, found.len())?,
                None => None,
            },
        );
    }
    Ok(all)
}

/// Measures one device. Its ports are opened and closed in turn, so that the slip of the clocks
/// affects both alike.
fn one(
    bus: &mut Bus<'_>,
    device: &Found,
    above: (&Found, PortNumber),
    count: usize,
) -> Result<Option<(f64, f64)>, Trouble> {
    let control = bus.read_each(&[device.position], register::DL_CONTROL.address, 4)?.remove(0);
    let mut rounds = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let open = readings(bus, device, above, true)?;
        let closed = closed(bus, device, above, &control);
        let heard = std::mem::replace(&mut bus.putting_back, true);
        let back = open_again(bus, device, &control, count);
        bus.putting_back = heard;
        let closed = match (closed, back) {
            (Ok(closed), Ok(())) => closed,
            (Err(trouble), Ok(())) => return Err(trouble),
            (closed, Err(why)) => {
                let first = Box::new(closed.err().unwrap_or_else(|| why.clone()));
                let position = device.position;
                return Err(Trouble::NotPutBack { position, why: Box::new(why), first });
            }
        };
        let (Some(open), Some(closed)) = (mean(&open), mean(&closed)) else { return Ok(None) };
        rounds.push((closed.0 - open.0, closed.1.hypot(open.1)));
    }
    let count = rounds.len() as f64;
    let value = rounds.iter().map(|(value, _)| value).sum::<f64>() / count;
    let error = rounds.iter().map(|(_, error)| error * error).sum::<f64>().sqrt() / count;
    let scatter = rounds.iter().map(|(one, _)| (one - value) * (one - value)).sum::<f64>();
    let scatter = (scatter / (count - 1.0) / count).sqrt();
    Ok(Some((value, error.max(scatter))))
}

/// Takes readings with closed ports. The devices behind are cut off during that time.
fn closed(
    bus: &mut Bus<'_>,
    device: &Found,
    above: (&Found, PortNumber),
    control: &[u8],
) -> Result<Vec<f64>, Trouble> {
    let mut bytes = control.to_vec();
    bytes[0] |= TEMPORARY;
    for port in PortNumber::ALL.into_iter().filter(|port| *port != PortNumber::P0) {
        bytes[1] |= CLOSED << (2 * port.index());
    }
    bus.write(device.position, register::DL_CONTROL.address, &bytes)?;
    readings(bus, device, above, false)
}

/// Restores DL control, and waits until all devices answer again.
fn open_again(
    bus: &mut Bus<'_>,
    device: &Found,
    control: &[u8],
    count: usize,
) -> Result<(), Trouble> {
    bus.write(device.position, register::DL_CONTROL.address, control)?;
    for _ in 0..LOOKS {
        if bus.count()? == count {
            return Ok(());
        }
        bus.wait(PACE)?;
    }
    let found = bus.count()? as u16;
    let address = register::TYPE.address;
    Err(Trouble::Count { position: None, address, expected: count as u16, found })
}

/// The time that frames were away from the device above, less their round trip behind this one.
fn readings(
    bus: &mut Bus<'_>,
    device: &Found,
    (above, port): (&Found, PortNumber),
    open: bool,
) -> Result<Vec<f64>, Trouble> {
    let address = register::RECEIVE_TIME_0.address;
    let mut all = Vec::with_capacity(LATCHES);
    for count in 0..LATCHES {
        let asks = [(Command::Bwr, Address::Broadcast(address), vec![0; 4])];
        if bus.once(&asks)?.is_some() {
            let bytes = bus.read_each(&[above.position, device.position], address, 16)?;
            let times = |at: usize| -> [u32; 4] {
                std::array::from_fn(|port| number(&bytes[at][4 * port..][..4]) as u32)
            };
            let away = branch(above, port, &times(0));
            let behind = if open { round_trip(device, &times(1)) } else { Some(0.0) };
            all.extend(away.zip(behind).map(|(away, behind)| away - behind));
        }
        // The pace is no multiple of ticks or of the teeth of jitter.
        bus.wait(Nanos(PACE.0 / 2 + PACE.0 * (count as i64 * 617 % 997) / 997))?;
    }
    Ok(all)
}

/// Mean and standard error; `None` if most readings were lost.
fn mean(readings: &[f64]) -> Option<(f64, f64)> {
    let count = readings.len() as f64;
    if readings.len() < LATCHES / 2 {
        return None;
    }
    let mean = readings.iter().sum::<f64>() / count;
    let square: f64 = readings.iter().map(|one| (one - mean) * (one - mean)).sum();
    // Readings in ticks of 10 ns may all be equal: the next one might still be another tick.
    Some((mean, (square / (count - 1.0) / count).sqrt().hypot(10.0 / count)))
}

/// DL control, byte 0x0100: the setting ends after about one second.
const TEMPORARY: u8 = 1 << 1;
/// Byte 0x0101, two bits for each port: closed whatever the link state is.
const CLOSED: u8 = 0b11;
const ROUNDS: usize = 3;
/// At this pace the latches take 0.2 s. That is far less than a temporary setting lasts, and less
/// than an idle mailbox or a watchdog notices.
const LATCHES: usize = 48;
const PACE: Nanos = Nanos::millis(4);
/// Number of polls for the devices behind a port that was opened.
const LOOKS: usize = 50;
