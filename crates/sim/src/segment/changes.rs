//! What changes a segment while it runs: cables, power, other SubDevices, faults of one of them.

use isocat_esc::Chip;
use isocat_subdevice::Misbehaviour;
use isocat_wire::address::PortNumber;
use isocat_wire::time::{Time, True};
use isocat_wire::{AlStatusCode, frame};

use super::Segment;
use crate::cable::{Cable, Direction};
use crate::device::{Device, DeviceSetup};
use crate::disturbance::{BitError, Cause, lines};
use crate::flight::duration;
use crate::watcher::Watcher;
use crate::wiring::End;

impl Segment {
    /// Pulls a cable; the number of a SubDevice names the cable upstream of it. Panics if it was
    /// changed later than `at`, or does not exist.
    pub fn unplug(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.cut(&self.wiring, line, at, Cause::Pulled);
        }
    }

    /// Plugs a cable in again. Panics if it was changed later than `at`, or does not exist.
    pub fn plug(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.restore(&self.wiring, line, at, Cause::Pulled);
        }
    }

    /// Breaks one direction of a cable: the ESC at the receiving end loses its link, the other one
    /// keeps it and sends without effect. Panics as [`unplug`](Self::unplug) does.
    pub fn break_way(&mut self, cable: usize, direction: Direction, at: Time<True>) {
        self.disturbances.cut(&self.wiring, (cable, direction), at, Cause::Broken);
    }

    /// Repairs one direction of a cable. Panics as [`unplug`](Self::unplug) does.
    pub fn mend_way(&mut self, cable: usize, direction: Direction, at: Time<True>) {
        self.disturbances.restore(&self.wiring, (cable, direction), at, Cause::Broken);
    }

    /// Takes the link of the MainDevice's port at a cable away: the cable is cut as if it was
    /// pulled, independent of other changes.
    pub(crate) fn take_link(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.cut(&self.wiring, line, at, Cause::NoPort);
        }
    }

    /// Restores the link of the port.
    pub(crate) fn restore_link(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.restore(&self.wiring, line, at, Cause::NoPort);
        }
    }

    /// Replaces a cable so fast that no link is lost. Takes effect with the next frame. Panics if
    /// there is no cable with this number.
    pub fn replace_cable(&mut self, number: usize, cable: Cable) {
        self.wiring.replace(number, cable);
        self.stale = true;
    }

    /// The same with a cable of another length, mm, with an equal signal speed.
    pub(crate) fn relay(&mut self, number: usize, millimetres: u64) {
        let old = *self.wiring.cable(number).0;
        let new = Cable {
            link_loss: old.link_loss,
            link_gain: old.link_gain,
            ..Cable::of_length(millimetres)
        };
        self.replace_cable(number, new);
    }

    /// Switches a SubDevice off. From `at` on it does nothing, and its neighbours lose their links
    /// to it as if all its cables were pulled. Panics if it, or one of its cables, was changed
    /// later than `at`.
    pub fn power_off(&mut self, device: usize, at: Time<True>) {
        self.disturbances.power(&self.wiring, device, at, false);
    }

    /// Switches a SubDevice on again: it starts in INIT with the reset values of all registers, but
    /// keeps the content of its EEPROM. Its local time begins at 0. Links come back as after
    /// plugging in, over cables that are not pulled and whose other end has power. Panics if it, or
    /// one of its cables, was changed later than `at`.
    pub fn power_on(&mut self, device: usize, at: Time<True>) {
        self.disturbances.power(&self.wiring, device, at, true);
    }

    /// Checks that a SubDevice with this chip can replace another: it needs ports of the same kind
    /// at all cables. Otherwise returns the first port that is missing.
    pub fn takes(&self, position: usize, chip: &Chip) -> Result<(), PortNumber> {
        let old = self.devices[position].esc.chip();
        let wired = |port: &PortNumber| self.wiring.hop(End::Port(position, *port)).is_some();
        let missing = |port: &PortNumber| chip.port(*port) != old.port(*port);
        PortNumber::ALL.into_iter().filter(wired).find(missing).map_or(Ok(()), Err)
    }

    /// Replaces a SubDevice by another one. It has no power yet, and the old one must have none;
    /// its chip must have the ports at which there are cables. Panics otherwise.
    pub(crate) fn replace_device(&mut self, position: usize, setup: DeviceSetup, seed: u64) {
        assert!(!self.devices[position].is_powered(), "SubDevice {position} has its power still");
        if let Err(port) = self.takes(position, &setup.chip) {
            panic!("the other SubDevice {position} has no such port {port}");
        }
        self.wiring.replace_stay(position, &setup.chip);
        self.next_frame.note_chip(&setup.chip);
        let mut device = Device::new(position, setup, seed);
        device.set_lane(self.lane);
        device.power_off(Time::ZERO, &mut Watcher::blind());
        self.devices[position].hand_over_plant(&mut device);
        self.devices[position] = device;
        self.stale = true;
        self.forget_audiences();
    }

    /// The first instant without any frame in flight: `at`, or after the last frame.
    pub(crate) fn behind_frames(&self, at: Time<True>) -> Time<True> {
        let Some((from, start)) = self.last_frame else { return at };
        at.max(start + self.paths[from as usize].round_trip + duration(frame::MAX_LEN))
    }

    /// Writes a register of one SubDevice like a frame that only it sees.
    pub(crate) fn write_register(
        &mut self,
        device: usize,
        at: Time<True>,
        address: u16,
        data: &[u8],
        watch: &mut Watcher,
    ) {
        let device = self.device_mut(device);
        device.write_register(device.oscillator().read(at), address, data, watch);
    }

    /// Begins or ends a misbehaviour of a SubDevice.
    pub(crate) fn misbehave(
        &mut self,
        device: usize,
        at: Time<True>,
        how: Misbehaviour,
        begins: bool,
    ) {
        let device = self.device_mut(device);
        device.misbehave(device.oscillator().read(at), how, begins);
    }

    /// Lets the application of a SubDevice fail.
    pub(crate) fn fail_device(
        &mut self,
        device: usize,
        at: Time<True>,
        code: AlStatusCode,
        watch: &mut Watcher,
    ) {
        let device = self.device_mut(device);
        device.fail(device.oscillator().read(at), code, watch);
    }

    /// Flips a bit on a cable.
    pub fn disturb(&mut self, error: BitError) {
        self.disturbances.disturb(error);
    }
}
