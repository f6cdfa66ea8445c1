//! Compares isocat's own export with the run that made it, on the wire: what both write to each
//! register and object of each SubDevice, in order.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use isocat_descriptions::eni::{self, Eni};
use isocat_engine::plan::Plan;
use isocat_player::{Settings, play_with};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::Tap;
use isocat_wire::al::AlState;
use isocat_wire::coe::sdo::{INITIATE_LEN, Initiate, specifier};
use isocat_wire::datagram::datagrams;
use isocat_wire::time::{Nanos, Time, True};
use isocat_wire::{Command, ObjectAddress, coe, frame, mailbox, register};

/// Values by register, in the order of the wire.
type Registers = BTreeMap<u16, Vec<Vec<u8>>>;

/// The writes to each SubDevice, by position, after it has got its station address: earlier writes,
/// which clear registers, do not belong to a start-up list.
#[derive(Clone, Default, Debug)]
struct Writes {
    stations: Vec<Option<u16>>,
    devices: Vec<Registers>,
    /// SDO downloads: object and value.
    objects: Vec<Vec<(ObjectAddress, Vec<u8>)>>,
}

impl Writes {
    fn of(count: usize) -> Self {
        Self {
            stations: vec![None; count],
            devices: vec![Registers::new(); count],
            objects: vec![Vec::new(); count],
        }
    }

    fn frame(&mut self, bytes: &[u8]) {
        for datagram in datagrams(frame::payload(bytes).expect("a frame of ours")) {
            let datagram = datagram.expect("whole");
            let (header, data) = (datagram.header, datagram.data);
            let count = self.devices.len();
            let reached: Vec<usize> = match header.command() {
                Ok(Command::Apwr) => vec![usize::from(header.adp().wrapping_neg())],
                Ok(Command::Fpwr) => {
                    let is_meant = |at: &usize| self.stations[*at] == Some(header.adp());
                    (0..count).filter(is_meant).collect()
                }
                Ok(Command::Bwr) => (0..count).collect(),
                _ => continue,
            };
            for position in reached.into_iter().filter(|at| *at < count) {
                self.write(position, header.ado(), data);
            }
        }
    }

    fn write(&mut self, position: usize, register: u16, data: &[u8]) {
        if register == register::STATION_ADDRESS.address {
            let station = u16::from_le_bytes([data[0], data[1]]);
            // Writing 0 removes an earlier station address.
            self.stations[position] = (station != 0).then_some(station);
        }
        if register >= 0x1000
            && let Some(download) = download(data)
            && self.objects[position].last() != Some(&download)
        {
            self.objects[position].push(download);
        }
        if self.stations[position].is_none() || !is_decided(register) {
            return;
        }
        // A list begins in INIT and acknowledges with its first request; the run requests INIT
        // before that, and acknowledges then.
        let control = register == register::AL_CONTROL.address;
        let data = if control { &[data[0] & 0x0F, data[1]][..] } else { data };
        if control && data[0] == AlState::Init as u8 {
            return;
        }
        let values = self.devices[position].entry(register).or_default();
        // A repeated write, after a late answer, changes nothing.
        if values.last().is_none_or(|last| last != data) {
            values.push(data.to_vec());
        }
    }
}

/// The object and the value of an SDO download request in a mailbox message.
fn download(message: &[u8]) -> Option<(ObjectAddress, Vec<u8>)> {
    let header = mailbox::Header::parse(message.first_chunk()?);
    let body = message.get(mailbox::HEADER_LEN..)?;
    if header.protocol != mailbox::Protocol::COE {
        return None;
    }
    let service = coe::Header::parse(*body.first_chunk()?).service;
    let body = body.get(coe::HEADER_LEN..)?;
    let head = Initiate::parse(body.first_chunk()?);
    let is_download = head.command.specifier() == specifier::REQUEST_DOWNLOAD;
    if service != coe::Service::SDO_REQUEST || !is_download {
        return None;
    }
    let value = match head.command.expedited() {
        true => head.data[..head.command.expedited_len()].to_vec(),
        false => body.get(INITIATE_LEN..INITIATE_LEN + head.value() as usize)?.to_vec(),
    };
    Some((head.object, value))
}

/// The registers whose values a list determines. The others are measured (offset, delay, start
/// time), belong to the leading and measuring of clocks (latches, drift frames, filters), to an
/// EEPROM or to an error counter. Memory from 0x1000 on is mailboxes and process data.
fn is_decided(register: u16) -> bool {
    let own = [0x0300..0x0314, 0x0500..0x0510, 0x0900..0x0940, 0x0990..0x0998, 0x1000..0xFFFF];
    !own.iter().any(|range| range.contains(&register))
}

/// Records what the run's MainDevice sends.
struct Witness(Rc<RefCell<Writes>>);

impl Tap for Witness {
    fn frame(&mut self, _at: Time<True>, sent: bool, bytes: &[u8]) {
        if sent {
            self.0.borrow_mut().frame(bytes);
        }
    }
}

/// Compares both; returns the number of SDO downloads to each SubDevice.
fn the_same_on_the_wire(text: &str) -> Vec<usize> {
    let mut scenario = Scenario::from(SegmentFile::parse("test.toml", text).unwrap());
    scenario.duration = Nanos::millis(50);
    let count = scenario.devices.len();
    let seen = Rc::new(RefCell::new(Writes::of(count)));
    let run = scenario.run().execute(Some(Witness(seen.clone())), &mut |_| {});
    assert!(run.failure.is_none());
    let ours = seen.borrow().devices.clone();
    let downloads = seen.borrow().objects.clone();

    let export = eni::write(&Plan::of(&scenario).unwrap().start_up(&scenario));
    let eni = Eni::from_bytes("own.xml", export.as_bytes()).unwrap();
    let settings = Settings { duration: scenario.duration, tolerates_unknown_objects: false };
    let mut writes = Writes::of(count);
    let list = eni.runnable().unwrap();
    let played = play_with(list, &scenario, settings, &mut |_, bytes| writes.frame(bytes));
    assert!(played.failure.is_none(), "{}", played.failure.unwrap());

    assert_eq!(downloads, writes.objects, "SDO downloads by position");
    for (position, (one, other)) in ours.iter().zip(&writes.devices).enumerate() {
        let registers: std::collections::BTreeSet<u16> =
            one.keys().chain(other.keys()).copied().collect();
        let differs = |register: &u16| one.get(register) != other.get(register);
        let different: Vec<_> = registers
            .iter()
            .filter(|register| differs(register))
            .map(|at| format!("0x{at:04X}: run {:02X?}, ENI {:02X?}", one.get(at), other.get(at)))
            .collect();
        assert!(different.is_empty(), "SubDevice {position}:\n{}", different.join("\n"));
        // A comparison of nothing would succeed, too.
        let al_control = register::AL_CONTROL.address;
        assert!(registers.contains(&al_control), "SubDevice {position}: {registers:04X?}");
    }
    downloads.iter().map(Vec::len).collect()
}

#[test]
fn two_drives_get_the_same_writes() {
    the_same_on_the_wire(
        "cycle = \"1ms\"\n\
         [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nclock = \"40ppm\"\n\
         [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nclock = \"-35ppm\"\n",
    );
}

#[test]
fn couplers_terminals_and_drives_get_the_same_writes() {
    let downloads = the_same_on_the_wire(
        "cycle = \"2ms\"\n\
         [[subdevice]]\ndevice = \"beckhoff_ek1100\"\n\
         [[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\n\
         [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nconnect = \"0:2\"\n\
         [[subdevice]]\ndevice = \"hpmicro_ecat_cia402_ssc\"\n",
    );
    assert!(downloads[3] >= 2, "{downloads:?}");
}

#[test]
fn a_device_without_clock_gets_the_same_writes() {
    the_same_on_the_wire("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n");
}
