//! Finds the place of a dead line: one that takes frames and gives none back, so that the whole
//! segment is silent.
//!
//! Frames still pass what lies before the dead line on their way out, so that its settings can be
//! written by position. Each SubDevice gets its ports closed but the one towards the MainDevice
//! (0x0101), from the first one on, and opened again one by one; the port after which frames stay
//! away is the dead one. It stays closed, and all before it works.

use std::sync::atomic::AtomicBool;

use isocat_conform::wire::Wire;
use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_wire::datagram::Address;
use isocat_wire::{Command, register};

use crate::calibrate::Trouble;
use crate::calibrate::bus::{self, Bus};

/// What a rescue found.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Rescue {
    /// Frames came back from the start, from this number of SubDevices; nothing was written.
    Alive(usize),
    /// Frames stay away whatever is closed: the first line is dead, or nothing answers there.
    FirstLine,
    /// Frames come back now.
    Rescued {
        /// SubDevices that answer.
        devices: usize,
        /// Ports that gave no frame back. They are closed.
        dead: Vec<DeadPort>,
    },
}

/// A port that gives no frame back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DeadPort {
    /// Position of the SubDevice.
    pub device: usize,
    /// Its port, 1 to 3.
    pub port: u8,
}

/// Looks for the dead line, and closes the port before it. If that ends early, all ports that can
/// be reached are opened again.
pub fn rescue(wire: &mut dyn Wire, stop: &AtomicBool) -> Result<Rescue, Trouble> {
    let mut search = Search { bus: Bus::new(wire, stop), devices: 0, dead: Vec::new() };
    let found = search.run();
    if found.is_err() {
        search.bus.putting_back = true;
        let open = (Command::Bwr, Address::Broadcast(LOOPS), vec![0]);
        search.bus.once(&[open])?;
    }
    found
}

struct Search<'w> {
    bus: Bus<'w>,
    /// SubDevices that answer.
    devices: usize,
    dead: Vec<DeadPort>,
}

impl Search<'_> {
    fn run(&mut self) -> Result<Rescue, Trouble> {
        if let Some(devices) = self.count()? {
            return Ok(Rescue::Alive(devices));
        }
        self.set(0, CLOSED)?;
        match self.count()? {
            None | Some(0) => {
                // The write may have reached it, though nothing came back.
                self.set(0, 0)?;
                return Ok(Rescue::FirstLine);
            }
            Some(devices) => self.devices = devices,
        }
        self.explore()?;
        Ok(Rescue::Rescued { devices: self.devices, dead: std::mem::take(&mut self.dead) })
    }

    /// Opens the ports of each SubDevice one by one, in the order in which frames visit them, and
    /// those of what comes to light behind each. All others are closed, or were explored.
    fn explore(&mut self) -> Result<(), Trouble> {
        // The way to the port in question: each SubDevice with its loops, and how many of its ports
        // were tried. A line may be thousands long, so this is no recursion.
        let mut way = vec![(0, CLOSED, 0)];
        while let Some((device, loops, tried)) = way.last_mut() {
            let Some(port) = ORDER.get(*tried).copied() else {
                way.pop();
                continue;
            };
            *tried += 1;
            let (device, closed) = (*device, *loops);
            let open = closed & !(0b11 << (2 * port));
            self.set(device, open)?;
            // The SubDevice behind that port must not pass frames on before it was counted.
            let next = self.devices;
            self.set(next, CLOSED)?;
            match self.count()? {
                // Without a link the port closes by itself.
                Some(found) => {
                    *loops = open;
                    self.devices = found;
                    if found > next + 1 {
                        let why = format!(
                            "SubDevice {next} passes frames on though its ports 1 to 3 are closed: frames enter it at another port \
                             than 0 (IN and OUT swapped), and the place of a dead line can't be told. All ports are open again"
                        );
                        return Err(Trouble::Own(why));
                    }
                    if found == next + 1 {
                        way.push((next, CLOSED, 0));
                    }
                }
                None => {
                    self.dead.push(DeadPort { device, port });
                    self.set(device, closed)?;
                    if self.count()? != Some(next) {
                        return Err(Trouble::Lost { address: LOOPS });
                    }
                }
            }
        }
        Ok(())
    }

    /// How many SubDevices answer; `None` if frames stay away.
    fn count(&mut self) -> Result<Option<usize>, Trouble> {
        match self.bus.count() {
            Ok(devices) => Ok(Some(devices)),
            Err(Trouble::Lost { .. }) => Ok(None),
            Err(trouble) => Err(trouble),
        }
    }

    /// Sets the loops of a SubDevice. The frame need not come back, so it is sent twice.
    fn set(&mut self, device: usize, loops: u8) -> Result<(), Trouble> {
        for _ in 0..2 {
            if self.bus.once(&[bus::write(device, LOOPS, vec![loops])])?.is_some() {
                break;
            }
        }
        Ok(())
    }
}

impl Rescue {
    /// The result in words, a paragraph for each port.
    pub fn text(&self) -> String {
        let mut all = vec![match self {
            Self::Alive(devices) => format!("Frames come back, from {devices} SubDevices: there is nothing to rescue."),
            Self::FirstLine => "No frame comes back, whatever is closed: the line from the MainDevice to the first SubDevice \
                is dead, or nothing that is on is connected. Look at that cable, at both of its plugs, and at the power of \
                the first SubDevice. No port is closed."
                .to_owned(),
            Self::Rescued { devices, .. } => format!("Frames come back now, from {devices} SubDevices."),
        }];
        if let Self::Rescued { dead, .. } = self {
            all.extend(dead.iter().map(|DeadPort { device, port }| format!(
                "Port {port} of SubDevice {device} takes frames and gives none back: look at the cable there, at both of its \
                 plugs, and at the device behind it. The port is closed now (0x0101) and stays so until somebody opens it, as \
                 a scan does: what is behind it is cut off."
            )));
            if dead.is_empty() {
                all.push("No port is dead any more: the line came back by itself. Look for a loose plug.".to_owned());
            }
        }
        let lines = all.iter().flat_map(|paragraph| wrap(paragraph, WIDTH));
        lines.map(|line| line + "\n").collect()
    }
}

/// DL control, second byte: two bits for each port.
const LOOPS: u16 = register::DL_CONTROL.address + 1;
/// Ports in the order in which frames visit them; frames enter at port 0.
const ORDER: [u8; 3] = [3, 1, 2];
/// Port 0 as after power-on, the others closed.
const CLOSED: u8 = 0b1111_1100;
