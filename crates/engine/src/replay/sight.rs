//! The part of a SubDevice's memory that an answer shows.

use std::collections::BTreeMap;

use isocat_esc::Esc;
use isocat_wire::Command;
use isocat_wire::register;

use super::chain::Chain;
use super::exchange::Exchange;
use super::parts::{Pair, Stations, Whom, pairs, reads};

/// Bytes of one SubDevice's memory as the answer shows them: the value, and a mask of the known
/// bits.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sights(BTreeMap<u16, (u8, u8)>);

impl Sights {
    /// A byte with the mask of its known bits; `None` if none is known.
    pub fn byte(&self, address: u16) -> Option<(u8, u8)> {
        self.0.get(&address).copied()
    }

    /// A byte whose bits are all known.
    pub fn whole(&self, address: u16) -> Option<u8> {
        self.byte(address).filter(|(_, known)| *known == 0xFF).map(|(value, _)| value)
    }

    /// One bit, if it is known.
    pub fn bit(&self, address: u16, bit: u8) -> Option<bool> {
        self.byte(address).filter(|(_, known)| known & bit != 0).map(|(value, _)| value & bit != 0)
    }

    /// All bytes, by address.
    pub fn iter(&self) -> impl Iterator<Item = (u16, u8, u8)> + '_ {
        self.0.iter().map(|(address, (value, known))| (*address, *value, *known))
    }

    /// Bytes of `range`, by address.
    pub fn range(&self, range: std::ops::Range<u32>) -> impl Iterator<Item = (u16, u8, u8)> + '_ {
        self.iter().filter(move |(address, _, _)| range.contains(&u32::from(*address)))
    }

    fn put(&mut self, address: u16, value: u8, known: u8) {
        let entry = self.0.entry(address).or_default();
        entry.0 = entry.0 & !known | value & known;
        entry.1 |= known;
    }
}

/// The memory of each SubDevice that an exchange shows, by the model's present FMMUs.
pub(crate) fn sights(exchange: &Exchange, chain: &Chain) -> Vec<Sights> {
    let stations = stations(chain);
    let mut all = vec![Sights::default(); chain.escs.len()];
    for pair in pairs(exchange) {
        if !reads(pair.command) || pair.count() == 0 {
            continue;
        }
        match stations.whom(&pair) {
            Whom::One(position) => whole(&mut all[position], &pair),
            Whom::All if all.len() == 1 => whole(&mut all[0], &pair),
            Whom::All | Whom::Unknown if pair.command.is_logical() => {
                let first = pair.sent.header.address;
                for (position, sights) in all.iter_mut().enumerate() {
                    for (at, bit, address, memory_bit) in
                        chain.mapped(position, first, pair.back.data.len())
                    {
                        let value = pair.back.data[at] >> bit & 1;
                        sights.put(address, value << memory_bit, 1 << memory_bit);
                    }
                }
            }
            _ => {}
        }
    }
    all
}

/// The station addresses that the ESCs have now.
pub(crate) fn stations(chain: &Chain) -> Stations {
    let address = |esc: &Esc<Vec<u8>>| Some(esc.register(register::STATION_ADDRESS));
    Stations::new(chain.escs.iter().map(address).collect())
}

fn whole(sights: &mut Sights, pair: &Pair<'_>) {
    // For FRMW and ARMW, which write one device's data to the others, only the addressed SubDevice
    // is shown.
    debug_assert!(pair.command != Command::Nop, "it reads nothing");
    let first = u32::from(pair.sent.header.ado());
    for (address, value) in (first..).zip(pair.back.data) {
        if let Ok(address) = u16::try_from(address) {
            sights.put(address, *value, 0xFF);
        }
    }
}
