//! The rules, by subject.

pub(crate) mod data;
pub(crate) mod frames;
pub(crate) mod state;
pub(crate) mod sync;
#[cfg(test)]
mod tests;

use crate::claims::{Claims, DeviceClaims};
use crate::evidence::{DeviceEvidence, Evidence};

/// Each SubDevice with its claims and its evidence, as far as it operates or did: what one that
/// never came to OP does is no further finding.
fn operating<'a>(
    claims: &'a Claims,
    evidence: &'a Evidence,
) -> impl Iterator<Item = (usize, &'a DeviceClaims, &'a DeviceEvidence)> {
    let pairs = claims.devices.iter().zip(&evidence.devices).enumerate();
    pairs
        .map(|(at, (claims, evidence))| (at, claims, evidence))
        .filter(|(_, _, evidence)| evidence.operated)
}
