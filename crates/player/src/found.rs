//! Compares the SubDevices that answer on a wire with those of the ENI, in both directions.

use std::fmt;

use isocat_descriptions::start_up::{Area, DeviceStartUp, StartUp};
use isocat_engine::report::scan::ScanReport;
use isocat_maindevice::segment::{Segment, SubDevice};
use isocat_wire::sii::MailboxArea;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-eni-scan/1";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<FoundReport>(FORMAT)
}

/// A scan, compared with an ENI.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FoundReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The ENI.
    pub eni: String,
    /// Whether the SubDevices that answer are those of the ENI, so that the ENI can be run on them.
    pub same: bool,
    /// The differences, in the order of the wire.
    pub mismatches: Vec<Mismatch>,
    /// The scan.
    pub scan: ScanReport,
}

/// A difference between the wire and the ENI.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Mismatch {
    /// What differs.
    pub kind: Kind,
    /// Position on the wire; null: the wire has no such SubDevice.
    pub on_wire: Option<usize>,
    /// Position in the ENI; null: the ENI has no such SubDevice.
    pub in_eni: Option<usize>,
    /// The value on the wire; null: it has none.
    pub wire: Option<String>,
    /// The value in the ENI; null: it has none.
    pub eni: Option<String>,
    /// The consequence for a run of the ENI.
    pub consequence: &'static str,
}

/// The kind of a difference.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The ENI names a SubDevice that does not answer.
    Missing,
    /// A SubDevice answers that the ENI does not name.
    Extra,
    /// Another SubDevice answers.
    Identity,
    /// Another revision answers.
    Revision,
    /// Another serial number answers.
    Serial,
    /// It is connected at another place.
    Place,
    /// Its mailbox is at another address, by its SII.
    Mailbox,
    /// The ENI writes objects, but the SII states no CoE.
    Coe,
    /// The ENI starts SYNC, but the SubDevice has no clock.
    Clock,
}

impl Kind {
    /// Whether it prevents a run of the ENI: the player compares vendors, products and numbers of
    /// SubDevices.
    pub const fn prevents(self) -> bool {
        matches!(self, Self::Missing | Self::Extra | Self::Identity)
    }
}

impl FoundReport {
    /// Compares a scan with an ENI.
    pub fn new(path: &str, list: &StartUp, segment: &Segment, scan: ScanReport) -> Self {
        let mismatches = compare(list, segment);
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            eni: path.to_owned(),
            same: mismatches.is_empty(),
            mismatches,
            scan,
        }
    }

    /// The comparison as text.
    pub fn text(&self) -> String {
        if self.same {
            let count = self.scan.devices.len();
            return format!("What answers is what {} names: {count} SubDevices\n", self.eni);
        }
        let lines = self.mismatches.iter().map(|one| format!(" - {one}\n"));
        let count = self.mismatches.len();
        format!(
            "What answers is not what {} names ({count}):\n{}",
            self.eni,
            lines.collect::<String>()
        )
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.on_wire, self.in_eni) {
            (Some(wire), Some(eni)) if wire == eni => write!(f, "SubDevice {wire}")?,
            (Some(wire), Some(eni)) => write!(f, "SubDevice {wire} (in the ENI {eni})")?,
            (Some(wire), None) => write!(f, "SubDevice {wire}")?,
            (None, Some(eni)) => write!(f, "SubDevice {eni} of the ENI")?,
            (None, None) => f.write_str("the segment")?,
        }
        let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".into());
        let (wire, eni) = (value(&self.wire), value(&self.eni));
        write!(f, ": the wire has {wire}, the ENI has {eni}; {}", self.consequence)
    }
}

/// A SubDevice of one side, of the other, or of both.
type Pair = (Option<usize>, Option<usize>);

/// All differences. Both sides are aligned so that as few SubDevices as possible differ: a missing
/// SubDevice does not make all those after it differ.
pub fn compare(list: &StartUp, segment: &Segment) -> Vec<Mismatch> {
    let pairs = pairs(list, segment);
    let mut all = Vec::new();
    for pair in &pairs {
        let wire = pair.0.map(|at| &segment.devices[at]);
        let eni = pair.1.map(|at| &list.devices[at]);
        let mismatch = |kind, wire, eni, consequence| Mismatch {
            kind,
            on_wire: pair.0,
            in_eni: pair.1,
            wire,
            eni,
            consequence,
        };
        match (wire, eni) {
            (Some(wire), Some(eni)) if !is_same(wire, eni) => all.push(mismatch(
                Kind::Identity,
                Some(who(wire)),
                Some(named(eni)),
                "a run is refused",
            )),
            (Some(wire), Some(eni)) => {
                all.extend(
                    of_pair(wire, eni).into_iter().map(|(kind, wire, eni, consequence)| {
                        mismatch(kind, wire, eni, consequence)
                    }),
                );
                if let Some((found, listed)) = places(*pair, &pairs, list, segment) {
                    let what = "frames take another way; delays are measured on it";
                    all.push(mismatch(Kind::Place, Some(found), Some(listed), what));
                }
            }
            (Some(wire), None) => {
                all.push(mismatch(Kind::Extra, Some(who(wire)), None, "a run is refused"));
            }
            (None, Some(eni)) => {
                all.push(mismatch(Kind::Missing, None, Some(named(eni)), "a run is refused"));
            }
            (None, None) => {}
        }
    }
    all
}

fn is_same(wire: &SubDevice, eni: &DeviceStartUp) -> bool {
    (wire.identity.vendor, wire.identity.product) == (eni.vendor, eni.product)
}

fn who(device: &SubDevice) -> String {
    let isocat_maindevice::segment::Identity { vendor, product, .. } = device.identity;
    let name = if device.sii.name.is_empty() { &device.sii.order } else { &device.sii.name };
    format!("vendor 0x{vendor:08X}, product 0x{product:08X} ({name})")
}

fn named(device: &DeviceStartUp) -> String {
    let DeviceStartUp { vendor, product, name, .. } = device;
    format!("vendor 0x{vendor:08X}, product 0x{product:08X} ({name})")
}

/// The alignment of both sides with the fewest missing, extra and different SubDevices.
fn pairs(list: &StartUp, segment: &Segment) -> Vec<Pair> {
    let (wire, eni) = (&segment.devices, &list.devices);
    let width = eni.len() + 1;
    if wire.len().saturating_mul(width) > MOST_CELLS {
        let count = wire.len().max(eni.len());
        let of = |at: usize, length: usize| (at < length).then_some(at);
        return (0..count).map(|at| (of(at, wire.len()), of(at, eni.len()))).collect();
    }
    // fewest[i * width + j]: number of differences from i on on the wire and from j on in the ENI.
    let mut fewest = vec![0_u32; (wire.len() + 1) * width];
    for i in (0..=wire.len()).rev() {
        for j in (0..=eni.len()).rev() {
            let (down, right) = (i < wire.len(), j < eni.len());
            let extra = down.then(|| fewest[(i + 1) * width + j] + 1);
            let missing = right.then(|| fewest[i * width + j + 1] + 1);
            let pair = (down && right)
                .then(|| fewest[(i + 1) * width + j + 1] + u32::from(!is_same(&wire[i], &eni[j])));
            fewest[i * width + j] = [extra, missing, pair].into_iter().flatten().min().unwrap_or(0);
        }
    }
    let (mut pairs, mut i, mut j) = (Vec::new(), 0, 0);
    while i < wire.len() || j < eni.len() {
        let here = fewest[i * width + j];
        let (down, right) = (i < wire.len(), j < eni.len());
        let is_pair = down
            && right
            && here == fewest[(i + 1) * width + j + 1] + u32::from(!is_same(&wire[i], &eni[j]));
        let is_extra = down && here == fewest[(i + 1) * width + j] + 1;
        if is_pair {
            pairs.push((Some(i), Some(j)));
            (i, j) = (i + 1, j + 1);
        } else if is_extra {
            pairs.push((Some(i), None));
            i += 1;
        } else {
            pairs.push((None, Some(j)));
            j += 1;
        }
    }
    pairs
}

/// Above this number of comparisons, which is some thousand SubDevices on both sides, they are
/// aligned by position.
const MOST_CELLS: usize = 16 << 20;

type Found = (Kind, Option<String>, Option<String>, &'static str);

/// The differences of a SubDevice that both sides have.
fn of_pair(wire: &SubDevice, eni: &DeviceStartUp) -> Vec<Found> {
    let mut all = Vec::new();
    let hex = |value: u32| Some(format!("revision 0x{value:08X}"));
    if wire.identity.revision != eni.revision {
        let what = "the ENI may write what this revision does not have, or leave out what it needs";
        all.push((Kind::Revision, hex(wire.identity.revision), hex(eni.revision), what));
    }
    let serial = |value: u32| Some(format!("serial number {value}"));
    if eni.serial != 0 && wire.identity.serial != eni.serial {
        let what = "it is another piece of the same kind";
        all.push((Kind::Serial, serial(wire.identity.serial), serial(eni.serial), what));
    }
    let header = &wire.sii.header;
    if let Some(mailbox) = eni.mailbox.filter(|_| wire.has_mailbox()) {
        let same = |area: Area, found: MailboxArea| {
            (area.start, area.length) == (found.start, found.length)
        };
        if !same(mailbox.out, header.receive) || !same(mailbox.back, header.send) {
            let text = |(start, length): (u16, u16), (back, size): (u16, u16)| {
                Some(format!("mailbox 0x{start:04X} +{length}, 0x{back:04X} +{size}"))
            };
            let found = text(
                (header.receive.start, header.receive.length),
                (header.send.start, header.send.length),
            );
            let listed = text(
                (mailbox.out.start, mailbox.out.length),
                (mailbox.back.start, mailbox.back.length),
            );
            let what = "a device that takes only its own areas refuses PREOP";
            all.push((Kind::Mailbox, found, listed, what));
        }
    }
    if !eni.objects.is_empty() && !wire.has_coe() {
        let count = eni.objects.len();
        let listed = Some(format!("{count} SDO downloads"));
        let what = "the downloads fail, and the way up with them";
        all.push((Kind::Coe, Some("no CoE by its SII".into()), listed, what));
    }
    let starts = eni.dc.is_some_and(|dc| dc.sync0_ns > 0);
    if starts && !wire.dc.has_clock() {
        let what = "no pulse comes, and the device does not reach OP by them";
        all.push((Kind::Clock, Some("no clock".into()), Some("SYNC0".into()), what));
    }
    all
}

/// The places of a SubDevice on both sides, if they differ. Its parent is named by the position in
/// the ENI.
fn places(
    pair: Pair,
    pairs: &[Pair],
    list: &StartUp,
    segment: &Segment,
) -> Option<(String, String)> {
    let (wire, eni) = (&segment.devices[pair.0?], &list.devices[pair.1?]);
    let listed = eni.parent?;
    let above = list.devices.iter().position(|one| one.station == listed.station)?;
    let (parent, port) = wire.parent?;
    let found = pairs.iter().find(|(wire, _)| *wire == Some(parent)).and_then(|(_, eni)| *eni)?;
    let text = |above: usize, port: usize| format!("it behind port {port} of SubDevice {above}");
    let (found, listed) = (text(found, port.index()), text(above, usize::from(listed.port)));
    (found != listed).then_some((found, listed))
}

#[cfg(test)]
mod tests {
    use isocat_wire::StationAddress;

    use super::*;

    /// The kinds and places of all differences, for these products on the wire and in the ENI.
    fn kinds(wire: &[u32], eni: &[u32]) -> Vec<(Kind, Option<usize>, Option<usize>)> {
        let device = |(position, product): (usize, &u32)| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            device.identity.product = *product;
            device
        };
        let devices = wire.iter().enumerate().map(device).collect();
        let segment = Segment { devices, ..Segment::default() };
        let listed = |product: &u32| DeviceStartUp { product: *product, ..Default::default() };
        let list = StartUp { devices: eni.iter().map(listed).collect(), ..StartUp::default() };
        let found = compare(&list, &segment);
        found.iter().map(|one| (one.kind, one.on_wire, one.in_eni)).collect()
    }

    #[test]
    fn one_that_is_missing_moves_no_other() {
        assert_eq!(kinds(&[1, 2, 3, 4], &[1, 2, 3, 4]), []);
        assert_eq!(kinds(&[1, 3, 4], &[1, 2, 3, 4]), [(Kind::Missing, None, Some(1))]);
        assert_eq!(kinds(&[1, 2, 3, 4], &[1, 3, 4]), [(Kind::Extra, Some(1), None)]);
        assert_eq!(kinds(&[1, 9, 3], &[1, 2, 3]), [(Kind::Identity, Some(1), Some(1))]);
        assert_eq!(
            kinds(&[9, 1, 2], &[1, 2, 3]),
            [(Kind::Extra, Some(0), None), (Kind::Missing, None, Some(2))]
        );
        assert_eq!(kinds(&[], &[7]), [(Kind::Missing, None, Some(0))]);
        assert_eq!(kinds(&[7, 7], &[7]), [(Kind::Extra, Some(1), None)]);
        assert_eq!(kinds(&[9, 7], &[7, 7]), [(Kind::Identity, Some(0), Some(0))]);
    }
}
