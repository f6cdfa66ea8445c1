//! The stack as in a real device: with the driver of a LAN925x, and without software ESC, script
//! and emulator. It is built to measure its size, and shows how a main loop and interrupts work
//! together.
//!
//! The board's peripherals are a few addresses that the compiler cannot optimize away; a real
//! program has a HAL for them. So this program is never run.
#![no_std]
#![no_main]

mod device;

use core::convert::Infallible;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{
    read_volatile, with_exposed_provenance, with_exposed_provenance_mut, write_volatile,
};

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use isocat_lan925x::Lan925x;
use isocat_subdevice::{Event, Io, SubDevice};
use isocat_wire::Nanos;
use isocat_wire::time::{Device, Time};

#[cortex_m_rt::entry]
fn main() -> ! {
    static mut STACK: MaybeUninit<SubDevice<Io, [u8; device::STORE]>> = MaybeUninit::uninit();
    let stack = SubDevice::new(&device::DESCRIPTION, [0; device::STORE], Io::new());
    let stack = STACK.write(stack);
    let mut chip = Lan925x::new(Spi);
    start(&mut chip);
    loop {
        let lines = read(LINES);
        for (line, event) in
            [(1, Event::Sm2), (2, Event::Sm3), (4, Event::Sync0), (8, Event::Timer)]
        {
            if lines & line == 0 {
                continue;
            }
            let start = now();
            for (step, delay) in stack.handle_event(start, event, &mut chip) {
                while now() < start + delay {}
                stack.begin(now(), step, &mut chip);
                stack.finish(now(), step, &mut chip);
            }
        }
        stack.poll(now(), &mut chip);
        // The device decides what to do about a bus fault: here it restarts the chip.
        if chip.take_fault().is_some() {
            stack.power_off();
            start(&mut chip);
        }
    }
}

/// Tries until the chip is started.
fn start(chip: &mut Lan925x<Spi>) {
    while chip.reset(&mut Timer).is_err() || chip.enable_interrupt(true).is_err() {}
}

/// The board's SPI with the chip's select line.
struct Spi;

impl ErrorType for Spi {
    type Error = Infallible;
}

impl SpiDevice for Spi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        write(SELECT, 1);
        for operation in operations {
            match operation {
                Operation::Read(bytes) => bytes.iter_mut().for_each(|byte| *byte = exchange(0)),
                Operation::Write(bytes) => bytes.iter().for_each(|byte| _ = exchange(*byte)),
                Operation::Transfer(read, written) => {
                    for (byte, out) in read.iter_mut().zip(*written) {
                        *byte = exchange(*out);
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    bytes.iter_mut().for_each(|byte| *byte = exchange(*byte));
                }
                Operation::DelayNs(ns) => Timer.delay_ns(*ns),
            }
        }
        write(SELECT, 0);
        Ok(())
    }
}

fn exchange(byte: u8) -> u8 {
    write(DATA, u32::from(byte));
    read(DATA) as u8
}

/// The board's timer.
struct Timer;

impl DelayNs for Timer {
    fn delay_ns(&mut self, ns: u32) {
        let end = now() + Nanos::from_u32(ns);
        while now() < end {}
    }
}

fn now() -> Time<Device> {
    Time::new(u64::from(read(TIME)) * 40)
}

fn read(register: usize) -> u32 {
    // SAFETY: a register of a peripheral, which always exists.
    unsafe { read_volatile(with_exposed_provenance(register)) }
}

fn write(register: usize, value: u32) {
    // SAFETY: a register of a peripheral, which always exists.
    unsafe { write_volatile(with_exposed_provenance_mut(register), value) }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

/// Data of the SPI.
const DATA: usize = 0x4002_0008;
/// Select line of the SPI.
const SELECT: usize = 0x4001_0004;
/// Interrupt lines.
const LINES: usize = 0x4001_0000;
/// Timer, in steps of 40 ns.
const TIME: usize = 0x4000_0004;
