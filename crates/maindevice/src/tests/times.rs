//! Measured times have priority over assumed ones; stated times have priority over both.

use isocat_sync::budget::Origin;
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::config::{AssumedTimes, DeviceConfig, MeasuredTimes};
use crate::mode;
use crate::mode::tests::drive;
use crate::segment::SubDevice;
use crate::times::{OwnTimes, known};

fn stating(copy: i64) -> SubDevice {
    let mut device = drive(0x4027, 0x4027);
    device.mode = isocat_sync::SyncMode::DcSync0;
    let outputs = device.output_sync.as_mut().expect("a drive has outputs");
    outputs.values.calc_and_copy_time = Some(Nanos(copy));
    device
}

fn copy_of(device: &SubDevice, wish: &DeviceConfig) -> (i64, Origin) {
    let demands = mode::demands(device, wish.assumed, Some(wish));
    (demands.output_calc_and_copy.0, demands.origins.output_calc_and_copy)
}

#[test]
fn stated_then_measured_then_assumed() {
    let entry = ObjectAddress::new(0x1C32, 6);
    let assumed =
        AssumedTimes { outputs_calc_and_copy: Some(Nanos(9_000)), ..AssumedTimes::default() };
    let only_assumed = DeviceConfig { assumed, ..DeviceConfig::default() };
    let times =
        |ns| MeasuredTimes { outputs_calc_and_copy: Some(Nanos(ns)), ..MeasuredTimes::default() };
    let configured = DeviceConfig { measured: times(5_000), ..only_assumed.clone() };
    assert_eq!(copy_of(&stating(1), &configured), (1, Origin::Object(entry)));
    assert_eq!(copy_of(&stating(0), &configured), (5_000, Origin::MeasuredByDevice(entry)));
    assert_eq!(copy_of(&stating(0), &only_assumed), (9_000, Origin::Assumed));
    // Times measured in this run have priority over configured ones from an earlier run.
    let mut device = stating(0);
    device.own_times = Some(OwnTimes { times: times(7_000), ..OwnTimes::default() });
    assert_eq!(copy_of(&device, &configured), (7_000, Origin::MeasuredByDevice(entry)));
    // If the device measured nothing, the configured times remain.
    device.own_times = Some(OwnTimes::default());
    assert_eq!(copy_of(&device, &configured), (5_000, Origin::MeasuredByDevice(entry)));
    assert_eq!(known(&device, None), MeasuredTimes::default());
}

#[test]
fn the_minimum_cycle_is_that_of_both_objects() {
    let with = |outputs: i64, inputs: i64| {
        let mut device = stating(0);
        device.output_sync.as_mut().unwrap().values.minimum_cycle_time = Some(Nanos(outputs));
        device.input_sync.as_mut().unwrap().values.minimum_cycle_time = Some(Nanos(inputs));
        let measured =
            MeasuredTimes { minimum_cycle: Some(Nanos(32_000)), ..MeasuredTimes::default() };
        let wish = DeviceConfig { measured, ..DeviceConfig::default() };
        mode::demands(&device, wish.assumed, Some(&wish)).minimum_cycle.0
    };
    assert_eq!([with(0, 0), with(0, 1), with(40_000, 0)], [32_000, 1, 40_000]);
}
