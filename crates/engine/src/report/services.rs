//! Optional services that SubDevices answered badly, in reports.

use isocat_maindevice::Service;
use isocat_maindevice::segment::SubDevice;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::typed;

/// An optional service that a SubDevice answered badly, and what was used instead; it does not
/// count against the segment.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ServiceNote {
    /// Position of the SubDevice.
    pub position: usize,
    /// Its name.
    pub device: String,
    /// Short name of the service, for programs.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub service: Service,
    /// The answer with its place, and what was used instead.
    pub what: String,
}

/// The notes of all SubDevices, by position.
pub(super) fn notes(devices: &[SubDevice]) -> Vec<ServiceNote> {
    let of = |device: &SubDevice| {
        let (position, name) = (device.position, device.name.clone());
        let note = move |substitute: &isocat_maindevice::Substitute| ServiceNote {
            position,
            device: name.clone(),
            service: substitute.service,
            what: substitute.to_string(),
        };
        device.substitutes.iter().map(note).collect::<Vec<_>>()
    };
    devices.iter().flat_map(of).collect()
}
