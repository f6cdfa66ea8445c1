//! For any input: no panic, and the next right request is answered.

use std::vec;
use std::vec::Vec;

use isocat_sync::{Event, Step};
use isocat_wire::register::al_event;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AlControl, AlState, Nanos};
use proptest::prelude::*;

use super::bench::Bench;
use super::device::description;
use crate::description::{Description, MissedEvents};
use crate::steps::MAX_STEPS;

/// An input of a device.
#[derive(Clone, Debug)]
enum Input {
    Control(u16),
    SyncManager(usize, [u8; 8]),
    GoodSyncManagers,
    Sync(u8, u32),
    Mailbox(Vec<u8>),
    Read,
    Repeat,
    Event(Event),
    Begin(Step),
    Finish(Step),
    Watchdog,
    Pass(i64),
}

fn device() -> &'static Description {
    static DEVICE: std::sync::OnceLock<&'static Description> = std::sync::OnceLock::new();
    DEVICE.get_or_init(|| {
        description(|d| {
            d.behaviour.shift_outputs = true;
            d.behaviour.missed_events = MissedEvents::SlaveStackCode;
            d.edit(0x1C32, 1, |entry| entry.access = super::device::RW);
        })
    })
}

/// A CoE request that is usually valid, to an object that usually exists.
fn request() -> impl Strategy<Value = Vec<u8>> {
    let indices: Vec<u16> = device().objects.iter().map(|object| object.index).collect();
    let index = prop_oneof![9 => proptest::sample::select(indices), 1 => any::<u16>()];
    let command = prop_oneof![
        Just(0x40),
        Just(0x50),
        Just(0x60),
        Just(0x70),
        Just(0x21),
        Just(0x31),
        Just(0x00),
        Just(0x10),
        Just(0x01),
        Just(0x11),
        Just(0x2F),
        Just(0x2B),
        Just(0x23),
        Just(0x33),
        any::<u8>(),
    ];
    let service = prop_oneof![8 => Just(0x20u8), 2 => Just(0x80), 1 => any::<u8>()];
    let sub = prop_oneof![0u8..6, any::<u8>()];
    let size = prop_oneof![0u32..70, any::<u32>()];
    let data = proptest::collection::vec(any::<u8>(), 0..48);
    (service, command, index, sub, size, data).prop_map(
        |(service, command, index, sub, size, data)| {
            let (i, s) = (index.to_le_bytes(), size.to_le_bytes());
            let mut body = vec![0, service];
            if service == 0x80 {
                body.extend([command % 8, 0, 0, 0, i[0], i[1], sub, s[0]]);
            } else {
                body.extend([command, i[0], i[1], sub, s[0], s[1], s[2], s[3]]);
            }
            body.extend(data);
            let mut message = vec![body.len() as u8, 0, 0, 0, 0, 0x03];
            message.extend(body);
            message
        },
    )
}

fn input() -> impl Strategy<Value = Input> {
    use Event::*;
    let event = proptest::sample::select(vec![Sm2, Sm3, Sync0, Sync1, Timer]);
    let step = || proptest::sample::select(Step::ALL.to_vec());
    let control = prop_oneof![
        8 => proptest::sample::select(vec![1u16, 2, 4, 8, 0x11, 0x12, 0x14, 0x18]),
        1 => any::<u16>(),
    ];
    prop_oneof![
        6 => control.prop_map(Input::Control),
        1 => (0usize..4, any::<[u8; 8]>()).prop_map(|(n, bytes)| Input::SyncManager(n, bytes)),
        4 => Just(Input::GoodSyncManagers),
        2 => (any::<u8>(), prop_oneof![Just(1_000_000u32), any::<u32>()])
            .prop_map(|(activation, cycle)| Input::Sync(activation, cycle)),
        8 => request().prop_map(Input::Mailbox),
        1 => proptest::collection::vec(any::<u8>(), 0..64).prop_map(Input::Mailbox),
        4 => Just(Input::Read),
        1 => Just(Input::Repeat),
        8 => event.prop_map(Input::Event),
        4 => step().prop_map(Input::Begin),
        4 => step().prop_map(Input::Finish),
        1 => Just(Input::Watchdog),
        4 => prop_oneof![0i64..10_000_000, 0i64..10_000_000_000].prop_map(Input::Pass),
    ]
}

fn apply(bench: &mut Bench, input: &Input) {
    match input {
        Input::Control(control) => {
            bench.control(AlControl(*control));
        }
        Input::SyncManager(number, bytes) => {
            let sm = <SyncManager as isocat_wire::register::Value>::from_bytes(*bytes);
            bench.esc.set_sm(*number, sm);
            bench.esc.events |= al_event::SM_ACTIVATION;
        }
        Input::GoodSyncManagers => {
            bench.set_mailbox();
            bench.set_process_data(7, 7);
        }
        Input::Sync(activation, cycle) => {
            bench.set_sync0(*cycle);
            bench.set(
                isocat_wire::register::SYNC_ACTIVATION,
                isocat_wire::dc::SyncActivation(*activation),
            );
        }
        Input::Mailbox(bytes) => bench.send_raw(bytes),
        Input::Read => {
            bench.receive();
        }
        Input::Repeat => {
            let mut sm = bench.esc.sm(1);
            sm.activate ^= SyncManager::REPEAT;
            bench.esc.set_sm(1, sm);
            bench.esc.events |= al_event::SM_ACTIVATION;
        }
        Input::Event(event) => {
            let steps = bench.device.handle_event(bench.now, *event, &mut bench.esc);
            assert!(steps.len() <= MAX_STEPS);
            assert!(steps.as_slice().is_sorted_by_key(|(_, delay)| *delay));
        }
        Input::Begin(step) => bench.device.begin(bench.now, *step, &mut bench.esc),
        Input::Finish(step) => bench.device.finish(bench.now, *step, &mut bench.esc),
        Input::Watchdog => bench.esc.events |= al_event::WATCHDOG,
        // Free Run may tick every microsecond: a few of its ticks are enough.
        Input::Pass(ns) => {
            let end = bench.now + Nanos(*ns);
            for _ in 0..20 {
                let Some(due) = bench.device.next_timeout().filter(|due| *due <= end) else {
                    break;
                };
                bench.now = bench.now.max(due);
                bench.cycle(Event::Timer);
                assert!(bench.device.next_timeout().is_none_or(|next| next > bench.now));
            }
            bench.now = end;
        }
    }
    bench.poll();
    let status = bench.status().0;
    assert_eq!(status.state(), Ok(bench.device.state()));
    assert_eq!(status.error(), bench.device.status_code() != Default::default());
}

/// Reads all waiting messages, and requests a known value.
fn answers(bench: &mut Bench) {
    for _ in 0..40 {
        bench.poll();
        bench.receive();
    }
    bench.poll();
    bench.send_raw(&[10, 0, 0, 0, 0, 0x03, 0, 0x20, 0x40, 0x0A, 0x10, 0, 0, 0, 0, 0]);
    bench.poll();
    let (_, body) = bench.receive().expect("an answer");
    assert_eq!(body, [0, 0x30, 0x4B, 0x0A, 0x10, 0, b'0', b'8', 0, 0]);
}

proptest! {
    #[test]
    fn any_requests_in_any_order(
        messages in proptest::collection::vec(
            prop_oneof![9 => request(), 1 => proptest::collection::vec(any::<u8>(), 0..64)], 1..40),
        state in proptest::sample::select(vec![AlState::PreOp, AlState::SafeOp, AlState::Op]),
    ) {
        let mut bench = Bench::in_state(device(), state);
        for message in &messages {
            bench.send_raw(message);
            bench.poll();
            bench.receive();
            bench.poll();
        }
        prop_assert_eq!(bench.device.state(), state);
        answers(&mut bench);
    }

    #[test]
    fn anything_in_any_order(inputs in proptest::collection::vec(input(), 1..120)) {
        let mut bench = Bench::new(device());
        for input in &inputs {
            apply(&mut bench, input);
        }
        // After any input INIT is possible, for a MainDevice that sets all SyncManagers again: one
        // of process data may have been laid over the mailbox.
        bench.set_mailbox();
        bench.set_process_data(7, 7);
        let mut sm = bench.esc.sm(0);
        sm.status = 0;
        bench.esc.set_sm(0, sm);
        bench.control(AlControl(0x11));
        prop_assert_eq!(bench.device.state(), AlState::Init);
        bench.esc.events = 0;
        bench.ask(AlState::PreOp);
        prop_assert_eq!(bench.device.state(), AlState::PreOp);
        answers(&mut bench);
    }
}
