//! Hot connect: SubDevices that may be absent when the segment starts, and come while it runs.
//!
//! A configured hot-connect SubDevice ([`DeviceConfig::hot_connect`]) is planned as if it were
//! present: process image, frames, budget, SYNC. [`seat`] finds at the scan which of the configured
//! ones answer. From then on an absent one is treated as lost and is re-admitted in the same way
//! ([`readmit`](crate::readmit)).

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::PortNumber;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use crate::config::{Config, DeviceConfig};
use crate::error::{Cause, Place};
use crate::link::Link;
use crate::segment::{Identity, Segment, SubDevice, station_of};
use crate::sii;

/// Whether fewer SubDevices may answer than are configured, and `count` is enough.
pub(crate) fn allows(config: &Config, count: usize) -> bool {
    let needed = config.devices.iter().filter(|device| !device.may_be_absent()).count();
    (needed..=config.devices.len()).contains(&count)
}

/// Whether a configured SubDevice is missing.
pub(crate) fn is_short(config: &Config, segment: &Segment) -> bool {
    segment.devices.len() < config.devices.len()
}

/// Gives each SubDevice found its configured position and the station address of that position.
/// Before that, positions are places in the order of frames. Absent SubDevices are still missing in
/// the segment.
pub(crate) async fn seat(link: &Link, config: &Config, segment: &mut Segment) -> Result<(), Cause> {
    let mut found = Vec::with_capacity(segment.devices.len());
    for device in &segment.devices {
        let identity = sii::identity(link, config, device).await?;
        found.push(Found { identity, parent: device.parent });
    }
    let seats = seats(&found, &config.devices).map_err(|unseated| {
        let of = |place: usize| (found[place].identity.vendor, found[place].identity.product);
        match unseated {
            Unseated::Nowhere(place) => Cause::NoSeat { place, found: of(place), several: false },
            Unseated::Anywhere(place) => Cause::NoSeat { place, found: of(place), several: true },
            Unseated::Missing(position) => {
                let name = config.devices[position].name.clone();
                Cause::Missing { place: Place { position, name } }
            }
        }
    })?;
    // The last one is first: an address must be free before another SubDevice gets it.
    for (device, position) in segment.devices.iter_mut().zip(seats).rev() {
        let station = station_of(position);
        if station != device.station {
            let address = register::STATION_ADDRESS.address;
            link.fpwr(device.station, address, &station.0.to_bytes()).expect(1).await?;
        }
        device.position = position;
        device.station = station;
        device.name.clone_from(&config.devices[position].name);
    }
    Ok(())
}

/// A SubDevice at a place in the order of frames.
struct Found {
    identity: Identity,
    /// Place and port of its parent; `None` for the first, and if the ports make no tree.
    parent: Option<(usize, PortNumber)>,
}

/// Why a SubDevice gets no position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Unseated {
    /// No configured SubDevice may be at this place.
    Nowhere(usize),
    /// More than one position fits this place.
    Anywhere(usize),
    /// The SubDevice of this position is required but absent.
    Missing(usize),
}

/// The position of each SubDevice found, in the order of frames, by identity and, for hot-connect
/// ones, by the port at which they hang. The configured order is kept, and only SubDevices that may
/// be absent are skipped.
fn seats(found: &[Found], configured: &[DeviceConfig]) -> Result<Vec<usize>, Unseated> {
    let is = |place: usize, position: usize| {
        let Identity { vendor, product, .. } = found[place].identity;
        configured[position].identity.is_none_or(|wanted| wanted == (vendor, product))
    };
    let fits = |place: usize, position: usize| {
        let known = configured[position].hot_connect.as_ref().and_then(|known| known.parent);
        let hangs = match (found[place].parent, known) {
            (Some((above, port)), Some((wanted, at))) => port == at && is(above, wanted),
            _ => true,
        };
        is(place, position) && hangs
    };
    let may_miss = |position: usize| configured[position].may_be_absent();
    let (places, positions) = (found.len(), configured.len());
    // `goes[place][position]`: whether the SubDevices from a place on fit the positions from one
    // on.
    let mut goes = vec![vec![false; positions + 1]; places + 1];
    goes[places][positions] = true;
    for position in (0..positions).rev() {
        for place in (0..=places).rev() {
            let there = place < places && fits(place, position) && goes[place + 1][position + 1];
            goes[place][position] = there || may_miss(position) && goes[place][position + 1];
        }
    }
    let mut seats = Vec::with_capacity(places);
    let mut next = 0;
    for place in 0..places {
        let first_needed = (next..positions).find(|at| !may_miss(*at));
        let reachable = next..first_needed.map_or(positions, |at| at + 1);
        let mut seated = reachable.clone().filter(|at| fits(place, *at) && goes[place + 1][at + 1]);
        match (seated.next(), seated.next()) {
            (Some(at), None) => {
                seats.push(at);
                next = at + 1;
            }
            (Some(_), Some(_)) => return Err(Unseated::Anywhere(place)),
            (None, _) => return Err(stuck(place, next, places, positions, &fits, &may_miss)),
        }
    }
    match (next..positions).find(|at| !may_miss(*at)) {
        Some(position) => Err(Unseated::Missing(position)),
        None => Ok(seats),
    }
}

/// The reason why a place gets no position: the point at which assigning the places one by one
/// fails.
fn stuck(
    mut place: usize,
    mut next: usize,
    places: usize,
    positions: usize,
    fits: &impl Fn(usize, usize) -> bool,
    may_miss: &impl Fn(usize) -> bool,
) -> Unseated {
    while place < places {
        let first_needed = (next..positions).find(|at| !may_miss(*at));
        let reachable = next..first_needed.map_or(positions, |at| at + 1);
        let Some(at) = reachable.clone().find(|at| fits(place, *at)) else {
            let missing =
                first_needed.filter(|needed| (needed + 1..positions).any(|at| fits(place, at)));
            return missing.map_or(Unseated::Nowhere(place), Unseated::Missing);
        };
        (place, next) = (place + 1, at + 1);
    }
    let needed = (next..positions).find(|at| !may_miss(*at));
    needed.map_or(Unseated::Nowhere(places - 1), Unseated::Missing)
}

/// Inserts the absent SubDevices, as the configuration describes them. From then on positions are
/// indices.
pub(crate) fn fill(config: &Config, segment: &mut Segment) {
    let present = core::mem::take(&mut segment.devices);
    let positions: Vec<usize> = present.iter().map(|device| device.position).collect();
    let mut present = present.into_iter().peekable();
    for (position, wish) in config.devices.iter().enumerate() {
        let device =
            match (present.next_if(|device| device.position == position), &wish.hot_connect) {
                (Some(mut device), _) => {
                    device.parent = device.parent.map(|(above, port)| (positions[above], port));
                    device
                }
                (None, Some(known)) => absent(position, wish, known),
                // The required SubDevices have been assigned already.
                (None, None) => continue,
            };
        segment.devices.push(device);
    }
    segment.reference = segment.reference.map(|at| positions[at]);
}

fn absent(position: usize, wish: &DeviceConfig, known: &SubDevice) -> SubDevice {
    SubDevice {
        position,
        station: station_of(position),
        name: wish.name.clone(),
        admitted: false,
        al_status: AlStatus(0),
        al_code: AlStatusCode::NO_ERROR,
        sync: None,
        measured_delay: None,
        ..known.clone()
    }
}

/// How much later frames reach a position after all absent groups have come: by the way there and
/// back through the groups before it in the order of frames. The way back is not longer than the
/// way there, so this is an upper bound.
pub(crate) fn detour(segment: &Segment, position: usize) -> Nanos {
    // Frames already pass those that were left out.
    let absent =
        |at: usize| !segment.devices[at].admitted && segment.devices[at].left_out.is_none();
    let mut detour = Nanos::ZERO;
    for group in segment.devices[..position].iter().filter(|device| absent(device.position)) {
        let Some((above, _)) = group.parent.filter(|(above, _)| !absent(*above)) else { continue };
        let within = |at: usize| {
            let mut up = Some(at);
            while let Some(at) = up.filter(|at| *at != group.position) {
                up = segment.devices[at].parent.map(|(above, _)| above);
            }
            up.is_some()
        };
        if within(position) {
            continue;
        }
        let inside = segment.devices.iter().filter(|device| within(device.position));
        let farthest = inside.filter_map(|device| device.delay).max();
        let before = segment.delay(above);
        let there = farthest.map_or(Nanos::ZERO, |farthest| (farthest - before).max(Nanos::ZERO));
        detour += Nanos(2 * there.0);
    }
    detour
}

/// Checks that the reference clock is always present: it is the first clock in the order of frames,
/// and that SubDevice must not be a hot-connect one.
pub(crate) fn check_reference(config: &Config, segment: &Segment) -> Result<(), Cause> {
    let may_miss =
        |position: usize| config.devices.get(position).is_some_and(DeviceConfig::may_be_absent);
    let mut clocks = segment.devices.iter().filter(|device| device.dc.has_clock());
    match clocks.next() {
        Some(first) if may_miss(first.position) => Err(Cause::Setting {
            name: "hot_connect",
            expected: "a SubDevice with a clock that is always there, before all others with one: it leads them",
        }),
        _ => Ok(()),
    }
}

/// The present SubDevices of a segment, as a segment.
pub(crate) struct Present(pub Segment);

impl Present {
    /// The SubDevices that take part.
    pub fn of(segment: &Segment) -> Self {
        Self::among(segment, |device| device.admitted)
    }

    /// The SubDevices for which `is_there` holds. Positions are kept; parents and the reference are
    /// indices.
    pub fn among(segment: &Segment, is_there: impl Fn(&SubDevice) -> bool) -> Self {
        let positions: Vec<usize> = segment
            .devices
            .iter()
            .filter(|device| is_there(device))
            .map(|device| device.position)
            .collect();
        let index = |position: usize| positions.binary_search(&position).ok();
        let devices = positions.iter().map(|&position| {
            let device = segment.devices[position].clone();
            let parent = device.parent.and_then(|(above, port)| Some((index(above)?, port)));
            SubDevice { parent, ..device }
        });
        let devices = devices.collect();
        let reference = segment.reference.and_then(index);
        Self(Segment { devices, reference, ..Segment::default() })
    }

    /// Copies what is known of the clocks back into the whole segment. All else there is kept.
    pub fn give_clocks(self, segment: &mut Segment) {
        let positions: Vec<usize> = self.0.devices.iter().map(|device| device.position).collect();
        for known in self.0.devices {
            let device = &mut segment.devices[known.position];
            device.parent = known.parent.map(|(above, port)| (positions[above], port));
            device.entry = known.entry;
            device.delay = known.delay;
            device.measured_delay = known.measured_delay;
            device.delay_spread = known.delay_spread;
            device.delay_latches_left_out = known.delay_latches_left_out;
            device.offset = known.offset;
            device.difference = known.difference;
            device.difference_polarity = known.difference_polarity;
        }
    }

    /// Copies the results back into the whole segment.
    pub fn give_back(self, segment: &mut Segment) {
        let positions: Vec<usize> = self.0.devices.iter().map(|device| device.position).collect();
        for device in self.0.devices {
            let parent = device.parent.map(|(above, port)| (positions[above], port));
            let position = device.position;
            segment.devices[position] = SubDevice { parent, ..device };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::boxed::Box;
    use isocat_wire::StationAddress;

    type Above = Option<(usize, PortNumber)>;

    /// Product codes, whether the SubDevice may be absent, and its parent's position and port if
    /// so.
    fn configured(all: &[(u32, bool, Above)]) -> Vec<DeviceConfig> {
        let known = |parent| {
            let mut known = SubDevice::new(0, StationAddress(0));
            known.parent = parent;
            Box::new(known)
        };
        let device = |&(product, optional, parent): &(u32, bool, Above)| DeviceConfig {
            identity: (product > 0).then_some((1, product)),
            hot_connect: optional.then(|| known(parent)),
            ..DeviceConfig::default()
        };
        all.iter().map(device).collect()
    }

    fn found(all: &[(u32, Above)]) -> Vec<Found> {
        let one = |&(product, parent): &(u32, Above)| Found {
            identity: Identity { vendor: 1, product, ..Identity::default() },
            parent,
        };
        all.iter().map(one).collect()
    }

    fn by_product(products: &[u32], all: &[DeviceConfig]) -> Result<Vec<usize>, Unseated> {
        let all_found: Vec<_> = products.iter().map(|&product| (product, None)).collect();
        seats(&found(&all_found), all)
    }

    #[test]
    fn who_is_there_sits_where_it_belongs() {
        let n = None;
        let all = [(10, false, n), (20, true, n), (21, true, n), (30, false, n), (40, true, n)];
        let all = configured(&all);
        let seats = |products: &[u32]| by_product(products, &all);
        assert_eq!(seats(&[10, 20, 21, 30, 40]), Ok(vec![0, 1, 2, 3, 4]));
        assert_eq!(seats(&[10, 30]), Ok(vec![0, 3]));
        assert_eq!(seats(&[10, 21, 30, 40]), Ok(vec![0, 2, 3, 4]));
        assert_eq!(seats(&[10, 30, 40]), Ok(vec![0, 3, 4]));
        // A required one is missing, at the end and in between; an unknown one; exchanged places.
        assert_eq!(seats(&[10, 20]), Err(Unseated::Missing(3)));
        assert_eq!(seats(&[10, 20, 40]), Err(Unseated::Missing(3)));
        assert_eq!(seats(&[10, 99, 30]), Err(Unseated::Nowhere(1)));
        assert_eq!(seats(&[10, 21, 20, 30]), Err(Unseated::Nowhere(2)));
    }

    /// Two of one kind, of which one is absent: only the port tells which.
    #[test]
    fn who_could_sit_on_two_seats_is_told_by_its_port() {
        use PortNumber::{P1, P3};
        let all = configured(&[(10, false, None), (20, true, None), (20, true, None)]);
        assert_eq!(by_product(&[10, 20, 20], &all), Ok(vec![0, 1, 2]));
        assert_eq!(by_product(&[10], &all), Ok(vec![0]));
        assert_eq!(by_product(&[10, 20], &all), Err(Unseated::Anywhere(1)));
        let fork = [(10, false, None), (20, true, Some((0, P3))), (20, true, Some((0, P1)))];
        let fork = configured(&fork);
        let at = |port| found(&[(10, None), (20, Some((0, port)))]);
        assert_eq!(seats(&at(P3), &fork), Ok(vec![0, 1]));
        assert_eq!(seats(&at(P1), &fork), Ok(vec![0, 2]));
        assert_eq!(seats(&at(PortNumber::P2), &fork), Err(Unseated::Nowhere(1)));
    }
}
