//! The drive in a device with another layout of process data than that of our drive.

use isocat_subdevice::Application;
use isocat_subdevice::drive::Drive;
use isocat_sync::Event;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

use crate::profile::DriveLayout;

/// A drive that finds its process data by a layout; the rest of the image stays zero.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaidOutDrive {
    drive: Drive,
    layout: DriveLayout,
}

impl LaidOutDrive {
    pub fn new(layout: DriveLayout) -> Self {
        Self { drive: Drive::default(), layout }
    }
}

impl Application for LaidOutDrive {
    fn event(&mut self, event: Event) {
        self.drive.event(event);
    }

    fn map_outputs(&mut self, outputs: &[u8]) {
        let mut own = [0; Drive::OUTPUT_LEN];
        let DriveLayout { control, target, mode, .. } = self.layout;
        copy(outputs, control, &mut own[0..2]);
        copy(outputs, target, &mut own[2..6]);
        match mode {
            Some(mode) => copy(outputs, mode, &mut own[6..7]),
            // No other mode can be commanded.
            None => own[6] = Drive::CYCLIC_SYNCHRONOUS_POSITION as u8,
        }
        self.drive.map_outputs(&own);
    }

    fn application(&mut self, cycle: Nanos) {
        self.drive.application(cycle);
    }

    fn outputs_valid(&mut self) {
        self.drive.outputs_valid();
    }

    fn latch_inputs(&mut self) {
        self.drive.latch_inputs();
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        let mut own = [0; Drive::INPUT_LEN];
        self.drive.map_inputs(&mut own);
        let DriveLayout { status, position, mode_display, .. } = self.layout;
        put(inputs, status, &own[0..2]);
        put(inputs, position, &own[2..6]);
        if let Some(display) = mode_display {
            put(inputs, display, &own[6..7]);
        }
    }

    fn safe_outputs(&mut self) {
        self.drive.safe_outputs();
    }

    fn power_off(&mut self) {
        self.drive.power_off();
    }

    fn read_object(
        &mut self,
        object: ObjectAddress,
        value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        self.drive.read_object(object, value)
    }

    fn write_object(&mut self, object: ObjectAddress, value: &[u8]) -> Result<(), AbortCode> {
        self.drive.write_object(object, value)
    }
}

/// Copies bytes of an image; does nothing if it is too short.
fn copy(image: &[u8], at: u8, to: &mut [u8]) {
    let at = usize::from(at);
    if let Some(bytes) = image.get(at..at + to.len()) {
        to.copy_from_slice(bytes);
    }
}

fn put(image: &mut [u8], at: u8, bytes: &[u8]) {
    let at = usize::from(at);
    if let Some(place) = image.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The layout has the target before the control word, the status after the position, and no
    /// mode, as in some drives.
    #[test]
    fn a_drive_works_in_any_layout() {
        let layout = DriveLayout {
            control: 4,
            target: 0,
            mode: None,
            status: 5,
            position: 1,
            mode_display: None,
        };
        let mut drive = LaidOutDrive::new(layout);
        let status = |drive: &mut LaidOutDrive| {
            let mut inputs = [0xEE; 7];
            drive.latch_inputs();
            drive.map_inputs(&mut inputs);
            assert_eq!(inputs[0], 0xEE, "what is not the drive's stays");
            (u16::from_le_bytes([inputs[5], inputs[6]]) & 0x6F, inputs[1])
        };
        assert_eq!(status(&mut drive), (0x40, 0));
        for (control, expected) in [(0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)] {
            drive.map_outputs(&[0, 0, 0, 0, control, 0]);
            drive.outputs_valid();
            assert_eq!(status(&mut drive).0, expected);
        }
        drive.map_outputs(&[9, 0, 0, 0, 0x0F, 0]);
        drive.outputs_valid();
        drive.map_outputs(&[9, 0, 0, 0, 0x0F, 0]);
        drive.outputs_valid();
        assert_eq!(status(&mut drive).1, 9);
        // Images that are too short cause no panic.
        drive.map_outputs(&[0]);
        drive.map_inputs(&mut [0; 2]);
    }
}
