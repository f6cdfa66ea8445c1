//! A chip on which the PDI acknowledges by writing: register 0x014E bit 0.

use super::*;
use crate::IP_CORE_32;
use crate::chip::IP_CORE_BASE;
use isocat_wire::AlControl;
use isocat_wire::register::al_event;
use isocat_wire::sync_manager::SyncManager;

static BY_WRITE: Chip = Chip { acknowledge_by_write: true, ..IP_CORE_BASE };

#[test]
fn the_chip_says_so() {
    assert_eq!(Bench::new(&BY_WRITE).read(register::PDI_INFORMATION), 0x0007);
    assert_eq!(Bench::new(&IP_CORE_32).read(register::PDI_INFORMATION), 0x0006);
}

#[test]
fn al_control() {
    for at in [0x0120u16, 0x0121] {
        let mut bench = Bench::new(&BY_WRITE);
        assert_eq!(bench.bwr(0x0120, &[0x02, 0]), 1);
        assert_eq!(bench.pdi_read(register::AL_CONTROL), AlControl(2));
        assert_eq!(bench.pdi().events(), al_event::AL_CONTROL, "a read is only a read");
        assert_eq!(bench.bwr(0x0120, &[0x04, 0]), 0);
        bench.pdi().write(0x011F, &[0xFF]);
        bench.pdi().write(0x0122, &[0xFF]);
        assert_eq!(bench.pdi().events(), al_event::AL_CONTROL);
        bench.pdi().write(at, &[0xFF]);
        assert_eq!(bench.pdi().events(), 0);
        assert_eq!(
            bench.pdi_read(register::AL_CONTROL),
            AlControl(2),
            "what is written is ignored"
        );
        assert_eq!(bench.bwr(0x0120, &[0x04, 0]), 1);
    }
}

#[test]
fn sync_manager_activation_and_watchdog() {
    let mut bench = Bench::new(&BY_WRITE);
    bench.fpwr(0x0800, &[0x00, 0x10, 4, 0, 0x64, 0, 1, 0]);
    bench.pdi_bytes(0x0800, 16);
    assert_eq!(bench.pdi().events(), al_event::SM_ACTIVATION);
    bench.pdi().write(0x0806, &[0]);
    assert_eq!(bench.pdi().events(), 0);
    assert_eq!(bench.read(register::SM_0).activate, 1);
    bench.fpwr(0x1000, &[1; 4]);
    bench.run_to(bench.now + 100_000_000);
    assert_eq!(bench.pdi_read(register::WATCHDOG_STATUS), 0);
    let expired = bench.pdi().events();
    assert_eq!(expired & al_event::WATCHDOG, al_event::WATCHDOG);
    bench.pdi().store(register::WATCHDOG_STATUS, 0xFFFF);
    assert_eq!(bench.pdi().events(), expired & !al_event::WATCHDOG);
}

/// SYNC0 in acknowledge mode stays until 0x098E is written.
#[test]
fn sync_signals() {
    let mut configuration = SII;
    configuration[4..6].fill(0);
    let mut bench = Bench::with(&BY_WRITE, configuration);
    bench.fpwr(0x09A0, &1_000_000u32.to_le_bytes());
    let start = (bench.now + 1_000_000).to_le_bytes();
    bench.fpwr(0x0990, &start[..4]);
    bench.fpwr(0x0981, &[3]);
    bench.run_to(bench.now + 2_000_000);
    assert_eq!(bench.pdi().events() & al_event::SYNC0, al_event::SYNC0);
    assert_eq!(bench.pdi_read(register::SYNC0_STATUS), 1);
    assert_eq!(bench.pdi().events() & al_event::SYNC0, al_event::SYNC0);
    bench.pdi().store(register::SYNC0_STATUS, 0);
    assert_eq!(bench.pdi().events() & al_event::SYNC0, 0);
}

/// Reading the first byte opens a buffer; only writing the last one releases it.
#[test]
fn buffers() {
    let mut bench = Bench::new(&BY_WRITE);
    bench.fpwr(0x0800, &[0x00, 0x10, 4, 0, SyncManager::MAILBOX_OUT, 0, 1, 0]);
    bench.fpwr(0x1000, &[1, 2, 3, 4]);
    assert_eq!(bench.pdi_bytes(0x1003, 1), [0], "not open yet");
    assert_eq!(bench.pdi_bytes(0x1000, 4), [1, 2, 3, 4]);
    assert_eq!(bench.pdi_bytes(0x1000, 4), [1, 2, 3, 4], "and again");
    assert_eq!(bench.read(register::sm_status(0)), 0x48);
    assert_eq!(bench.fpwr(0x1000, &[9; 4]), 0, "still full");
    bench.pdi().write(0x1000, &[0xEE; 3]);
    assert_eq!(bench.read(register::sm_status(0)), 0x48, "not the last byte");
    bench.pdi().write(0x1003, &[0xEE]);
    assert_eq!(bench.read(register::sm_status(0)), 0x02);
    assert_eq!(bench.fpwr(0x1000, &[5, 6, 7, 8]), 1);
    // A buffer that was not opened is not released.
    bench.pdi().write(0x1003, &[0]);
    assert_eq!(bench.pdi_bytes(0x1000, 4), [5, 6, 7, 8]);
    // A buffer that the PDI writes is closed by its last byte, as on other chips.
    bench.fpwr(0x0808, &[0x80, 0x10, 4, 0, SyncManager::MAILBOX_IN, 0, 1, 0]);
    bench.pdi().write(0x1080, &[1; 4]);
    assert_eq!(bench.fprd(0x1080, 4), (vec![1; 4], 1));
}
