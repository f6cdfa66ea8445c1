//! The text of a new segment file: devices in a line or a tree, with cables, clocks to edit, and
//! notes on the next steps.
//!
//! [`NewFile::add`] finds each device a place, as one would wire it: behind the last device with a
//! free port of its kind. Terminals on EBUS get a coupler if there is none.

use std::fmt::Write as _;
use std::sync::Arc;

use isocat_esc::chip::PortKind;
use isocat_wire::PortNumber;
use isocat_wire::time::Nanos;

use crate::profile::{self, Profile};

/// A segment file under construction.
#[derive(Clone, Debug)]
pub struct NewFile {
    /// The bus cycle.
    pub cycle: Nanos,
    /// Its sources, for its head: one line each.
    pub made_of: Vec<String>,
    devices: Vec<Device>,
    wiring: Wiring,
}

/// One device of the file.
#[derive(Clone, Debug)]
pub struct NewDevice {
    /// Its name; it is numbered if the name already exists.
    pub name: String,
    /// Lines that define it, such as `device = "kollmorgen_akd2g"`.
    pub keys: Vec<String>,
    /// Comments after these lines.
    pub notes: Vec<String>,
    /// Position and port of the device upstream. `None`: the last device with a free port of its
    /// kind.
    pub place: Option<(usize, PortNumber)>,
    /// Length of its cable in metres, if known.
    pub cable_m: Option<u32>,
    /// Deviation of its clock in ppm, if known.
    pub clock_ppm: Option<f64>,
}

#[derive(Clone, Debug)]
struct Device {
    what: NewDevice,
    profile: Arc<Profile>,
    connect: Option<(usize, PortNumber)>,
}

/// The free ports of the devices so far. It finds a place for devices whose place is not given.
#[derive(Clone, Debug, Default)]
pub struct Wiring {
    /// Each device with its downstream ports in use.
    devices: Vec<(Arc<Profile>, Vec<PortNumber>)>,
}

impl Wiring {
    /// The last device that has a free port of a kind, and the port.
    pub fn free(&self, kind: PortKind) -> Option<(usize, PortNumber)> {
        // The order is that of frames, except that port 1 is the usual way on.
        let ports = [PortNumber::P1, PortNumber::P2, PortNumber::P3];
        let all = self.devices.iter().enumerate().rev();
        let free = |(position, (profile, taken)): (usize, &(Arc<Profile>, Vec<PortNumber>))| {
            let mut ports = ports.into_iter();
            let port =
                ports.find(|port| profile.esc().port(*port) == kind && !taken.contains(port));
            Some((position, port?))
        };
        all.filter_map(free).next()
    }

    /// Adds a device at a place, or at the last free port of its kind. Returns the place unless it
    /// is port 1 of the device before, which is the default of a segment file.
    pub fn add(
        &mut self,
        profile: Arc<Profile>,
        place: Option<(usize, PortNumber)>,
    ) -> Option<(usize, PortNumber)> {
        let place = place.or_else(|| self.free(profile.esc().port(PortNumber::P0)));
        if let Some((above, port)) = place
            && let Some((_, taken)) = self.devices.get_mut(above)
        {
            taken.push(port);
        }
        let usual = self.devices.len().checked_sub(1).map(|above| (above, PortNumber::P1));
        self.devices.push((profile, Vec::new()));
        place.filter(|_| place != usual)
    }
}

impl NewFile {
    /// A file without devices.
    pub fn new(cycle: Nanos) -> Self {
        Self { cycle, made_of: Vec::new(), devices: Vec::new(), wiring: Wiring::default() }
    }

    /// Number of devices.
    pub fn len(&self) -> usize {
        self.devices.len()
    }

    /// Whether there are no devices.
    pub fn is_empty(&self) -> bool {
        self.devices.is_empty()
    }

    /// Adds a device. Fails with a sentence if there is no free port of its kind.
    pub fn add(&mut self, mut what: NewDevice, profile: Arc<Profile>) -> Result<(), String> {
        let kind = profile.esc().port(PortNumber::P0);
        let is_first = self.devices.is_empty();
        if what.place.is_none() && !is_first && self.wiring.free(kind).is_none() {
            if kind != PortKind::Ebus {
                return Err(format!(
                    "no free copper port for \"{}\"; expected fewer devices, or a junction before it",
                    what.name
                ));
            }
            self.add_coupler()?;
        }
        what.name = self.unique(&what.name);
        let connect = self.wiring.add(profile.clone(), what.place);
        self.devices.push(Device { what, profile, connect });
        Ok(())
    }

    /// Adds a coupler from copper to EBUS: terminals need one before them if a cable leads to them.
    pub fn add_coupler(&mut self) -> Result<(), String> {
        let profile = profile::built_in(COUPLER)
            .ok_or_else(|| format!("the built-in profile {COUPLER} is missing"))?;
        let what = NewDevice {
            name: profile.name.clone(),
            keys: vec![format!("device = {}", quoted(COUPLER))],
            notes: vec!["added: the terminals behind it are on EBUS".to_owned()],
            place: None,
            cable_m: None,
            clock_ppm: None,
        };
        self.add(what, profile)
    }

    fn unique(&self, name: &str) -> String {
        let is_known = |name: &str| self.devices.iter().any(|device| device.what.name == name);
        if !is_known(name) {
            return name.to_owned();
        }
        let numbered = (2..).map(|number| format!("{name} {number}"));
        numbered.into_iter().find(|name| !is_known(name)).unwrap_or_default()
    }

    /// The text; `path` is the file's name in the commands of its head.
    pub fn text(&self, path: &str) -> String {
        let mut text = String::new();
        for line in &self.made_of {
            let _ = writeln!(text, "# {line}");
        }
        text += &format!(
            "#\n# To edit: the cycle, the host, the cables, and the OpMode or mode of each device. `isocat explain KEY` explains a key;\n\
             # docs/segment-file.md has all of them. Then:\n\
             #   isocat plan {path}     does the cycle fit, and with how much slack\n\
             #   isocat run {path}      bring it up in virtual time, and judge it\n\
             #   isocat sweep {path} --seeds 100     ... with other crystals each time\n\
             #   isocat serve {path} --setup-veth ecat     the same for your own MainDevice\n\n\
             cycle = \"{}\"\nfor = \"2s\"\n\n[host]\n",
            self.cycle
        );
        if self.devices.first().is_some_and(|device| device.profile.is_on_ebus()) {
            text += "port = \"ebus\"    # the first device is a terminal: it stands beside an embedded PC\n";
        }
        text += "jitter = \"20us\"    # how late a frame leaves: a real-time kernel; 200us without one\n\
                 # clock = \"+12ppm\"    # how far the host's clock is off\n";
        for device in &self.devices {
            self.write_device(&mut text, device);
        }
        text
    }

    fn write_device(&self, text: &mut String, device: &Device) {
        let Device { what, profile, connect, .. } = device;
        let _ = writeln!(text, "\n[[subdevice]]\nname = {}", quoted(&what.name));
        for line in &what.keys {
            let _ = writeln!(text, "{line}");
        }
        for note in &what.notes {
            let _ = writeln!(text, "# {note}");
        }
        if let Some((above, port)) = connect {
            let name = &self.devices[*above].what.name;
            // A colon in a name would be mistaken for the one before the port.
            let above = if name.contains(':') { above.to_string() } else { name.clone() };
            let _ = writeln!(text, "connect = {}", quoted(&format!("{above}:{}", port.index())));
        }
        if !profile.is_on_ebus() {
            let _ = match what.cable_m {
                Some(metres) => writeln!(text, "cable = \"{metres}m\"    # by its measured delay"),
                None => writeln!(text, "cable = \"10m\""),
            };
            if what.cable_m.is_some_and(|metres| metres > COPPER_M) {
                text.push_str("fibre = true    # copper does not reach so far\n");
            }
        }
        let _ = match what.clock_ppm {
            Some(ppm) => writeln!(text, "clock = \"{ppm:+.3}ppm\"    # as it was measured"),
            None => writeln!(
                text,
                "# clock = \"+20ppm\"    # without it the seed draws it, within 25 ppm as a rule"
            ),
        };
    }
}

/// A text as a quoted TOML string.
pub fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for letter in text.chars() {
        match letter {
            '"' | '\\' => {
                quoted.push('\\');
                quoted.push(letter);
            }
            letter if letter.is_control() => quoted.push(' '),
            letter => quoted.push(letter),
        }
    }
    quoted.push('"');
    quoted
}

/// How far copper reaches, m.
const COPPER_M: u32 = 100;
/// The usual coupler from copper to EBUS.
const COUPLER: &str = "beckhoff_ek1100";
