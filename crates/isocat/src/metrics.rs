//! Metrics for Prometheus: a status in its text format, and a small server for `GET /metrics`.
//!
//! Names and units follow Prometheus: base units (seconds, ratios), counters end in `_total`, every
//! family has its HELP and TYPE. The server has separate threads and uses the same data as the live
//! view, so it does not affect the loop that keeps a cycle.
//!
//! No sample has a time stamp: Prometheus adds it when it scrapes. In a simulation with a speed
//! other than 1, a second of its clock is therefore not a second of the segment;
//! `isocat_time_seconds` is the segment's own time.

mod server;
#[cfg(test)]
mod tests;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use isocat_engine::status::{Device, SERVO, SUBS, Status, servo_name};
use prometheus::proto::{Counter, Gauge, LabelPair, Metric, MetricFamily, MetricType};
use prometheus::{Encoder, TextEncoder};
pub use server::{Page, Server};

/// Reads a port of this machine, or an address with its port.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let local = |port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port);
    let port = text.parse::<u16>().map(local);
    port.or_else(|_| text.parse::<SocketAddr>()).map_err(|_| {
        format!("expected a port such as 9464, or an address such as 127.0.0.1:9464 or [::1]:9464, found {text}")
    })
}

/// A status in the text format of Prometheus, version 0.0.4.
pub fn text(status: &Status) -> String {
    let mut text = Vec::new();
    let families: Vec<MetricFamily> = families(status);
    // Each family has a name, a type and a sample, and a Vec accepts all bytes, so nothing can
    // fail.
    let encoded = TextEncoder::new().encode(&families, &mut text);
    debug_assert!(encoded.is_ok(), "{encoded:?}");
    String::from_utf8_lossy(&text).into_owned()
}

/// A family under construction.
struct Family {
    name: &'static str,
    help: &'static str,
    kind: MetricType,
    samples: Vec<(Vec<(&'static str, String)>, f64)>,
}

impl Family {
    fn gauge(name: &'static str, help: &'static str) -> Self {
        Self { name, help, kind: MetricType::GAUGE, samples: Vec::new() }
    }

    fn counter(name: &'static str, help: &'static str) -> Self {
        Self { name, help, kind: MetricType::COUNTER, samples: Vec::new() }
    }

    fn with(mut self, value: Option<f64>) -> Self {
        self.push(Vec::new(), value);
        self
    }

    fn push(&mut self, labels: Vec<(&'static str, String)>, value: Option<f64>) {
        self.samples.extend(value.map(|value| (labels, value)));
    }

    /// Adds a sample for each SubDevice with a figure.
    fn of_devices(mut self, status: &Status, figure: impl Fn(&Device) -> Option<f64>) -> Self {
        for device in &status.devices {
            self.push(labels(device), figure(device));
        }
        self
    }

    fn finish(self) -> Option<MetricFamily> {
        if self.samples.is_empty() {
            return None;
        }
        let mut family = MetricFamily::default();
        family.set_name(self.name.to_owned());
        family.set_help(self.help.to_owned());
        family.set_field_type(self.kind);
        let metric = |(labels, value): (Vec<(&'static str, String)>, f64)| {
            let pair = |(name, value): (&'static str, String)| {
                let mut pair = LabelPair::default();
                pair.set_name(name.to_owned());
                pair.set_value(value);
                pair
            };
            let mut metric = Metric::from_label(labels.into_iter().map(pair).collect());
            match self.kind {
                MetricType::COUNTER => {
                    let mut counter = Counter::default();
                    counter.set_value(value);
                    metric.set_counter(counter);
                }
                _ => {
                    let mut gauge = Gauge::default();
                    gauge.set_value(value);
                    metric.set_gauge(gauge);
                }
            }
            metric
        };
        family.set_metric(self.samples.into_iter().map(metric).collect());
        Some(family)
    }
}

fn labels(device: &Device) -> Vec<(&'static str, String)> {
    vec![
        ("position", device.position.to_string()),
        ("device", device.name.clone()),
        ("mode", device.mode.to_string()),
    ]
}

fn families(status: &Status) -> Vec<MetricFamily> {
    let mut all = of_segment(status);
    all.extend(of_host(status));
    all.extend(of_devices(status));
    all.into_iter().filter_map(Family::finish).collect()
}

fn of_segment(status: &Status) -> Vec<Family> {
    let mut info = Family::gauge("isocat_info", "What is watched, and by which version; always 1");
    let labels = vec![
        ("version", status.version.to_string()),
        ("segment", status.segment.clone()),
        ("kind", status.kind.name().to_owned()),
    ];
    info.push(labels, Some(1.0));
    let flag = |is: bool| Some(f64::from(u8::from(is)));
    vec![
        info,
        Family::gauge(
            "isocat_in_sync",
            "Whether nothing speaks against the segment now: 1, else 0",
        )
        .with(flag(status.verdict().good)),
        Family::gauge("isocat_in_operation", "Whether the segment is in operation: 1, else 0")
            .with(flag(status.in_operation())),
        Family::gauge(
            "isocat_time_seconds",
            "The segment's own time, of a simulation virtual time",
        )
        .with(seconds(Some(status.at_ns as f64))),
        Family::gauge("isocat_operation_seconds", "Time in operation, by the segment's own time")
            .with(seconds(status.operation_ns.map(|ns| ns as f64))),
        Family::gauge("isocat_cycle_seconds", "Bus cycle")
            .with(seconds(Some(status.cycle_ns as f64)).filter(|cycle| *cycle > 0.0)),
    ]
}

fn of_host(status: &Status) -> Vec<Family> {
    let host = &status.host;
    let mut servo = Family::gauge(
        "isocat_servo_state",
        "State of the servo on the reference clock: 1 for the present one",
    );
    if let Some(present) = host.servo {
        for state in SERVO {
            let is = f64::from(u8::from(present == state));
            servo.push(vec![("state", servo_name(state).to_owned())], Some(is));
        }
    }
    let counter = |name, help, count: u64| Family::counter(name, help).with(Some(count as f64));
    vec![
        servo,
        Family::gauge(
            "isocat_host_phase_error_seconds",
            "How late frames find the reference clock against their phase, negative is early",
        )
        .with(seconds(host.phase_error_ns)),
        Family::gauge("isocat_host_phase_error_worst_seconds", "Largest size of it in operation")
            .with(seconds(host.phase_error_worst_ns)),
        Family::gauge(
            "isocat_reference_clock_deviation_ratio",
            "How much faster the reference clock runs than the host's, 0.000001 is 1 ppm",
        )
        .with(host.rate_ppm.map(ratio)),
        counter("isocat_cycles_total", "Cycles begun", host.cycles),
        counter("isocat_frames_sent_total", "Frames sent", host.frames_sent),
        counter("isocat_frames_lost_total", "Frames that did not come back", host.frames_lost),
        counter(
            "isocat_wkc_errors_total",
            "Cyclic datagrams with a wrong working counter",
            host.working_counter_errors,
        ),
        counter("isocat_cycles_skipped_total", "Send instants let pass", host.cycles_skipped),
        counter(
            "isocat_servo_locks_lost_total",
            "How often the servo lost its lock in operation",
            host.locks_lost,
        ),
    ]
}

fn of_devices(status: &Status) -> Vec<Family> {
    let mut families = vec![
        Family::gauge(
            "isocat_al_state",
            "AL state (register 0x0130): 1 INIT, 2 PREOP, 3 BOOT, 4 SAFEOP, 8 OP",
        )
        .of_devices(status, |device| device.al_state.map(|state| f64::from(state as u8))),
        Family::gauge("isocat_al_error", "Error flag of the AL status: 1 or 0")
            .of_devices(status, |device| Some(f64::from(u8::from(device.al_error)))),
        Family::gauge("isocat_al_status_code", "AL status code (register 0x0134)")
            .of_devices(status, |device| Some(f64::from(device.al_code))),
    ];
    families.extend(with_source(
        status,
        status.kind.source(),
        [
            (
                "isocat_sync0_error_seconds",
                "SYNC error now: SYNC0 edges off the grid in true time, or register 0x092C",
                |device: &Device| seconds(Some(device.error?.now_ns)),
            ),
            (
                "isocat_sync0_error_recent_seconds",
                "Largest size of the SYNC error in about the last tenth of a second",
                |device: &Device| seconds(device.error?.recent_ns),
            ),
            (
                "isocat_sync0_error_worst_seconds",
                "Largest size of the SYNC error in operation",
                |device: &Device| seconds(Some(device.error?.worst_ns)),
            ),
        ],
    ));
    families.extend(with_source(
        status,
        status.kind.margin_source(),
        [
            (
                "isocat_sync0_margin_seconds",
                "Least of late of what is left before SYNC0 when outputs are ready",
                |device: &Device| seconds(Some(device.margin?.now_ns)),
            ),
            (
                "isocat_sync0_margin_least_seconds",
                "The same, least in operation",
                |device: &Device| seconds(Some(device.margin?.least_ns)),
            ),
        ],
    ));
    families.push(
        Family::counter(
            "isocat_sync0_errors_measured_total",
            "SYNC0 edges or readings in operation",
        )
        .of_devices(status, |device| Some(device.error?.count as f64)),
    );
    families.push(
        Family::gauge(
            "isocat_clock_deviation_ratio",
            "How much faster the SubDevice's oscillator runs than the reference's, by 0x0930 and 0x0932",
        )
        .of_devices(status, |device| device.clock_ppm.map(ratio)),
    );
    families.extend(counters(status));
    families.push(
        Family::gauge("isocat_alarms_up", "Alarms that are up")
            .of_devices(status, |device| Some(device.alarms.len() as f64)),
    );
    let mut alarm =
        Family::gauge("isocat_alarm", "An alarm that is up: 1; without sample it is not");
    for device in &status.devices {
        for words in &device.alarms {
            let mut labels = labels(device);
            labels.push(("alarm", words.to_string()));
            alarm.push(labels, Some(1.0));
        }
    }
    families.push(alarm);
    families
}

/// Name, help text, and figure.
type Sourced = (&'static str, &'static str, fn(&Device) -> Option<f64>);

/// Families whose samples state their source.
fn with_source<const N: usize>(
    status: &Status,
    source: char,
    all: [Sourced; N],
) -> impl Iterator<Item = Family> + '_ {
    let source = match source {
        't' => "true time",
        'r' => "register",
        _ => "MainDevice",
    };
    all.into_iter().map(move |(name, help, figure)| {
        let mut family = Family::gauge(name, help);
        for device in &status.devices {
            let mut labels = labels(device);
            labels.push(("source", source.to_owned()));
            family.push(labels, figure(device));
        }
        family
    })
}

fn counters(status: &Status) -> [Family; 2] {
    let mut value = Family::gauge(
        "isocat_sync_entry",
        "Entries 0B SM event missed, 0C cycle time too small, 0D shift time too short, 20 sync error of 0x1C32 and \
         0x1C33, as last read; 0B counts down by itself",
    );
    let mut risen = Family::counter(
        "isocat_sync_entry_risen_total",
        "How much such an entry has risen in operation, as far as was seen",
    );
    for device in &status.devices {
        for (index, all) in [("0x1C32", &device.outputs), ("0x1C33", &device.inputs)] {
            for (counter, sub) in all.iter().zip(SUBS) {
                let Some(count) = counter.value else { continue };
                let mut labels = labels(device);
                labels.push(("object", format!("{index}:{sub}")));
                value.push(labels.clone(), Some(f64::from(count)));
                risen.push(labels, Some(counter.risen as f64));
            }
        }
    }
    [value, risen]
}

fn seconds(ns: Option<f64>) -> Option<f64> {
    ns.map(|ns| ns / 1e9)
}

fn ratio(ppm: f64) -> f64 {
    ppm / 1e6
}
