//! A drive: the CiA 402 state machine with cyclic synchronous position.

use isocat_wire::{AbortCode, ObjectAddress};

use crate::application::Application;

/// A drive that follows its target position.
///
/// Its process data are fixed: outputs 0x6040 control word (16 bits), 0x607A target position (32),
/// 0x6060 mode of operation (8); inputs 0x6041 status word (16), 0x6064 position actual value (32),
/// 0x6061 mode of operation display (8). Shorter images leave out the last ones. A mode of 0 in the
/// process data does not change the mode.
///
/// Outputs act at [`Application::outputs_valid`]. From one action to the next the axis moves evenly
/// from the old target to the new one, so that it has reached a target when the next becomes valid.
/// Positions are in the unit of 0x607A and wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Drive {
    power: PowerState,
    mode: i8,
    mapped: Command,
    /// Bit 7 of the last control word that acted: its rising edge resets a fault.
    fault_reset: bool,
    /// End position of the present motion.
    target: i32,
    /// Start position of the present motion, which the encoder shows until the next outputs act.
    position: i32,
    latched: Feedback,
}

/// A state of the CiA 402 state machine.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum PowerState {
    /// Without torque, waits for Shutdown.
    SwitchOnDisabled,
    /// Without torque, waits for Switch On.
    ReadyToSwitchOn,
    /// With power, without torque.
    SwitchedOn,
    /// Follows the target.
    OperationEnabled,
    /// Stopped by a quick stop, holds its position.
    QuickStopActive,
    /// A fault waits for its reset.
    Fault,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Command {
    control: u16,
    target: i32,
    mode: i8,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Feedback {
    status: u16,
    position: i32,
    mode: i8,
}

impl Drive {
    /// Bytes of its outputs.
    pub const OUTPUT_LEN: usize = 7;
    /// Bytes of its inputs.
    pub const INPUT_LEN: usize = 7;
    /// Mode of operation: cyclic synchronous position, the only one.
    pub const CYCLIC_SYNCHRONOUS_POSITION: i8 = 8;

    /// A drive without power at `position`.
    pub const fn new(position: i32) -> Self {
        Self {
            power: PowerState::SwitchOnDisabled,
            mode: 0,
            mapped: Command { control: 0, target: 0, mode: 0 },
            fault_reset: false,
            target: position,
            position,
            latched: Feedback { status: 0, position: 0, mode: 0 },
        }
    }

    /// Enters the fault state: there is no torque until the fault is reset.
    pub fn fail(&mut self) {
        self.power = PowerState::Fault;
        self.target = self.position;
    }

    /// State of the power.
    pub const fn power(&self) -> PowerState {
        self.power
    }

    /// Position of the axis when its outputs last acted.
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// Target position of the present motion.
    pub const fn target(&self) -> i32 {
        self.target
    }

    fn feedback(&self) -> Feedback {
        let follows = self.power == PowerState::OperationEnabled
            && self.mode == Self::CYCLIC_SYNCHRONOUS_POSITION;
        let status = self.power.status() | REMOTE | if follows { FOLLOWS } else { 0 };
        Feedback { status, position: self.position, mode: self.mode }
    }
}

impl Default for Drive {
    fn default() -> Self {
        Self::new(0)
    }
}

impl Application for Drive {
    fn power_off(&mut self) {
        // The axis does not move, and its encoder is absolute.
        *self = Self::new(self.position);
    }

    fn map_outputs(&mut self, outputs: &[u8]) {
        if let Some(control) = outputs.get(0..2) {
            self.mapped.control = u16::from_le_bytes([control[0], control[1]]);
        }
        if let Some(t) = outputs.get(2..6) {
            self.mapped.target = i32::from_le_bytes([t[0], t[1], t[2], t[3]]);
        }
        if let Some(&mode) = outputs.get(6) {
            self.mapped.mode = mode as i8;
        }
    }

    fn outputs_valid(&mut self) {
        // The motion that the last outputs started has ended.
        self.position = self.target;
        let control = self.mapped.control;
        let reset = control & FAULT_RESET != 0;
        self.power = self.power.after(control, reset && !self.fault_reset);
        self.fault_reset = reset;
        if self.mapped.mode == Self::CYCLIC_SYNCHRONOUS_POSITION {
            self.mode = self.mapped.mode;
        }
        if self.power == PowerState::OperationEnabled
            && self.mode == Self::CYCLIC_SYNCHRONOUS_POSITION
        {
            self.target = self.mapped.target;
        }
    }

    fn latch_inputs(&mut self) {
        self.latched = self.feedback();
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        let mut image = [0; Self::INPUT_LEN];
        image[0..2].copy_from_slice(&self.latched.status.to_le_bytes());
        image[2..6].copy_from_slice(&self.latched.position.to_le_bytes());
        image[6] = self.latched.mode as u8;
        let len = inputs.len().min(image.len());
        inputs[..len].copy_from_slice(&image[..len]);
    }

    fn safe_outputs(&mut self) {
        if self.power != PowerState::Fault {
            self.power = PowerState::SwitchOnDisabled;
        }
        self.mapped = Command::default();
        self.target = self.position;
    }

    fn read_object(
        &mut self,
        object: ObjectAddress,
        value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        if object.sub != 0 {
            return None;
        }
        let feedback = self.feedback();
        let number = match object.index {
            CONTROL_WORD => i32::from(self.mapped.control),
            STATUS_WORD => i32::from(feedback.status),
            MODE => i32::from(self.mapped.mode),
            MODE_DISPLAY => i32::from(feedback.mode),
            ACTUAL_POSITION => feedback.position,
            TARGET_POSITION => self.mapped.target,
            _ => return None,
        };
        let bytes = number.to_le_bytes();
        let len = value.len().min(bytes.len());
        value[..len].copy_from_slice(&bytes[..len]);
        Some(Ok(len))
    }

    fn write_object(&mut self, object: ObjectAddress, value: &[u8]) -> Result<(), AbortCode> {
        if object.sub != 0 {
            return Ok(());
        }
        match (object.index, value) {
            (CONTROL_WORD, &[low, high]) => self.mapped.control = u16::from_le_bytes([low, high]),
            (TARGET_POSITION, &[a, b, c, d]) => {
                self.mapped.target = i32::from_le_bytes([a, b, c, d]);
            }
            (MODE, &[mode]) => match mode as i8 {
                0 | Self::CYCLIC_SYNCHRONOUS_POSITION => {
                    self.mapped.mode = mode as i8;
                    self.mode = mode as i8;
                }
                _ => return Err(AbortCode::VALUE_RANGE),
            },
            _ => {}
        }
        Ok(())
    }
}

impl PowerState {
    /// The bits of the status word for it.
    pub const fn status(self) -> u16 {
        match self {
            Self::SwitchOnDisabled => 0x0040,
            Self::ReadyToSwitchOn => 0x0021,
            Self::SwitchedOn => 0x0023,
            Self::OperationEnabled => 0x0027,
            Self::QuickStopActive => 0x0007,
            Self::Fault => 0x0008,
        }
    }

    /// The state after a control word. It changes one step at a time, except that Enable Operation
    /// skips Switched On.
    fn after(self, control: u16, fault_reset: bool) -> Self {
        use PowerState::*;
        if self == Fault {
            return if fault_reset { SwitchOnDisabled } else { Fault };
        }
        let enabled = matches!(self, OperationEnabled | QuickStopActive);
        if control & ENABLE_VOLTAGE == 0 {
            SwitchOnDisabled
        } else if control & QUICK_STOP == 0 {
            if enabled { QuickStopActive } else { SwitchOnDisabled }
        } else if control & SWITCH_ON == 0 {
            if self == QuickStopActive { self } else { ReadyToSwitchOn }
        } else {
            match (self, control & ENABLE_OPERATION != 0) {
                (SwitchOnDisabled, _) => self,
                (QuickStopActive, false) => self,
                (_, true) => OperationEnabled,
                (_, false) => SwitchedOn,
            }
        }
    }
}

const CONTROL_WORD: u16 = 0x6040;
const STATUS_WORD: u16 = 0x6041;
const MODE: u16 = 0x6060;
const MODE_DISPLAY: u16 = 0x6061;
const ACTUAL_POSITION: u16 = 0x6064;
const TARGET_POSITION: u16 = 0x607A;

/// Control word bit 0.
const SWITCH_ON: u16 = 1 << 0;
/// Control word bit 1.
const ENABLE_VOLTAGE: u16 = 1 << 1;
/// Control word bit 2; 0 is a quick stop.
const QUICK_STOP: u16 = 1 << 2;
/// Control word bit 3.
const ENABLE_OPERATION: u16 = 1 << 3;
/// Control word bit 7.
const FAULT_RESET: u16 = 1 << 7;
/// Status word bit 9: the drive accepts the control word.
const REMOTE: u16 = 1 << 9;
/// Status word bit 12: the drive follows the target.
const FOLLOWS: u16 = 1 << 12;

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(control: u16, target: i32, mode: i8) -> [u8; 7] {
        let (c, t) = (control.to_le_bytes(), target.to_le_bytes());
        [c[0], c[1], t[0], t[1], t[2], t[3], mode as u8]
    }

    fn cycle(drive: &mut Drive, control: u16, target: i32) -> (u16, i32) {
        drive.map_outputs(&outputs(control, target, 8));
        drive.latch_inputs();
        drive.outputs_valid();
        let mut i = [0; 7];
        drive.map_inputs(&mut i);
        assert_eq!(i[6], drive.latched.mode as u8);
        (u16::from_le_bytes([i[0], i[1]]), i32::from_le_bytes([i[2], i[3], i[4], i[5]]))
    }

    #[test]
    fn it_is_switched_on_step_by_step_and_then_follows() {
        let mut drive = Drive::new(100);
        assert_eq!(cycle(&mut drive, 0x0F, 500), (0x0240, 100), "needs Shutdown first");
        assert_eq!(cycle(&mut drive, 0x06, 500), (0x0240, 100));
        assert_eq!(cycle(&mut drive, 0x07, 500), (0x0221, 100));
        assert_eq!(cycle(&mut drive, 0x0F, 110), (0x0223, 100));
        assert_eq!(cycle(&mut drive, 0x0F, 120), (0x1227, 100), "on the way to 110");
        assert_eq!(cycle(&mut drive, 0x0F, 130), (0x1227, 110));
        assert_eq!(cycle(&mut drive, 0x0F, 130), (0x1227, 120));
        assert_eq!(cycle(&mut drive, 0x0B, 900), (0x1227, 130), "quick stop");
        assert_eq!(cycle(&mut drive, 0x00, 900), (0x0207, 130));
        assert_eq!(cycle(&mut drive, 0x00, 900), (0x0240, 130));
    }

    #[test]
    fn leaving_op_takes_the_torque() {
        let mut drive = Drive::new(0);
        for control in [0x06, 0x07, 0x0F, 0x0F] {
            cycle(&mut drive, control, 7);
        }
        assert_eq!(drive.power(), PowerState::OperationEnabled);
        drive.safe_outputs();
        assert_eq!((drive.power(), drive.target()), (PowerState::SwitchOnDisabled, 7));
    }

    #[test]
    fn a_fault_needs_a_rising_edge() {
        let mut drive = Drive::new(0);
        cycle(&mut drive, 0x80, 0);
        drive.fail();
        cycle(&mut drive, 0x80, 0);
        assert_eq!(drive.power(), PowerState::Fault, "the bit was set before the fault");
        cycle(&mut drive, 0x00, 0);
        cycle(&mut drive, 0x80, 0);
        assert_eq!(drive.power(), PowerState::SwitchOnDisabled);
    }

    #[test]
    fn only_its_mode_may_be_chosen() {
        let mut drive = Drive::new(0);
        let mode = ObjectAddress::new(0x6060, 0);
        assert_eq!(drive.write_object(mode, &[1]), Err(AbortCode::VALUE_RANGE));
        assert_eq!(drive.write_object(mode, &[8]), Ok(()));
        let mut shown = [0];
        assert_eq!(drive.read_object(ObjectAddress::new(0x6061, 0), &mut shown), Some(Ok(1)));
        assert_eq!(shown, [8]);
    }
}
