//! Optional services of a SubDevice, and how bring-up continues if one is answered badly.

use alloc::vec::Vec;

use crate::error::{Cause, MailboxError, SdoError, SoeError};
use crate::segment::SubDevice;

crate::kinds! {
    /// An optional service, and what replaces it if a SubDevice answers it badly.
    #[derive(Clone, Copy, PartialEq, Eq, Debug)]
    pub enum Service {
        /// SDO information is answered badly. The entries of 0x1C32 and 0x1C33 that ETG.1020
        /// knows are uploaded one by one, and may be written as far as the SubDevice accepts it.
        SdoInformation = "sdo-information",
        /// Object 0x1C00 is answered badly. The SII tells the use of each SyncManager.
        SyncManagerTypes = "sync-manager-types",
        /// Object 0x1C12 or 0x1C13 is answered badly. The PDOs that the SII assigns are used.
        Assignment = "assignment",
        /// The mapping of a PDO is answered badly. The entries of this PDO are taken from the
        /// SII.
        Mapping = "mapping",
        /// An entry of 0x1C32 or 0x1C33 is answered badly. It counts as missing.
        SyncEntry = "sync-entry",
        /// A write to 0x1C32 or 0x1C33 that the SubDevice may refuse is answered badly. It counts
        /// as refused.
        TypeWrite = "type-write",
        /// 0x1C32 or 0x1C33 cannot be read back in SAFEOP. The written values count as accepted.
        TypeReadBack = "type-read-back",
        /// A category of the SII cannot be read. Those before it are used, and the objects provide
        /// the rest.
        Categories = "categories",
    }
}

impl Service {
    /// The replacement, as the end of a sentence.
    pub const fn instead(self) -> &'static str {
        match self {
            Self::SdoInformation => "the entries that ETG.1020 knows are uploaded one by one",
            Self::SyncManagerTypes => "the SII says what each SyncManager is for",
            Self::Assignment => "the PDOs that the SII assigns are taken",
            Self::Mapping => "the entries of this PDO are taken from the SII",
            Self::SyncEntry => "it counts as missing",
            Self::TypeWrite => "it counts as refused",
            Self::TypeReadBack => "what was written counts as taken",
            Self::Categories => "those before it are taken, and the objects say the rest",
        }
    }
}

/// The name of the service.
impl core::fmt::Display for Service {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.pad(self.name())
    }
}

/// A service that a SubDevice answered badly, and without which it is used.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Substitute {
    /// The service.
    pub service: Service,
    /// The SubDevice's answer, with its place and the object.
    pub cause: Cause,
}

/// `SubDevice 1 (AKD2G): 0x1C32:00: abort 0x06020000; the entries …`
impl core::fmt::Display for Substitute {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}; {}", self.cause, self.service.instead())
    }
}

impl SubDevice {
    /// Notes that a service is not used. An error that is not the SubDevice's, a lost datagram, is
    /// returned.
    pub(crate) fn do_without(&mut self, service: Service, cause: Cause) -> Result<(), Cause> {
        if is_of_the_wire(&cause) {
            return Err(cause);
        }
        // It is noted once for each object: a device that fails at one entry fails at many.
        let known = |substitute: &Substitute| {
            substitute.service == service && index(&substitute.cause) == index(&cause)
        };
        if !self.substitutes.iter().any(known) {
            self.substitutes.push(Substitute { service, cause });
        }
        Ok(())
    }

    /// Whether this service was answered badly before.
    pub(crate) fn does_without(&self, service: Service) -> bool {
        self.substitutes.iter().any(|substitute| substitute.service == service)
    }

    /// Takes the notes so far.
    pub(crate) fn take_substitutes(&mut self) -> Vec<Cause> {
        core::mem::take(&mut self.substitutes).into_iter().map(|one| one.cause).collect()
    }
}

/// Whether a service failed because of a lost datagram.
fn is_of_the_wire(cause: &Cause) -> bool {
    use MailboxError::Access;
    matches!(
        cause,
        Cause::Access(_)
            | Cause::Mailbox { error: Access(_), .. }
            | Cause::Sdo { error: SdoError::Mailbox(Access(_)), .. }
            | Cause::Soe { error: SoeError::Mailbox(Access(_)), .. }
    )
}

/// Whether there was no answer at all, so that each further attempt would take as long.
pub(crate) fn is_silence(cause: &Cause) -> bool {
    use MailboxError::{Full, NoAnswer};
    matches!(cause, Cause::Sdo { error: SdoError::Mailbox(NoAnswer { .. } | Full { .. }), .. })
}

fn index(cause: &Cause) -> Option<u16> {
    match cause {
        Cause::Sdo { object, .. } => Some(object.index),
        _ => None,
    }
}
