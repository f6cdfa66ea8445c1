//! The SubDevice stack on a bare Cortex-M: no operating system, no allocation, no wall clock.
//!
//! `device` is what a device author writes. `bench` connects the stack to a software ESC and
//! advances the device's own time from event to event. `script` is the MainDevice. `main` brings
//! the device from INIT to OP with DC SYNC0 and back. Every figure that it prints was read from the
//! ESC's registers, from the stack or through the mailbox, and is checked; a deviation ends with a
//! failure exit code. `machine` depends on the CPU.
//!
//! Standard output does not depend on the compiler and is compared with `expected.txt`; sizes
//! depend on it and go to standard error.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod bench;
mod device;
mod machine;
mod script;

use core::mem::{MaybeUninit, size_of_val};

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::{heprintln, hprintln};
use isocat_esc::{Esc, LAN9252};
use isocat_subdevice::{Io, SubDevice};
use isocat_wire::dc::SyncActivation;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, fmmu, sync_manager};
use isocat_wire::sii::{Header, Writer};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlState, AlStatus, AlStatusCode, Command, Nanos, ObjectAddress, PortNumber};
use panic_semihosting as _;

use crate::bench::{Bench, Stack};
use crate::script::{Failure, Script};

#[cortex_m_rt::entry]
fn main() -> ! {
    static mut SII: [u8; 256] = [0; 256];
    static mut RAM: [u8; 4096] = [0; 4096];
    static mut ESC: MaybeUninit<Esc<&'static mut [u8]>> = MaybeUninit::uninit();
    static mut STACK: MaybeUninit<Stack> = MaybeUninit::uninit();

    // PDI is SPI, the SYNC unit is on, SYNC0 pulses last 1 us.
    let configuration = [0x80, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let header = Header { configuration, ..Header::default() };
    let image = Writer::new(SII, &header).and_then(Writer::finish);
    image.expect("256 bytes hold an image without categories");
    let esc = ESC.write(Esc::new(&LAN9252, &mut SII[..], &mut RAM[..]));
    esc.set_port(PortNumber::P0, true);
    // Constructed twice: the first time only to measure the call stack.
    let construction = machine::call_stack_of(|| {
        STACK.write(SubDevice::new(&device::DESCRIPTION, [0; device::STORE], Io::new()));
    });
    let stack = STACK.write(SubDevice::new(&device::DESCRIPTION, [0; device::STORE], Io::new()));
    let (stack_size, esc_size) = (size_of_val(stack), size_of_val(esc));

    let mut script = Script::new(Bench::new(esc, stack));
    let result = run(&mut script);
    let used = script.bench.call_stack();
    heprintln!("RAM of the stack with values and application: {} bytes", stack_size);
    heprintln!("RAM of the software ESC without its memory: {} bytes", esc_size);
    heprintln!("call stack of the stack's construction: {} bytes", construction);
    heprintln!("call stack of its main loop, ESC included: {} bytes", used.main_loop);
    heprintln!("call stack of its interrupts, ESC included: {} bytes", used.interrupt);
    match result {
        Ok(()) => debug::exit(EXIT_SUCCESS),
        Err(failure) => {
            hprintln!("FAILED {}", failure);
            debug::exit(EXIT_FAILURE);
        }
    }
    unreachable!("the emulator has ended");
}

/// Goes from power-on to OP, leaves a frame out, and goes back.
fn run(script: &mut Script) -> Result<(), Failure> {
    enter(script, AlState::Init)?;
    hprintln!("ESC type 0x{:02X}", script.read(register::TYPE)?);

    script.set_mailbox()?;
    enter(script, AlState::PreOp)?;
    object(script, 0x04, "sync types supported", 0x07)?;
    object(script, 0x05, "minimum cycle time, ns", 250_000)?;

    set_process_data(script)?;
    let mut cycles = start_sync0(script)?;
    enter(script, AlState::SafeOp)?;
    object(script, 0x01, "sync type", 2)?;
    object(script, 0x02, "cycle time, ns", CYCLE.0 as u32)?;

    into_op(script, &mut cycles)?;
    exchange(script, &mut cycles)?;
    leave_one_out(script, &mut cycles)?;

    enter(script, AlState::Init)?;
    let ms = script.bench.now().count() / 1_000_000;
    hprintln!("end: {} frames, {} ms of device time", script.bench.frames(), ms);
    Ok(())
}

/// Requests a state that is entered at once.
fn enter(script: &mut Script, state: AlState) -> Result<(), Failure> {
    let (status, code) = script.ask(state)?;
    show_state(script, status, code);
    figure("AL status", AlStatus::new(state).0, status.0)?;
    figure("AL status code", AlStatusCode::NO_ERROR.0, code.0)
}

fn show_state(script: &Script, status: AlStatus, code: AlStatusCode) {
    let state = script.bench.stack().state();
    hprintln!("{}: AL status 0x{:04X}, code 0x{:04X}", state, status.0, code.0);
}

/// Reads an entry of 0x1C32 through the mailbox.
fn object(script: &mut Script, sub: u8, what: &'static str, expected: u32) -> Result<(), Failure> {
    let object = ObjectAddress::new(0x1C32, sub);
    let found = script.sdo(object)?;
    hprintln!("  {} {}: {}", object, what, found);
    figure(what, expected, found)
}

/// Sets SyncManagers and FMMUs of the process data, by the description.
fn set_process_data(script: &mut Script) -> Result<(), Failure> {
    let (outputs, inputs) = (device::DESCRIPTION.outputs, device::DESCRIPTION.inputs);
    let len = outputs.max_length;
    let sm = SyncManager::new(outputs.start, len, SyncManager::OUTPUTS, true);
    script.write(sync_manager(2), sm)?;
    let sm = SyncManager::new(inputs.start, inputs.max_length, SyncManager::INPUTS, true);
    script.write(sync_manager(3), sm)?;
    script.write(fmmu(0), Fmmu::bytes(LOGICAL, len, outputs.start, Fmmu::WRITE))?;
    script.write(fmmu(1), Fmmu::bytes(LOGICAL, len, inputs.start, Fmmu::READ))
}

/// The exchange of process data: in each cycle, a frame in the middle between two SYNC0 pulses.
struct Cycles {
    /// When the next SYNC0 comes.
    sync0: Time<Device>,
    /// The last outputs, which count up.
    outputs: u32,
    /// Number of cycles with a frame.
    count: u32,
}

/// Sets up the SYNC unit.
fn start_sync0(script: &mut Script) -> Result<Cycles, Failure> {
    let start = script.read(register::SYSTEM_TIME)? + START_AHEAD;
    script.write(register::SYNC0_CYCLE, CYCLE.0 as u32)?;
    script.write(register::SYNC_START_TIME, start)?;
    let activation = SyncActivation(SyncActivation::ACTIVE | SyncActivation::SYNC0);
    script.write(register::SYNC_ACTIVATION, activation)?;
    let next = script.read(register::SYNC_START_TIME)?;
    hprintln!("SYNC0: first pulse at {} ns of system time, every {} ns", next, CYCLE.0);
    figure("first SYNC0, ns", start, next)?;
    // There is only the clock of the device's oscillator, and the ESC's local time began with it.
    Ok(Cycles { sync0: Time::new(start), outputs: 0, count: 0 })
}

impl Cycles {
    /// Runs one cycle, until shortly after its SYNC0; returns the inputs, if there was a frame.
    fn cycle(&mut self, script: &mut Script, frame: bool) -> Result<u32, Failure> {
        script.wait_until(self.sync0 + Nanos(-CYCLE.0 / 2));
        let mut data = [0; 4];
        if frame {
            self.outputs += 1;
            self.count += 1;
            data = self.outputs.to_le_bytes();
            let address = isocat_wire::datagram::Address::Logical(LOGICAL);
            script.datagram(Command::Lrw, address, &mut data, WKC)?;
        }
        script.wait_until(self.sync0 + BEHIND);
        self.sync0 += CYCLE;
        Ok(u32::from_le_bytes(data))
    }
}

/// Exchanges process data until the device is in OP.
fn into_op(script: &mut Script, cycles: &mut Cycles) -> Result<(), Failure> {
    let before = cycles.count;
    cycles.cycle(script, true)?;
    script.ask(AlState::Op)?;
    let mut status = script.read(register::AL_STATUS)?;
    while status == AlStatus::new(AlState::SafeOp) && cycles.count - before < MOST_CYCLES_TO_OP {
        cycles.cycle(script, true)?;
        status = script.read(register::AL_STATUS)?;
    }
    let code = script.read(register::AL_STATUS_CODE)?;
    show_state(script, status, code);
    figure("AL status", AlStatus::new(AlState::Op).0, status.0)?;
    let count = cycles.count - before;
    hprintln!("  {} cycles from SAFEOP to OP", count);
    // Before OP the device checks SYNC0 and the outputs for 200 ms, plus a few cycles before and
    // after.
    let settling = (device::DESCRIPTION.behaviour.sync_settling.0 / CYCLE.0) as u32;
    figure("cycles to OP", 1, u32::from((settling..settling + 4).contains(&count)))
}

/// Exchanges process data: the outputs return as inputs.
fn exchange(script: &mut Script, cycles: &mut Cycles) -> Result<(), Failure> {
    let (mut first, mut last) = (0, 0);
    for cycle in 0..CYCLES_IN_OP {
        last = cycles.cycle(script, true)?;
        if cycle == 0 {
            first = last;
        }
        // OP was entered before the last frame on the way to it; earlier outputs never act.
        let expected = if cycle + 1 < LAG { 0 } else { cycles.outputs - LAG };
        figure("inputs", expected, last)?;
    }
    hprintln!(
        "exchange: {} cycles, inputs {} to {}, outputs up to {}, working counter {}",
        CYCLES_IN_OP,
        first,
        last,
        cycles.outputs,
        WKC
    );
    object(script, 0x0B, "SM event missed", 0)?;
    object(script, 0x0C, "cycle time too small", 0)
}

/// Leaves out a frame: a missing frame counts three, and each following frame reduces the counter
/// by one.
fn leave_one_out(script: &mut Script, cycles: &mut Cycles) -> Result<(), Failure> {
    cycles.cycle(script, false)?;
    hprintln!("one frame left out:");
    object(script, 0x0B, "SM event missed", 3)?;
    for left in [2, 1, 0, 0] {
        cycles.cycle(script, true)?;
        object(script, 0x0B, "SM event missed", left)?;
    }
    object(script, 0x20, "sync error", 0)?;
    let (status, code) =
        (script.read(register::AL_STATUS)?, script.read(register::AL_STATUS_CODE)?);
    show_state(script, status, code);
    figure("AL status", AlStatus::new(AlState::Op).0, status.0)?;
    figure("events missed since power-on", 1u64, script.bench.stack().sync().missed_events_total())
}

fn figure<T: Into<u64>>(what: &'static str, expected: T, found: T) -> Result<(), Failure> {
    let (expected, found) = (expected.into(), found.into());
    if expected == found { Ok(()) } else { Err(Failure::Figure { what, expected, found }) }
}

/// SYNC0 cycle.
const CYCLE: Nanos = Nanos::millis(1);
/// Time from reading the system time to the first SYNC0, ns.
const START_AHEAD: u64 = 5_000_000;
/// Time after a SYNC0 when its steps are done.
const BEHIND: Nanos = Nanos::micros(20);
/// Logical address of the process data.
const LOGICAL: u32 = 0x0001_0000;
/// Working counter: outputs written (2) plus inputs read (1).
const WKC: u16 = 3;
/// Cycles from sending outputs to the same value in the inputs: valid at the SYNC0 after the frame,
/// latched at the next SYNC0, read by the frame after that.
const LAG: u32 = 2;
/// Number of cycles without OP after which the device has failed.
const MOST_CYCLES_TO_OP: u32 = 300;
/// Number of cycles of the exchange.
const CYCLES_IN_OP: u32 = 100;
