//! Tests the driver with a chip that is modelled by its registers: every access, and all faults.

mod chip;

use chip::Board;
use embedded_hal::spi::ErrorKind;
use isocat_esc::Pdi;
use isocat_lan925x::{Access, ChipId, Direction, Error, Lan925x};
use isocat_wire::{Nanos, Time, register};

/// A chip that is ready, with its driver.
fn ready() -> (Board, Lan925x<Board>) {
    let board = Board::new();
    let mut driver = Lan925x::new(board.clone());
    assert_eq!(driver.connect(&mut board.clone()), Ok(ChipId { chip: 0x9252, revision: 1 }));
    // The first access of each kind ends unfinished ones, which the tests do not want to see.
    driver.try_read(0x0000, &mut [0]).unwrap();
    driver.try_read(0x1000, &mut [0]).unwrap();
    driver.try_write(0x1000, &[0]).unwrap();
    (board, driver)
}

fn assert_no_breach(board: &Board) {
    assert_eq!(board.0.borrow().breaches, [""; 0]);
}

/// Bytes that depend on their place.
fn pattern(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at % 251) as u8 + 1).collect()
}

#[test]
fn registers_at_every_alignment() {
    let (board, mut driver) = ready();
    // User RAM begins at 0x0F80. Its first bytes are used by the ESC, the rest is free.
    for first in 0..8 {
        for len in 0..20 {
            let (address, data) = (0x0FA0 + first, pattern(len));
            driver.try_write(0x0FA0, &[0; 32]).unwrap();
            driver.try_write(address, &data).unwrap();
            let memory = board.0.borrow().esc.registers();
            let start = usize::from(address);
            assert_eq!(memory[start..start + len], data, "{len} bytes at 0x{address:04X}");
            let around = memory[0x0FA0..start].iter().chain(&memory[start + len..0x0FC0]);
            assert!(around.into_iter().all(|byte| *byte == 0), "nothing else was written");
            let mut found = vec![0xFF; len];
            driver.try_read(address, &mut found).unwrap();
            assert_eq!(found, data, "{len} bytes at 0x{address:04X}");
        }
    }
    assert_no_breach(&board);
}

#[test]
fn process_ram_at_every_alignment() {
    let (board, mut driver) = ready();
    let lengths = (1..20).chain([60, 61, 63, 64, 65, 67, 68, 127, 128, 129, 500, 1024]);
    for len in lengths {
        for first in 0..4 {
            let (address, data) = (0x1204 + first, pattern(len));
            driver.try_write(0x1200, &vec![0; 1100]).unwrap();
            driver.try_write(address, &data).unwrap();
            let memory = board.0.borrow().esc.ram()[0x200..0x200 + 1100].to_vec();
            let start = 4 + usize::from(first);
            assert_eq!(memory[start..start + len], data, "{len} bytes at 0x{address:04X}");
            let around = memory[..start].iter().chain(&memory[start + len..]);
            assert!(around.into_iter().all(|byte| *byte == 0), "nothing else was written");
            let mut found = vec![0xFF; len];
            driver.try_read(address, &mut found).unwrap();
            assert_eq!(found, data, "{len} bytes at 0x{address:04X}");
        }
    }
    assert_no_breach(&board);
}

/// A chip that is slower than the bus fills and empties its FIFOs word by word.
#[test]
fn a_slow_chip_is_waited_for() {
    let (board, mut driver) = ready();
    board.0.borrow_mut().csr_time = Some(Nanos::micros(20));
    board.0.borrow_mut().word_time = Some(Nanos::micros(15));
    let data = pattern(200);
    driver.try_write(0x1101, &data).unwrap();
    let mut found = [0; 200];
    driver.try_read(0x1101, &mut found).unwrap();
    assert_eq!(found[..], data);
    let mut kind = [0];
    driver.try_read(register::TYPE.address, &mut kind).unwrap();
    assert_eq!(kind, [0xC0]);
    assert_no_breach(&board);
}

#[test]
fn one_access_may_span_registers_and_process_ram() {
    let (board, mut driver) = ready();
    let data = pattern(9);
    driver.try_write(0x0FFB, &data).unwrap();
    assert_eq!(board.0.borrow().esc.registers()[0x0FFB..], data[..5]);
    assert_eq!(board.0.borrow().esc.ram()[..4], data[5..]);
    let mut found = [0; 9];
    driver.try_read(0x0FFB, &mut found).unwrap();
    assert_eq!(found[..], data);
    assert_no_breach(&board);
}

#[test]
fn what_lies_beyond_the_address_space_reads_zero() {
    let (board, mut driver) = ready();
    let mut found = [0xFF; 6];
    driver.try_read(0xFFFE, &mut found).unwrap();
    assert_eq!(found, [0; 6]);
    driver.try_write(0xFFFE, &[1; 6]).unwrap();
    assert_no_breach(&board);
}

#[test]
fn reset_waits_until_the_chip_is_ready() {
    let (board, mut driver) = ready();
    driver.try_write(0x1000, &[7; 8]).unwrap();
    driver.enable_interrupt(true).unwrap();
    assert_eq!(board.0.borrow().pin(), Some(false));
    let before = board.0.borrow().now;
    assert_eq!(driver.reset(&mut board.clone()).map(|id| id.chip), Ok(0x9252));
    assert!(board.0.borrow().now - before >= Nanos::millis(10), "that is how long it takes");
    assert_eq!(board.0.borrow().esc.ram()[..8], [0; 8], "the ESC began anew");
    assert_eq!(board.0.borrow().pin(), None, "the pin is off again");
    assert_no_breach(&board);
}

#[test]
fn a_chip_that_is_not_there_or_not_ready_or_unknown() {
    let (board, mut driver) = ready();
    let mut delay = board.clone();
    board.0.borrow_mut().byte_test = 0x2143_6587;
    assert_eq!(driver.check(), Err(Error::ByteTest { found: 0x2143_6587 }));
    assert_eq!(driver.connect(&mut delay), Err(Error::ByteTest { found: 0x2143_6587 }));
    assert_eq!(driver.reset(&mut delay), Err(Error::ByteTest { found: 0x2143_6587 }));
    board.0.borrow_mut().byte_test = 0x8765_4321;
    board.0.borrow_mut().ready_at = Time::NEVER;
    assert_eq!(driver.connect(&mut delay), Err(Error::NotReady { found: 0 }));
    board.0.borrow_mut().ready_at = Time::ZERO;
    for (chip, known) in [(0x9251, false), (0x9252, true), (0x9254, true), (0x9255, false)] {
        let found = chip << 16 | 3;
        board.0.borrow_mut().id_rev = found;
        let id = ChipId { chip: chip as u16, revision: 3 };
        let expected = if known { Ok(id) } else { Err(Error::UnknownChip { found }) };
        assert_eq!(driver.connect(&mut delay), expected);
    }
    let text = Error::<ErrorKind>::ByteTest { found: 0x2143_6587 }.to_string();
    assert_eq!(text, "BYTE_TEST (0x064): expected 0x87654321, found 0x21436587");
    assert_no_breach(&board);
}

#[test]
fn a_command_that_never_ends_is_given_up_and_the_next_access_waits_for_it() {
    let (board, driver) = ready();
    let mut driver = driver.with_polls(25);
    board.0.borrow_mut().csr_time = Some(Nanos::millis(5));
    let before = board.0.borrow().transactions;
    let mut found = [0xFF; 2];
    driver.read(register::AL_STATUS.address, &mut found);
    assert_eq!(found, [0, 0], "no state of an ESC");
    assert_eq!(board.0.borrow().transactions - before, 1 + 25, "a command and the looks at it");
    let access = Access { direction: Direction::Read, address: 0x0130, len: 2 };
    assert_eq!(driver.fault(), Some(&Error::Busy(access)));
    assert_eq!(driver.fault().unwrap().to_string(), "read of 2 bytes at 0x0130: still busy");
    // The driver sends nothing before the chip has ended its command.
    driver.write(0x0FA0, &[1]);
    assert_eq!((driver.faults(), driver.take_fault()), (2, Some(Error::Busy(access))));
    let end = board.0.borrow().now + Nanos::millis(5);
    board.0.borrow_mut().advance(end);
    board.0.borrow_mut().csr_time = Some(Nanos(500));
    driver.read(register::AL_STATUS.address, &mut found);
    assert_eq!((found, driver.take_fault()), ([1, 0], None));
    assert_no_breach(&board);
}

#[test]
fn an_access_to_process_ram_that_never_ends_is_given_up_and_ended_by_the_next_one() {
    for (direction, address) in [(Direction::Read, 0x1203), (Direction::Write, 0x1302)] {
        let (board, driver) = ready();
        let mut driver = driver.with_polls(25);
        driver.try_write(0x1200, &pattern(0x200)).unwrap();
        board.0.borrow_mut().word_time = None;
        let mut data = [0xFF; 80];
        match direction {
            Direction::Read => driver.read(address, &mut data),
            Direction::Write => driver.write(address, &data),
        }
        let access = Access { direction, address, len: 80 };
        assert_eq!(driver.take_fault(), Some(Error::Busy(access)));
        board.0.borrow_mut().word_time = Some(Nanos(300));
        driver.write(0x1300, &pattern(90));
        driver.read(0x1300, &mut data);
        assert_eq!((&data[..], driver.take_fault()), (&pattern(80)[..], None));
        assert_no_breach(&board);
    }
}

/// Whichever transaction fails, the access reads zeros, the fault is kept, and the next access is
/// right.
#[test]
fn a_bus_that_fails_once_costs_one_access() {
    for (address, len) in [(0x0FA0, 7), (0x1205, 150)] {
        let data = pattern(len);
        let run = |failing: Option<u64>, write: bool| {
            let (board, mut driver) = ready();
            driver.try_write(address, &data).unwrap();
            let before = board.0.borrow().transactions;
            board.0.borrow_mut().failing =
                failing.map(|number| before + number).into_iter().collect();
            let mut found = vec![0xFF; len];
            if write {
                driver.write(address, &data)
            } else {
                driver.read(address, &mut found)
            }
            let used = board.0.borrow().transactions - before;
            let fault = driver.take_fault();
            let mut again = vec![0xFF; len];
            driver.write(address, &data);
            driver.read(address, &mut again);
            assert_eq!((again, driver.fault()), (data.clone(), None), "{failing:?}");
            assert_no_breach(&board);
            (used, fault, found)
        };
        for write in [false, true] {
            let (transactions, fault, found) = run(None, write);
            assert_eq!(fault, None);
            assert!(write || found == data);
            for number in 1..=transactions {
                let (_, fault, found) = run(Some(number), write);
                assert_eq!(fault, Some(Error::Bus(ErrorKind::Other)), "transaction {number}");
                assert!(write || found == vec![0; len], "zeros, and not a part of the data");
            }
        }
    }
}

#[test]
fn a_bus_that_nobody_drives_is_no_data() {
    let (board, driver) = ready();
    let mut driver = driver.with_polls(10);
    board.0.borrow_mut().floating = Some(0xFF);
    let mut found = [0xAA; 4];
    driver.read(0x1200, &mut found);
    assert_eq!(found, [0; 4]);
    assert!(matches!(driver.take_fault(), Some(Error::FifoCount { found: u32::MAX, .. })));
    assert_eq!(driver.events(), 0);
    assert!(matches!(driver.take_fault(), Some(Error::Busy(_))));
    // What the stack reads looks like an idle ESC; only the check detects the fault.
    board.0.borrow_mut().floating = Some(0);
    assert_eq!((driver.events(), driver.take_fault()), (0, None));
    assert_eq!(driver.check(), Err(Error::ByteTest { found: 0 }));
}
