//! States of SubDevices.

use isocat_wire::AlState;

use crate::book::Findings;
use crate::breach::Breach;
use crate::claims::Claims;
use crate::evidence::Evidence;

pub(crate) fn operates(claims: &Claims, evidence: &Evidence, findings: &mut Findings<'_>) {
    for (at, _) in claims.devices.iter().enumerate().filter(|(_, claim)| claim.operates) {
        match evidence.devices.get(at).and_then(|device| device.state) {
            None => findings.unknown(Some(at)),
            Some((AlState::Op, _)) => findings.kept(),
            Some((state, code)) => {
                findings.broken(Some(at), Breach::NotOperated { state, code });
            }
        }
    }
}
