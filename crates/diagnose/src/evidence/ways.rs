//! How long frames take to each device, by the times at which they came in at its ports.

use isocat_wire::{PortNumber, register};

use crate::device::Device;
use crate::observer::Observer;

/// How long frames take from the first device to each other one, ns, by position, by the times at
/// which their first bit came in at each port (0x0900).
///
/// A frame goes through the ports in the order 0, 3, 1, 2, and comes back at each before it leaves
/// by the next. What passes between two of them is the way to the device behind the second one and
/// back, and what that device and all behind it take.
pub(super) fn ways(observer: &Observer) -> Vec<Option<i64>> {
    let count = u16::try_from(observer.devices.list.len()).unwrap_or(u16::MAX);
    let mut ways: Vec<Option<i64>> = Vec::new();
    // Devices on the path to the present one, with the ports behind which devices are to come.
    let mut path: Vec<Ports<'_>> = Vec::new();
    for position in 0..count {
        let Some(device) = observer.devices.at(position).map(|at| &observer.devices.list[at])
        else {
            break;
        };
        let Some(ports) = Ports::of(device, usize::from(position)) else { break };
        while path.pop_if(|last| last.open.len() == 1).is_some() {}
        let way = match path.last_mut() {
            None if position == 0 => Some(0),
            None => break,
            Some(parent) => {
                let behind = parent.next();
                let before = ways[parent.position];
                before
                    .zip(behind)
                    .zip(ports.takes())
                    .map(|((before, (to, spent)), own)| before + spent + (to - own) / 2)
            }
        };
        ways.push(way.filter(|way| (0..LONGEST_NS).contains(way)));
        path.push(ports);
    }
    while path.pop_if(|last| last.open.len() == 1).is_some() {}
    // Something is behind a port that is none of these devices. In a ring that is the MainDevice's
    // second port, and frames of the other direction set the times.
    if !path.is_empty() {
        ways.fill(None);
    }
    ways
}

/// The longest way that can be one, ns: light takes it through 200 km of fibre. What is longer, or
/// negative, are times of different frames.
const LONGEST_NS: i64 = 1_000_000;

/// The open ports of a device, in the order in which frames pass them.
struct Ports<'a> {
    device: &'a Device,
    position: usize,
    /// The port at which the frame came back last, and those that follow.
    open: Vec<PortNumber>,
}

impl<'a> Ports<'a> {
    fn of(device: &'a Device, position: usize) -> Option<Self> {
        let status = device.image.read(register::DL_STATUS)?.value;
        let order = PortNumber::PROCESSING_ORDER.into_iter();
        let open = order.filter(|port| *port == PortNumber::P0 || status.communication(*port));
        Some(Self { device, position, open: open.collect() })
    }

    fn time(&self, port: PortNumber) -> Option<u32> {
        let of_port = [
            register::RECEIVE_TIME_0,
            register::RECEIVE_TIME_1,
            register::RECEIVE_TIME_2,
            register::RECEIVE_TIME_3,
        ];
        self.device.image.read(of_port[port as usize]).map(|known| known.value)
    }

    /// From the first port to a later one, ns.
    fn until(&self, port: PortNumber) -> Option<i64> {
        Some(self.time(port)?.wrapping_sub(self.time(PortNumber::P0)?).into())
    }

    /// What the device and all behind it take.
    fn takes(&self) -> Option<i64> {
        match self.open[..] {
            [] | [_] => Some(0),
            [.., last] => self.until(last),
        }
    }

    /// The time that passes behind the next port, and what passed before it.
    fn next(&mut self) -> Option<(i64, i64)> {
        let before = self.open.remove(0);
        let spent = if before == PortNumber::P0 { Some(0) } else { self.until(before) };
        let spent = spent?;
        Some((self.until(*self.open.first()?)? - spent, spent))
    }
}
