use isocat_wire::register::{self, al_event};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AlControl, AlState, AlStatus, AlStatusCode, Nanos};

use super::bench::{Bench, Call};
use super::device::{Builder, description};
use isocat_sync::{Event, SyncMode};

use AlState::{Init, Op, PreOp, SafeOp};

const NO_ERROR: AlStatusCode = AlStatusCode::NO_ERROR;

fn ok(state: AlState) -> (AlStatus, AlStatusCode) {
    (AlStatus::new(state), NO_ERROR)
}

fn error(state: AlState, code: AlStatusCode) -> (AlStatus, AlStatusCode) {
    (AlStatus::new(state).with_error(true), code)
}

/// The answer to P to S after `prepare` has changed a right configuration of 7 bytes in each
/// direction.
fn safe_op(
    device: impl FnOnce(&mut Builder),
    prepare: impl FnOnce(&mut Bench),
) -> (AlStatus, AlStatusCode) {
    let mut bench = Bench::in_state(description(device), PreOp);
    bench.set_process_data(7, 7);
    prepare(&mut bench);
    let answer = bench.ask(SafeOp);
    let closed = [2, 3].map(|number| bench.esc.sm(number).pdi_control & 1);
    let refused = answer.0.error();
    assert_eq!(closed, [u8::from(refused); 2], "closed exactly if refused");
    answer
}

#[test]
fn power_on_answers_init_with_acknowledge() {
    let mut bench = Bench::new(description(|_| {}));
    assert_eq!(bench.acknowledge(Init), ok(Init));
}

#[test]
fn each_transition_that_does_not_exist_is_refused() {
    let invalid = AlStatusCode::INVALID_STATE_CHANGE;
    for (from, to) in
        [(Init, SafeOp), (Init, Op), (PreOp, Op), (PreOp, AlState::Boot), (SafeOp, AlState::Boot)]
    {
        let mut bench = if from == Init {
            Bench::new(description(|_| {}))
        } else {
            Bench::in_state(description(|_| {}), from)
        };
        assert_eq!(bench.ask(to), error(from, invalid), "{from} to {to}");
    }
    let mut bench = Bench::new(description(|_| {}));
    assert_eq!(bench.ask(AlState::Boot), error(Init, AlStatusCode::BOOTSTRAP_NOT_SUPPORTED));
    let mut bench = Bench::in_state(description(|_| {}), Op);
    assert_eq!(bench.ask(AlState::Boot), error(SafeOp, invalid), "OP falls to SAFEOP");
    let mut bench = Bench::in_state(description(|_| {}), Op);
    assert_eq!(bench.control(AlControl(7)), error(SafeOp, AlStatusCode::UNKNOWN_STATE));
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    assert_eq!(bench.control(AlControl(0)), error(PreOp, AlStatusCode::UNKNOWN_STATE));
}

#[test]
fn down_is_always_allowed() {
    for from in [PreOp, SafeOp, Op] {
        for to in [Init, PreOp, SafeOp, Op] {
            let mut bench = Bench::in_state(description(|_| {}), from);
            if to as u8 <= from as u8 {
                assert_eq!(bench.ask(to), ok(to), "{from} to {to}");
            }
        }
    }
    let mut bench = Bench::in_state(description(|_| {}), Op);
    bench.calls();
    bench.ask(PreOp);
    assert_eq!(bench.calls(), [Call::Safe]);
    assert_eq!([2, 3].map(|number| bench.esc.sm(number).pdi_control & 1), [1, 1]);
}

#[test]
fn an_error_is_acknowledged_or_left_by_init() {
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    let refused = error(PreOp, AlStatusCode::INVALID_STATE_CHANGE);
    assert_eq!(bench.ask(Op), refused);
    bench.set_process_data(7, 7);
    assert_eq!(bench.ask(SafeOp), refused, "ignored while the error stands");
    assert_eq!(bench.ask(PreOp), refused);
    assert_eq!(bench.acknowledge(PreOp), ok(PreOp));
    assert_eq!(bench.ask(Op), refused);
    assert_eq!(bench.acknowledge(SafeOp), ok(SafeOp), "acknowledged and granted at once");
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    bench.ask(Op);
    assert_eq!(bench.ask(Init), ok(Init));
}

#[test]
fn identification_is_told_only_when_asked_for() {
    let mut bench = Bench::new(description(|d| d.behaviour.identification = 0x1234));
    let asked = bench.control(AlControl(0x21));
    assert_eq!(asked, (AlStatus(0x21), AlStatusCode(0x1234)));
    assert_eq!(bench.ask(Init), ok(Init));
    let mut bench = Bench::new(description(|_| {}));
    assert_eq!(bench.control(AlControl(0x21)), ok(Init), "a device without one");
}

#[test]
fn mailboxes_must_be_the_devices_own() {
    let changes: [fn(&mut SyncManager); 6] = [
        |sm| sm.start += 2,
        |sm| sm.length -= 1,
        |sm| sm.length += 1,
        |sm| sm.activate = 0,
        |sm| sm.control &= !SyncManager::CONTROL_MAILBOX,
        |sm| sm.control ^= SyncManager::CONTROL_ECAT_WRITES,
    ];
    for number in [0, 1] {
        for (i, change) in changes.iter().enumerate() {
            let mut bench = Bench::new(description(|_| {}));
            bench.set_mailbox();
            let mut sm = bench.esc.sm(number);
            change(&mut sm);
            bench.esc.set_sm(number, sm);
            let refused = error(Init, AlStatusCode::INVALID_MAILBOX);
            assert_eq!(bench.ask(PreOp), refused, "SM{number}, change {i}");
        }
    }
}

#[test]
fn mapping_is_computed_first() {
    let assign = |index, pdo: [u8; 2]| {
        move |bench: &mut Bench| {
            bench.download_as(true, index, 0, &[1, 0, pdo[0], pdo[1]]).unwrap();
            bench.esc.set_sm(2, SyncManager::default());
        }
    };
    let inputs = AlStatusCode::INVALID_INPUT_MAPPING;
    let outputs = AlStatusCode::INVALID_OUTPUT_MAPPING;
    assert_eq!(safe_op(|_| {}, assign(0x1C13, [0x07, 0x1A])), error(PreOp, inputs));
    assert_eq!(safe_op(|_| {}, assign(0x1C12, [0x07, 0x16])), error(PreOp, outputs));
    // 64 bytes fit into the area, 65 do not.
    let wide = |bits| {
        move |d: &mut Builder| {
            d.preset(0x1600, 0, &[8]);
            let all = isocat_wire::coe::DataType::UNSIGNED32;
            d.objects.retain(|object| object.index != 0x1600);
            d.object(0x1600, "wide", isocat_wire::coe::info::ObjectCode::RECORD, all, |o| {
                o.entry(0, 0, isocat_wire::coe::DataType::UNSIGNED8, super::device::RO, &[3]);
                for (sub, bits) in [(1, 255u8), (2, 255), (3, bits)] {
                    o.entry(sub, 0, all, super::device::RO, &[bits, 0, 0, 0]);
                }
            });
        }
    };
    assert_eq!(safe_op(wide(2), |bench| bench.set_process_data(64, 7)), ok(SafeOp));
    assert_eq!(safe_op(wide(3), |bench| bench.set_process_data(65, 7)), error(PreOp, outputs));
}

#[test]
fn process_data_sync_managers_must_fit_the_mapping() {
    let change = |number, change: fn(&mut SyncManager)| {
        safe_op(
            |_| {},
            |bench| {
                let mut sm = bench.esc.sm(number);
                change(&mut sm);
                bench.esc.set_sm(number, sm);
            },
        )
    };
    for (number, code) in [
        (2, AlStatusCode::INVALID_OUTPUT_CONFIGURATION),
        (3, AlStatusCode::INVALID_INPUT_CONFIGURATION),
    ] {
        let refused = error(PreOp, code);
        assert_eq!(change(number, |_| {}), ok(SafeOp));
        assert_eq!(change(number, |sm| sm.length -= 1), refused);
        assert_eq!(change(number, |sm| sm.length += 1), refused);
        assert_eq!(change(number, |sm| sm.start += 8), refused);
        assert_eq!(change(number, |sm| sm.activate = 0), refused);
        assert_eq!(change(number, |sm| sm.control ^= SyncManager::CONTROL_ECAT_WRITES), refused);
        assert_eq!(change(number, |sm| sm.control |= 1), refused, "no known mode");
    }
    // The areas of the device's description only overlap by an error of its author.
    let outputs = error(PreOp, AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    let move_to = |start: u16| {
        let mut fixed = description(|_| {}).clone();
        fixed.outputs.start = start;
        let mut bench = Bench::in_state(std::boxed::Box::leak(std::boxed::Box::new(fixed)), PreOp);
        bench.set_process_data(7, 7);
        let mut sm = bench.esc.sm(2);
        sm.start = start;
        bench.esc.set_sm(2, sm);
        bench.ask(SafeOp)
    };
    assert_eq!(move_to(0x1400 - 21), ok(SafeOp), "three buffers before the inputs");
    assert_eq!(move_to(0x1400 - 20), outputs);
    assert_eq!(move_to(0x1080 + 64), ok(SafeOp), "right behind the mailbox");
    assert_eq!(move_to(0x1080 + 63), outputs);
    assert_eq!(move_to(0x2000 - 21), ok(SafeOp), "at the end of the RAM");
    assert_eq!(move_to(0x2000 - 20), outputs);
}

#[test]
fn sync_unit_must_be_what_the_device_can() {
    let invalid = error(PreOp, AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
    let unit = |activation: u8, sync0: u32, sync1: u32| {
        safe_op(
            |d| d.behaviour.maximum_cycle_time = Nanos(4_000_000),
            move |bench| {
                bench.set_sync0(sync0);
                bench.set(register::SYNC1_CYCLE, sync1);
                bench.set(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(activation));
            },
        )
    };
    assert_eq!(unit(0x03, 1_000_000, 0), ok(SafeOp));
    assert_eq!(unit(0x01, 1_000_000, 0), invalid, "nothing enabled");
    assert_eq!(unit(0x08, 1_000_000, 0), invalid, "nothing enabled, starts later");
    assert_eq!(unit(0x0A, 1_000_000, 0), ok(SafeOp), "SYNC0, starts later");
    assert_eq!(unit(0x05, 1_000_000, 0), invalid, "SYNC1 alone");
    assert_eq!(unit(0x07, 1_000_000, 0), invalid, "SYNC1 is not among the types");
    assert_eq!(unit(0x02, 1_000_000, 0), ok(SafeOp), "enabled, but the unit is off");
    let cycle = error(PreOp, AlStatusCode::DC_SYNC0_CYCLE);
    assert_eq!(unit(0x03, 250_000, 0), ok(SafeOp));
    assert_eq!(unit(0x03, 249_999, 0), cycle, "0x1C32:05");
    assert_eq!(unit(0x03, 4_000_000, 0), ok(SafeOp));
    assert_eq!(unit(0x03, 4_000_001, 0), cycle);
    assert_eq!(unit(0x03, 0, 0), cycle, "a single shot starts no cycle");

    // A device that only needs time stamps, and one that ignores SYNC1.
    let lenient = |activation: u8, stamps: bool, sync1: bool| {
        safe_op(
            move |d| {
                d.behaviour.unit_without_pulses = stamps;
                d.behaviour.ignores_sync1 = sync1;
            },
            move |bench| {
                bench.set_sync0(1_000_000);
                bench.set(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(activation));
            },
        )
    };
    for activation in [0x01, 0x08] {
        assert_eq!(lenient(activation, true, false), ok(SafeOp), "{activation:#x}");
        assert_eq!(lenient(activation, false, true), invalid, "{activation:#x}");
    }
    assert_eq!(lenient(0x05, true, true), invalid, "SYNC1 alone");
    assert_eq!(lenient(0x07, false, true), ok(SafeOp), "SYNC1 that it does not listen to");
    assert_eq!(lenient(0x07, true, false), invalid, "SYNC1 is not among the types");

    let granular = |cycle: u32| {
        safe_op(
            |d| d.behaviour.cycle_granularity = Nanos(62_500),
            move |bench| bench.set_sync0(cycle),
        )
    };
    assert_eq!(granular(312_500), ok(SafeOp));
    assert_eq!(granular(312_501), error(PreOp, AlStatusCode::DC_INVALID_SYNC_CYCLE));

    let with_sync1 = |sync1: u32| {
        safe_op(
            |d| {
                d.behaviour.maximum_cycle_time = Nanos(4_000_000);
                d.preset(0x1C32, 4, &[0x0F, 0]);
                d.preset(0x1C33, 4, &[0x0F, 0]);
            },
            move |bench| {
                bench.set_sync0(1_000_000);
                bench.set(register::SYNC1_CYCLE, sync1);
                bench.set(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(7));
                // SYNC0 mode, independent of SYNC1.
                bench.download(0x1C32, 1, &[2, 0]).unwrap();
            },
        )
    };
    assert_eq!(with_sync1(999_999), ok(SafeOp));
    assert_eq!(with_sync1(1_000_000), invalid, "subordinated");
    assert_eq!(with_sync1(4_000_001), error(PreOp, AlStatusCode::DC_SYNC1_CYCLE));
}

#[test]
fn types_that_were_chosen_win_and_are_checked() {
    let types = |supported: u8, dc: bool, output: Option<u8>, input: Option<u8>| {
        safe_op(
            |d| {
                d.preset(0x1C32, 4, &[supported, 0]);
                d.preset(0x1C33, 4, &[supported, 0]);
            },
            |bench| {
                if dc {
                    bench.set_sync0(1_000_000);
                }
                for (index, value) in [(0x1C32, output), (0x1C33, input)] {
                    if let Some(value) = value {
                        bench.download(index, 1, &[value, 0]).unwrap();
                    }
                }
            },
        )
    };
    assert_eq!(types(7, false, Some(0), Some(0)), ok(SafeOp));
    assert_eq!(types(7, false, Some(1), Some(0x22)), ok(SafeOp));
    assert_eq!(types(7, true, Some(1), Some(0x22)), ok(SafeOp), "SYNC pulses are ignored");
    assert_eq!(types(7, true, Some(2), Some(2)), ok(SafeOp));
    let dc_off = AlStatusCode::INVALID_DC_SYNC_CONFIGURATION;
    assert_eq!(types(7, false, Some(2), Some(2)), error(PreOp, dc_off));
    assert_eq!(types(7, false, None, Some(2)), error(PreOp, dc_off));
    assert_eq!(types(6, false, Some(0), None), error(PreOp, AlStatusCode::FREE_RUN_NOT_SUPPORTED));
    let mixed = AlStatusCode::INCONSISTENT_SETTINGS;
    assert_eq!(types(7, true, Some(2), Some(0x22)), error(PreOp, mixed));
    assert_eq!(types(7, true, Some(0), Some(2)), error(PreOp, mixed));
    assert_eq!(types(4, false, None, None), error(PreOp, AlStatusCode::FREE_RUN_NOT_SUPPORTED));
    // One direction supports it, the other one does not: it was chosen before the other was
    // restricted.
    let narrow = safe_op(
        |d| {
            d.preset(0x1C32, 4, &[7, 0]);
            d.preset(0x1C33, 4, &[5, 0]);
            d.preset(0x1C13, 0, &[0]);
        },
        |bench| {
            bench.download(0x1C32, 1, &[1, 0]).unwrap();
            bench.download_as(true, 0x1C13, 0, &[1, 0, 0, 0x1A]).unwrap();
        },
    );
    assert_eq!(narrow, error(PreOp, AlStatusCode::SYNCHRONIZATION_NOT_SUPPORTED));
}

#[test]
fn type_writes_are_refused_by_what_the_device_can() {
    let refused = Err(isocat_wire::AbortCode::VALUE_RANGE);
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    let mut write = |index, value: u8| bench.download(index, 1, &[value, 0]);
    for value in [0, 1, 2] {
        assert_eq!(write(0x1C32, value), Ok(()));
    }
    for value in [3, 4, 0x22, 0x20, 0xFF] {
        assert_eq!(write(0x1C32, value), refused, "{value}");
    }
    for value in [0, 2, 0x22] {
        assert_eq!(write(0x1C33, value), Ok(()));
    }
    for value in [1, 3, 0x23] {
        assert_eq!(write(0x1C33, value), refused, "{value}");
    }
    assert_eq!(bench.number(0x1C33, 1), 0x22, "a refused value changes nothing");
    // Without outputs it is SM3.
    bench.download(0x1C12, 0, &[0]).unwrap();
    let mut write = |index, value: u8| bench.download(index, 1, &[value, 0]);
    assert_eq!(
        [write(0x1C33, 1), write(0x1C33, 0x22), write(0x1C32, 1)],
        [Ok(()), refused, refused]
    );
    // Free Run is accepted even if it is not announced; the state change refuses it.
    let no_free_run = description(|d| {
        d.preset(0x1C32, 4, &[4, 0]);
        d.preset(0x1C33, 4, &[4, 0]);
    });
    let mut bench = Bench::in_state(no_free_run, PreOp);
    assert_eq!(bench.download(0x1C32, 1, &[0, 0]), Ok(()));
    assert_eq!(bench.download(0x1C32, 1, &[1, 0]), refused);
}

#[test]
fn free_run_and_watchdog_settings() {
    let one_buffer = |mode: u8| {
        safe_op(
            |_| {},
            move |bench| {
                let mut sm = bench.esc.sm(2);
                sm.control |= SyncManager::CONTROL_MAILBOX;
                bench.esc.set_sm(2, sm);
                bench.download(0x1C32, 1, &[mode, 0]).unwrap();
            },
        )
    };
    assert_eq!(one_buffer(0), error(PreOp, AlStatusCode::FREE_RUN_NEEDS_3_BUFFERS));
    assert_eq!(one_buffer(1), ok(SafeOp));

    let cycle = |cycle: u32| {
        safe_op(
            |_| {},
            move |bench| {
                bench.download(0x1C32, 1, &[0, 0]).unwrap();
                bench.download(0x1C32, 2, &cycle.to_le_bytes()).unwrap();
            },
        )
    };
    assert_eq!(cycle(250_000), ok(SafeOp));
    assert_eq!(cycle(249_999), error(PreOp, AlStatusCode::CYCLE_TIME_TOO_SMALL));
    assert_eq!(cycle(0), ok(SafeOp), "not stated");

    let watchdog_of = |must_agree: bool, control: u8, time: u16| {
        safe_op(
            |d| d.behaviour.watchdog_must_agree = must_agree,
            move |bench| {
                let mut sm = bench.esc.sm(2);
                sm.control = control;
                bench.esc.set_sm(2, sm);
                bench.set(register::WATCHDOG_TIME_PROCESS_DATA, time);
            },
        )
    };
    let watchdog = |control, time| watchdog_of(true, control, time);
    let disagree = error(PreOp, AlStatusCode::INVALID_WATCHDOG_CONFIGURATION);
    assert_eq!(watchdog(0x64, 1), ok(SafeOp));
    assert_eq!(watchdog(0x24, 0), ok(SafeOp));
    assert_eq!([watchdog(0x64, 0), watchdog(0x24, 1)], [disagree; 2]);
    let lax = |control, time| watchdog_of(false, control, time);
    assert_eq!([lax(0x64, 0), lax(0x24, 1)], [ok(SafeOp), ok(SafeOp)]);
}

#[test]
fn the_mode_follows_the_sync_unit() {
    let mode = |supported: u8, dc: bool| {
        let device = description(|d| {
            d.preset(0x1C32, 4, &[supported, 0]);
            d.preset(0x1C33, 4, &[supported, 0x40]);
        });
        let mut bench = Bench::in_state(device, PreOp);
        bench.set_process_data(7, 7);
        if dc {
            bench.set_sync0(1_000_000);
        }
        assert_eq!(bench.ask(SafeOp), ok(SafeOp));
        let shown =
            [(0x1C32, 1), (0x1C33, 1), (0x1C32, 2), (0x1C33, 2), (0x1C32, 10), (0x1C33, 10)];
        (bench.device.sync().mode(), shown.map(|(index, sub)| bench.number(index, sub)))
    };
    let million = 1_000_000;
    assert_eq!(mode(7, true), (SyncMode::DcSync0, [2, 2, million, million, million, million]));
    assert_eq!(mode(7, false), (SyncMode::SmSynchronous, [1, 0x22, 0, 0, 0, 0]));
    assert_eq!(mode(1, false), (SyncMode::FreeRun, [0; 6]));
}

#[test]
fn a_choice_ends_with_safeop() {
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    bench.download(0x1C32, 1, &[0, 0]).unwrap();
    bench.set_process_data(7, 7);
    bench.ask(SafeOp);
    assert_eq!(bench.device.sync().mode(), SyncMode::FreeRun);
    bench.ask(PreOp);
    bench.ask(SafeOp);
    assert_eq!(bench.device.sync().mode(), SyncMode::SmSynchronous);
}

#[test]
fn inputs_stand_in_the_buffer_before_safeop() {
    let mut bench = Bench::in_state(description(|_| {}), PreOp);
    bench.set_process_data(7, 7);
    bench.ask(SafeOp);
    assert_eq!(bench.calls(), [Call::Latch, Call::Inputs]);
    assert_eq!(bench.inputs(), [1; 7]);
}

#[test]
fn safeop_waits_until_the_esc_has_opened_the_buffers() {
    let mut bench = Bench::in_state(description(|_| {}), SafeOp);
    bench.ask(PreOp);
    bench.calls();
    bench.esc.passing = Some(std::vec![]);
    assert_eq!(bench.ask(SafeOp), ok(PreOp));
    assert_eq!(bench.device.next_timeout(), Some(bench.now + Nanos(10_000)));
    bench.pass(Nanos(120_000));
    assert_eq!((bench.status(), bench.calls()), (ok(PreOp), std::vec![]));
    bench.esc.end_frame();
    bench.pass(Nanos(10_000));
    assert_eq!((bench.status(), bench.calls()), (ok(SafeOp), std::vec![Call::Latch, Call::Inputs]));
    assert_eq!(bench.inputs(), [2; 7], "and the inputs got in");
    assert_eq!(bench.device.next_timeout(), None);

    bench.ask(PreOp);
    bench.esc.passing = Some(std::vec![]);
    bench.ask(SafeOp);
    assert_eq!(bench.ask(Init), ok(Init), "taken back");
    bench.esc.end_frame();
    bench.pass(Nanos(100_000));
    assert_eq!(bench.status(), ok(Init));
}

#[test]
fn a_sync_manager_that_changes_ends_the_state() {
    let change = |state: AlState, number: usize| {
        let mut bench = Bench::in_state(description(|_| {}), state);
        bench.calls();
        let mut sm = bench.esc.sm(number);
        sm.activate = 0;
        bench.esc.set_sm(number, sm);
        bench.esc.events |= al_event::SM_ACTIVATION;
        bench.poll();
        assert_eq!(bench.esc.events & al_event::SM_ACTIVATION, 0);
        (bench.status(), bench.calls())
    };
    let mailbox = error(Init, AlStatusCode::INVALID_MAILBOX);
    let outputs = error(PreOp, AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    let inputs = error(PreOp, AlStatusCode::INVALID_INPUT_CONFIGURATION);
    assert_eq!(change(PreOp, 1).0, mailbox);
    assert_eq!(change(PreOp, 2).0, ok(PreOp));
    assert_eq!(change(SafeOp, 2).0, outputs);
    assert_eq!(change(SafeOp, 3).0, inputs);
    assert_eq!(change(Op, 3), (inputs, std::vec![Call::Safe]));
    assert_eq!(change(Op, 0), (mailbox, std::vec![Call::Safe]));
}

#[test]
fn op_waits_for_outputs() {
    let mut bench = Bench::in_state(description(|_| {}), SafeOp);
    assert_eq!(bench.ask(Op), ok(SafeOp));
    bench.pass(Nanos::millis(8_999));
    assert_eq!(bench.status(), ok(SafeOp));
    bench.write_outputs(&[1; 7]);
    assert_eq!(bench.run(Event::Sm2).len(), 4, "no outputs act yet");
    assert_eq!(bench.status(), ok(Op));

    let mut bench = Bench::in_state(description(|_| {}), SafeOp);
    bench.ask(Op);
    bench.pass(Nanos(8_999_999_999));
    assert_eq!(bench.status(), ok(SafeOp));
    bench.pass(Nanos(1));
    assert_eq!(bench.status(), error(SafeOp, AlStatusCode::WATCHDOG));
    assert_eq!(bench.device.next_timeout(), None);
    assert_eq!(bench.esc.sm(2).pdi_control & 1, 1, "closed until the acknowledgement");
    assert_eq!(bench.acknowledge(SafeOp), ok(SafeOp));
    assert_eq!(bench.esc.sm(2).pdi_control & 1, 0);

    let mut bench = Bench::in_state(description(|_| {}), SafeOp);
    bench.ask(Op);
    assert_eq!(bench.ask(SafeOp), ok(SafeOp), "taken back");
    assert_eq!(bench.device.next_timeout(), None);
}

#[test]
fn a_device_without_outputs_enters_op_at_once() {
    let mut bench = Bench::in_state(description(|d| d.preset(0x1C12, 0, &[0])), PreOp);
    bench.set_process_data(0, 7);
    assert_eq!(bench.ask(SafeOp), ok(SafeOp));
    assert_eq!(bench.ask(Op), ok(Op));
}

#[test]
fn the_watchdog_ends_op_and_nothing_else() {
    let expire = |state| {
        let mut bench = Bench::in_state(description(|_| {}), state);
        bench.calls();
        bench.esc.events |= al_event::WATCHDOG;
        bench.poll();
        assert_eq!(bench.esc.events & al_event::WATCHDOG, 0);
        (bench.status(), bench.calls())
    };
    assert_eq!(expire(Op), (error(SafeOp, AlStatusCode::WATCHDOG), std::vec![Call::Safe]));
    assert_eq!(expire(SafeOp), (ok(SafeOp), std::vec![]));
}

#[test]
fn unused_sync_objects_hide_if_the_device_does_so() {
    let shown = |hide: bool| {
        let device = description(|d| {
            d.preset(0x1C12, 0, &[0]);
            d.behaviour.hide_unused_sync_objects = hide;
        });
        let mut bench = Bench::in_state(device, PreOp);
        assert_eq!(bench.number(0x1C32, 0), 32);
        bench.set_process_data(0, 7);
        assert_eq!(bench.ask(SafeOp), ok(SafeOp));
        assert_eq!(bench.number(0x1C33, 0), 32);
        (bench.number(0x1C32, 0), bench.upload(0x1C32, 5), bench.upload_as(true, 0x1C32, 0))
    };
    let (count, entry, whole) = shown(false);
    assert_eq!((count, entry.unwrap().len(), whole.unwrap().len()), (32, 4, 61));
    let absent = Err(isocat_wire::AbortCode::NO_SUBINDEX);
    assert_eq!(shown(true), (0, absent, Ok(std::vec![0, 0])));
}
