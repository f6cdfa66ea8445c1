//! Clocks that are read in the background, against true time.

use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::quality::Alarm;
use isocat_maindevice::{Event, QualityWatch};
use isocat_sim::observation::Observation;
use isocat_sim::{Motion, Segment, Tap, World};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{datagram, frame, register};

/// Counts the time on the wire of frames that read 0x092C.
#[derive(Clone, Default)]
struct Share(std::rc::Rc<std::cell::Cell<i64>>);

impl Tap for Share {
    fn frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        let Ok(payload) = frame::payload(bytes) else { return };
        let address = u32::from(register::SYSTEM_TIME_DIFFERENCE.address);
        let reads =
            |d: datagram::Datagram<'_>| d.header.address >> 16 == address && d.data.len() == 8;
        if sent && datagram::datagrams(payload).flatten().any(reads) {
            let on_wire = bytes.len().max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
            self.0.set(self.0.get() + on_wire as i64 * frame::BYTE_TIME_NS as i64);
        }
    }
    fn observed(&mut self, _: &Segment, _: Time<True>, _: &Observation) {}
}

/// The bound of each clock holds in true time and is not absurdly wide, what the loop corrects is what the oscillators
/// differ by, and the reads take no more than their share of the wire.
#[test]
fn registers_bound_the_truth_within_their_share() {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(3_000);
    let mut run = scenario.run();
    run.setup.config.quality = Some(QualityWatch::default());
    let share = Share::default();
    let outcome = run.execute(Some(share.clone()), &mut |_| {});
    assert!(outcome.in_sync(), "{:?}", outcome.findings);
    let main = outcome.world.main();
    let clocks = main.quality();
    let led: Vec<usize> = clocks.iter().map(|clock| clock.position).collect();
    assert_eq!(led, [1, 3], "all with a clock but the reference");
    for clock in clocks {
        let sync0 = outcome.bench.devices()[clock.position].sync0.as_ref().expect("SYNC0 in use");
        let worst = sync0.statistics().worst() as f64 / 1e3;
        let bound = clock.bound().expect("it was read");
        assert!(bound.0 as f64 >= worst, "{}: {bound} and {worst} ns", clock.position);
        assert!(bound < Nanos(250), "{}: {bound}", clock.position);
        assert_eq!(clock.readings().count(), 256);
        assert!(Alarm::ALL.into_iter().all(|alarm| !clock.has(alarm)));
        let ppb = |at: usize| scenario.devices[at].clock.0;
        let apart = clock.last().unwrap().correction_ppb + ppb(clock.position) - ppb(0);
        assert!(apart.abs() < 1_000, "{}: {apart} ppb", clock.position);
    }
    let on_wire = share.0.get();
    assert_eq!(main.quality_wire_time(), Nanos(on_wire), "told and seen");
    let permille = on_wire as f64 / 3e9 * 1e3;
    assert!((9.0..=10.1).contains(&permille), "{permille}");
}

/// Clocks that nobody leads slide and leave the limit; a SubDevice without power is silent. The others raise nothing.
#[test]
fn alarms_name_the_clock_and_what_is_wrong() {
    let up = |change: &dyn Fn(&mut Scenario)| {
        let mut scenario = Scenario::from(SegmentFile::built_in());
        change(&mut scenario);
        let mut setup = scenario.run().setup;
        setup.config.quality = Some(QualityWatch::default());
        let mut world = World::new(setup, Motion::default(), None::<NoTap>);
        let limit = Time::new(20_000_000_000_000);
        while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
            assert!(world.step(limit), "the segment does not come up");
        }
        world
    };
    let alarms = |world: &mut World<Motion, NoTap>, milliseconds: i64| {
        let end = world.now() + Picos(milliseconds * 1_000_000_000);
        let mut found = Vec::new();
        while world.step(end) {
            while let Some(event) = world.poll_event() {
                if let Event::ClockAlarm { position, alarm, raised, .. } = event {
                    found.push((position, alarm, raised));
                }
            }
        }
        found
    };
    let mut alone = up(&|scenario| scenario.drift_compensation = false);
    let mut found = alarms(&mut alone, 1_000);
    found.sort_by_key(|(position, alarm, _)| (*position, *alarm as usize));
    let sliding = |at| (at, Alarm::Sliding, true);
    assert!(found.contains(&sliding(1)) && found.contains(&sliding(3)), "{found:?}");
    let mut world = up(&|_| {});
    assert_eq!(alarms(&mut world, 500), []);
    let now = world.now();
    world.segment_mut().power_off(3, now + Picos(1));
    assert_eq!(alarms(&mut world, 500), [(3, Alarm::Silent, true)]);
}
